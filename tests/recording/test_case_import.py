"""`snakejax import`: what is understood, what is copied, and what is asked for."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.exports import PLACES, motion, motive, nexus, table, tracker
from scipy.spatial.transform import Rotation

from snakejax import InputError, load_case, read_track
from snakejax.commands.cli import importing, main
from snakejax.recording.readers import read_capture, read_joint_log

BOARD = "mass_kg=7,rotor_inertia_kgm2=0.0238,wheelset_inertia_kgm2=0.001,half_length_m=0.25"
SINES = "[[0.9, 4.0, 0.0]]"
GIVEN = ["--board", BOARD, "--phi", SINES, "--psi", SINES]


def turned(m, angle):
    """A joint's object: on the board, turned by `angle` (n,) about its vertical."""
    return m._replace(rotation=m.rotation * Rotation.from_rotvec(np.outer(angle, [0, 0, 1])))


def put(folder, text, name="take.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def imported(*arguments):
    assert main(["import", *map(str, arguments)]) == 0


def test_it_shows_what_it_understood(tmp_path, capsys):
    imported(put(tmp_path, motive(motion(200), lost=range(20, 30))), "--json", tmp_path / "a.json")
    shown = capsys.readouterr().out
    assert "Motive CSV, frames at 100 Hz for 1.99 s, in m" in shown
    assert "board: 200 frames, 10 lost, the longest gap 0.11 s" in shown
    assert "y: perpendicular to the plane in which board moves" in shown
    found = json.loads((tmp_path / "a.json").read_text())[str(tmp_path / "take.csv")]
    assert found["objects"] == {"board": {"frames": 200, "lost": 10, "longest_gap": pytest.approx(0.11)}}


def test_a_case_that_is_ready(tmp_path, capsys):
    m = motion(200)
    imported(put(tmp_path, motive(m)), "--out", tmp_path / "case", *GIVEN)
    more = put(tmp_path, motive(m), "other.csv")
    assert main(["import", more, "--out", str(tmp_path / "case"), *GIVEN]) == 2
    assert "has its board" in capsys.readouterr().err
    imported(more, "--out", tmp_path / "case", *GIVEN[2:], "--phi-back", SINES, "--role", "heldout")
    case = load_case(tmp_path / "case")
    assert [(run.name, run.role) for run in case.runs] == [("take", "train"), ("other", "heldout")]
    assert float(case.board.mass) == 7 and case.title == "case"
    np.testing.assert_allclose(case.runs[0].pose, np.column_stack([m.position[:, :2], m.heading]), atol=1e-9)
    np.testing.assert_allclose(float(case.runs[0].gait.phi.at(0.3).angle), 0.9 * np.sin(1.2), atol=1e-12)
    assert "now run `snakejax check" in capsys.readouterr().out


def test_in_a_pipe_places_are_left_and_named(tmp_path, capsys):
    imported(put(tmp_path, motive(motion(200))), "--out", tmp_path / "case")
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "mass_kg (line" in said and "psi (line" in said and "creep" not in said
    assert main(["check", str(tmp_path / "case")]) == 2
    assert 'are still "?"' in (said := capsys.readouterr().err) and "mass_kg (line " in said
    text = (tmp_path / "case" / "case.toml").read_text()
    for key, value in (pair.split("=") for pair in BOARD.split(",")):
        text = text.replace(f'{key} = "?"', f"{key} = {value}")
    (tmp_path / "case" / "case.toml").write_text(text)
    assert main(["check", str(tmp_path / "case")]) == 2
    assert 'are still "?"' in (said := capsys.readouterr().err) and "phi (line " in said


def test_on_a_terminal_it_asks(tmp_path, monkeypatch):
    answers = iter(["board", "6.5", "0.02", "0.001", "0.3"])
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: asked.append(question) or next(answers))
    path = put(tmp_path, tracker({"board": motion(), "cart": motion()}))
    imported(path, "--out", tmp_path / "case", "--phi", SINES, "--psi", "[]")
    assert "board, cart" in asked[0] and "[kg]" in asked[1]
    assert float(load_case(tmp_path / "case").board.half_length) == 0.3


def test_markers_become_a_board(tmp_path, capsys):
    """Only the names of its ends are needed: the rest of the shape is found."""
    m = motion(200)
    points = m.points
    points[40:60] = points[40:60][:, [1, 0, 2, 3]]
    points[80:90, 3] = np.nan
    path = put(tmp_path, nexus(points, [f"board:{name}" for name in PLACES]))
    imported(path, "--out", tmp_path / "case", *GIVEN, "--front", "front", "--back", "back")
    assert "in 20 frames labels were swapped back" in capsys.readouterr().out
    pose = np.asarray(load_case(tmp_path / "case").runs[0].pose)
    front, back = (np.array(PLACES[end]) for end in ("front", "back"))
    turn = np.arctan2(*(front - back)[1::-1])
    middle = m.position + m.rotation.apply((front + back) / 2)
    np.testing.assert_allclose(pose[:, :2], middle[:, :2], atol=2e-4)
    np.testing.assert_allclose(pose[:, 2], m.heading + turn, atol=1e-3)


def test_markers_by_a_template(tmp_path):
    m = motion(200)
    path = put(tmp_path, nexus(m.points, [f"board:{name}" for name in PLACES]))
    rows = [["marker", "x_m", "y_m", "z_m"], *([name, *place] for name, place in PLACES.items())]
    template = put(tmp_path, table(rows), "template.csv")
    imported(path, "--out", tmp_path / "case", *GIVEN, "--template", template)
    pose = np.asarray(load_case(tmp_path / "case").runs[0].pose)
    np.testing.assert_allclose(pose, np.column_stack([m.position[:, :2], m.heading]), atol=1e-6)
    imported(path, "--to", tmp_path / "a.tum", "--template", template)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "a.tum")[:, 1:4], m.position, atol=1e-6)


def test_markers_nobody_placed_are_left_open(tmp_path, capsys):
    path = put(tmp_path, nexus(motion(200).points, [f"board:{name}" for name in PLACES]))
    imported(path, "--out", tmp_path / "case", *GIVEN)
    assert "markers (line" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "case")]) == 2
    assert 'is still "?"' in (said := capsys.readouterr().err) and "markers (line " in said


def test_joints_from_their_own_objects(tmp_path):
    m = motion(200)
    phi, psi = 0.5 * np.sin(4 * m.times + 0.3), 3 * m.times + 2.0
    objects = {"board": m, "rotor": turned(m, psi), "fore": turned(m, phi), "aft": turned(m, 0.7 * phi)}
    path = put(tmp_path, tracker(objects, lost=(50, 51)))
    joints = ["--rotor", "rotor", "--front-wheelset", "fore", "--back-wheelset", "aft"]
    imported(path, "--object", "board", "--out", tmp_path / "case", "--board", BOARD, *joints)
    log = read_joint_log(tmp_path / "case" / "take-joints.csv")
    there = np.delete(np.arange(200), [50, 51])
    np.testing.assert_allclose(log.times, m.times[there], atol=1e-9)
    np.testing.assert_allclose(log.phi, phi[there], atol=1e-8)
    np.testing.assert_allclose(log.phi_back, 0.7 * phi[there], atol=1e-8)
    np.testing.assert_allclose(log.psi, (psi - psi[0])[there], atol=1e-8)
    run = load_case(tmp_path / "case").runs[0]
    np.testing.assert_allclose(float(run.gait.phi.at(0.7).angle), 0.5 * np.sin(4 * 0.7 + 0.3), atol=1e-4)


def test_a_rotor_with_two_markers(tmp_path):
    """No template is needed for an angle that counts from its start."""
    m = motion(200)
    psi, phi = 3 * m.times, 0.5 * np.sin(4 * m.times)
    arm = np.array([[0.1, 0, 0.2], [-0.1, 0, 0.2]])
    more = [turned(m, a).rotation.as_matrix() @ arm.T for a in (psi, phi)]
    points = np.concatenate([m.points, *(m.position[:, None] + p.transpose(0, 2, 1) for p in more)], axis=1)
    names = [*(f"board:{n}" for n in PLACES), "rotor:a", "rotor:b", "fore:a", "fore:b"]
    path = put(tmp_path, nexus(points, names))
    options = [
        "--object",
        "board",
        "--front",
        "front",
        "--back",
        "back",
        "--rotor",
        "rotor",
        "--front-wheelset",
        "fore",
    ]
    imported(path, "--out", tmp_path / "case", "--board", BOARD, *options)
    log = read_joint_log(tmp_path / "case" / "take-joints.csv")
    np.testing.assert_allclose(log.psi, psi, atol=1e-4)
    np.testing.assert_allclose(log.phi, phi, atol=1e-4)


def test_a_tilted_floor_is_levelled(tmp_path):
    m = motion(300)
    lean = Rotation.from_rotvec([0.05, 0.02, 0])
    leaning = m._replace(position=lean.apply(m.position), rotation=lean * m.rotation)
    imported(put(tmp_path, tracker({"board": leaning})), "--out", tmp_path / "case", *GIVEN)
    assert "up = [" in (tmp_path / "case" / "case.toml").read_text()
    pose = np.asarray(load_case(tmp_path / "case").runs[0].pose)
    travelled = np.hypot(*np.diff(pose[:, :2], axis=0).T).sum()
    assert travelled == pytest.approx(np.hypot(*np.diff(m.position[:, :2], axis=0).T).sum(), rel=1e-6)
    np.testing.assert_allclose(np.diff(pose[:, 2]), np.diff(m.heading), atol=1e-6)


def test_a_plane_that_is_no_floor_is_said(tmp_path, capsys):
    """Somebody carries the board up some stairs."""
    m = motion(300)
    lean = Rotation.from_rotvec([0.5, 0.0, 0])
    climbing = m._replace(position=lean.apply(m.position), rotation=lean * m.rotation)
    imported(put(tmp_path, tracker({"board": climbing})), "--out", tmp_path / "case", *GIVEN)
    assert "28.6 degrees off, which is not the floor; change the axis with --up" in capsys.readouterr().out
    assert "up =" not in (tmp_path / "case" / "case.toml").read_text()


def test_a_map_of_columns_goes_into_the_case(tmp_path):
    m = motion(200)
    rows = [["clock", "pos x", "pos y", "turn"]]
    rows += [list(map(float, row)) for row in np.column_stack([m.times * 1e3, m.position[:, :2] * 1e3, m.heading])]
    options = ["--columns", "time=clock,x=pos x,y=pos y,heading=turn", "--units", "length=mm,time=ms"]
    imported(put(tmp_path, table(rows)), "--out", tmp_path / "case", *options, *GIVEN)
    run = load_case(tmp_path / "case").runs[0]
    np.testing.assert_allclose(run.pose, np.column_stack([m.position[:, :2], m.heading]), atol=1e-9)
    imported(tmp_path / "case" / "take.csv", *options, "--to", tmp_path / "a.csv")
    np.testing.assert_allclose(read_track(tmp_path / "a.csv", "").pose, run.pose, atol=1e-9)


BOTH = {"board": motion(), "cart": motion()}
COMPLAINTS = {
    "several objects": (["--out", "case"], "There are 2 objects"),
    "no such object": (["--object", "bord"], 'There is no object "bord"'),
    "axis": (["--up", "w"], "`w` is not an axis"),
    "two ways out": (["--to", "a.csv", "--out", "case"], "converts one FILE at a time"),
    "ending": (["--object", "board", "--to", "a.xyz"], "neither .csv nor .tum"),
    "measure": (["--object", "board", "--out", "case", "--board", "mas_kg=1"], "Unknown measure `mas_kg`"),
    "sines": (["--object", "board", "--out", "case", "--phi", "[[1, 2]]"], "is not a list of sines"),
    "half of the joints": (["--object", "board", "--out", "case", "--rotor", "cart"], "needs the rotor and the front"),
    "no such joint": (
        ["--object", "board", "--out", "case", "--rotor", "x", "--front-wheelset", "cart"],
        'There is no object "x"',
    ),
    "columns": (["--columns", "time"], "`time` is not KEY=NAME"),
}


@pytest.mark.parametrize("name", COMPLAINTS)
def test_complaints(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    options, what = COMPLAINTS[name]
    assert main(["import", put(tmp_path, tracker(BOTH)), *options]) == 2
    said = capsys.readouterr().err
    assert what in said and said.count("\n") == 1
    assert not (tmp_path / "case").exists()


def test_nothing_is_written_over(tmp_path, capsys):
    path = put(tmp_path, motive(motion()))
    imported(path, "--out", tmp_path / "case", *GIVEN)
    assert main(["import", path, "--out", str(tmp_path / "case")]) == 2
    assert "already exists" in capsys.readouterr().err
    assert (tmp_path / "case" / "case.toml").read_text().count("[[runs]]") == 1


def test_where_the_x_axis_points_is_written_down(tmp_path, capsys):
    """Also of a bag, whose table keeps the object's own axes; a conversion has no place for it."""
    path = put(tmp_path, motive(motion(200)))
    imported(path, "--out", tmp_path / "case", *GIVEN, "--x-axis", "left")
    imported(path, "--out", tmp_path / "plain", *GIVEN)
    turned, plain = (np.asarray(load_case(tmp_path / name).runs[0].pose) for name in ("case", "plain"))
    np.testing.assert_allclose(turned, plain - [0.0, 0.0, np.pi / 2], rtol=0, atol=1e-12)
    assert main(["import", str(path), "--to", str(tmp_path / "a.csv"), "--x-axis", "left"]) == 2
    assert main(["import", str(path), "--x-axis", "up"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert [line.split(", option")[0].removeprefix("snakejax: error: ") for line in told] == [
        "A converted object keeps its axes",
        "`up` is not a direction on the board",
    ]


def test_a_run_of_another_vehicle_has_the_inputs_of_that(tmp_path, capsys):
    case = tmp_path / "case"
    case.mkdir()
    toml = '[vehicle]\nkind = "car"\nmass_kg = 1.6\ninertia_kgm2 = 0.008\nfront_m = 0.08\nrear_m = 0.09\n'
    (case / "case.toml").write_text(toml)
    imported(put(tmp_path, motive(motion(200))), "--case", case)
    text = (case / "case.toml").read_text()
    assert 'steer = "?"' in text and 'drive = "?"' in text and "phi" not in text.replace("phi_back", "")


def test_a_file_without_any_named_object_is_refused(tmp_path, capsys):
    capture = read_capture(put(tmp_path, motive(motion(200))))
    options = SimpleNamespace(object=None, case="case", to=None)
    with pytest.raises(InputError, match="no object and no named marker"):
        importing._object(options, capture._replace(bodies={}, markers={}))
