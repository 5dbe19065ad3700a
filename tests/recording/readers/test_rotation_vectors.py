"""RX, RY, RZ of Vicon: a rotation vector or Euler angles, told apart by which of them keeps a board level."""

import json

import numpy as np
import pytest
from helpers.exports import table
from helpers.folders import DATA
from scipy.spatial.transform import Rotation

from snakejax import InputError, load_case
from snakejax.commands.cli import main
from snakejax.recording.quality.finding import PoseSeries
from snakejax.recording.quality.inspection import find_defects
from snakejax.recording.readers import FileAnnotations, read_capture, read_track

BOARD = "mass_kg=7,rotor_inertia_kgm2=0.0238,wheelset_inertia_kgm2=0.001,half_length_m=0.25"
GIVEN = ["--board", BOARD, "--phi", "[[0.9, 4.0, 0.0]]", "--psi", "[]"]


def heading(n=400, turns=1.4):
    s = np.linspace(0, 1, n)
    return 0.4 + 2 * np.pi * turns * s + 0.2 * np.sin(9 * s)


def board(turn, frame=(0.02, -0.03), floor=(0.0, 0.0), noise=0.0):
    """The rotations of a board with headings `turn` [rad], whose object's axes are tilted by `frame` against it."""
    shake = Rotation.from_rotvec(noise * np.random.default_rng(0).normal(size=(len(turn), 3)))
    lean, tilt = (Rotation.from_rotvec([*by, 0.0]) for by in (floor, frame))
    return lean * Rotation.from_rotvec(np.outer(turn, [0, 0, 1])) * tilt * shake


def long_vectors(rotation):
    """Rotation vectors that go on past pi up to a full turn, as those of Tracker do."""
    found = rotation.as_rotvec()
    for i in range(1, len(found)):
        length = np.linalg.norm(found[i])
        others = [found[i], found[i] * (1 - 2 * np.pi / length)]
        found[i] = min(others, key=lambda v: np.linalg.norm(v - found[i - 1]))
    return found


def put(folder, angles, name="take.csv", turn=None):
    turn = np.arange(len(angles)) if turn is None else turn
    rows = [["Objects"], ["100"], ["", "", "Global Angle board:board", *[""] * 5]]
    rows += [["Frame", "Sub Frame", "RX", "RY", "RZ", "TX", "TY", "TZ"], ["", "", *["rad"] * 3, *["mm"] * 3]]
    place = np.column_stack([800 * np.sin(turn / 99), 500 * np.cos(turn / 77), np.full(len(turn), 60.0)])
    rows += [
        [i + 1, 0, *(f"{a:.9f}" for a in v), *map(float, p)] for i, (v, p) in enumerate(zip(angles, place, strict=True))
    ]
    path = folder / name
    path.write_text(table(rows))
    return path


WRITTEN = {
    "helical": long_vectors,
    "xyz": lambda rotation: rotation.as_euler("xyz"),
    "XYZ": lambda rotation: rotation.as_euler("XYZ"),
}


LEANING = {"axes": {"frame": (0.02, -0.03)}, "floor": {"frame": (0.0, 0.0), "floor": (0.03, 0.02)}}


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("written", WRITTEN)
@pytest.mark.parametrize("leaning", LEANING)
def test_the_data_tell_which_it_is(tmp_path, written, leaning, noise):
    turn = heading()
    rotation = board(turn, noise=noise, **LEANING[leaning])
    angles = WRITTEN[written](rotation)
    path = put(tmp_path, angles)
    capture = read_capture(path)
    found = read_track(path, "board:board").pose[:, 2]
    np.testing.assert_allclose(found - found[0], turn - turn[0], atol=3e-3 + 8 * noise)
    if (written, leaning) == ("XYZ", "floor"):
        return  # The same numbers are axes that lean on their board, about fixed axes; the heading is alike.
    apart = Rotation.from_quat(capture.bodies["board:board"].rotation) * rotation.inv()
    assert capture.angles["board:board"].angles == written and apart.magnitude().max() < 1e-8
    assert written != "helical" or np.linalg.norm(angles, axis=1).max() > np.pi


def test_lost_and_mistracked_frames_do_not_matter(tmp_path):
    turn = heading()
    euler = board(turn, noise=1e-3).as_euler("xyz")
    flipped = board(turn, noise=1e-3) * Rotation.from_rotvec([np.pi, 0, 0])
    euler[50:90] = flipped.as_euler("xyz")[50:90]
    assert read_capture(put(tmp_path, euler)).angles["board:board"].angles == "xyz"


def test_where_the_data_do_not_tell_it_is_a_rotation_vector(tmp_path):
    rng = np.random.default_rng(0)
    straight = put(tmp_path, [[0.05, 0.02, 0.5]] + 1e-4 * rng.normal(size=(100, 3)))
    reading = read_capture(straight).angles["board:board"]
    assert reading.angles == "helical" and "the motion does not show it" in reading.description
    tumbling = Rotation.from_rotvec(np.cumsum(rng.normal(size=(400, 3)), axis=0) * 0.2)
    path = put(tmp_path, long_vectors(tumbling), "tumbling.csv")
    reading = read_capture(path).angles["board:board"]
    assert reading.angles == "helical" and "degrees long" in reading.description
    unseen = put(tmp_path, np.full((20, 3), np.nan), "unseen.csv")
    unseen.write_text(unseen.read_text().replace("nan", ""))
    assert "never tracked" in read_capture(unseen).angles["board:board"].description


def test_a_user_overrules(tmp_path, capsys):
    turn = heading()
    path = put(tmp_path, WRITTEN["helical"](board(turn)))
    assert main(["import", str(path), "--json", str(tmp_path / "a.json")]) == 0
    assert "a rotation vector (helical): the normal of the body then swings by" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())[str(path)]["angles"] == {"board:board": "helical"}
    told = read_capture(path, FileAnnotations(angles="xyz")).bodies["board:board"].rotation
    expected = Rotation.from_euler("xyz", WRITTEN["helical"](board(turn)))
    assert (Rotation.from_quat(told) * expected.inv()).magnitude().max() < 1e-8
    assert main(["import", str(path), "--out", str(tmp_path / "case"), *GIVEN, "--angles", "xyz"]) == 0
    assert 'angles = "xyz"' in (tmp_path / "case" / "case.toml").read_text()
    assert "Euler angles about the fixed axes x, y, z, as given" in load_case(tmp_path / "case").reading["take"][0]
    assert main(["import", str(path), "--angles", "euler"]) == 2
    assert "`euler` is not a kind of angles" in capsys.readouterr().err
    case = tmp_path / "case" / "case.toml"
    case.write_text(case.read_text().replace('"xyz"', '"zyx"'))
    with pytest.raises(InputError, match=r"angles in \[\[runs\]\] 1 cannot be 'zyx'"):
        load_case(tmp_path / "case")


def test_check_says_it_of_a_run(tmp_path, capsys):
    path = put(tmp_path, WRITTEN["helical"](board(heading())))
    assert main(["import", str(path), "--out", str(tmp_path / "case"), *GIVEN, "--quiet"]) == 0
    assert main(["check", str(tmp_path / "case"), "--json", str(tmp_path / "check.json")]) == 0
    assert "RX, RY, RZ are a rotation vector (helical): the normal" in " ".join(capsys.readouterr().out.split())
    said = json.loads((tmp_path / "check.json").read_text())["reading"]["take"]
    assert len(said) == 1 and said[0].startswith("RX, RY, RZ are a rotation vector")


@pytest.mark.parametrize("path", sorted(DATA.glob("*-*/*.csv")), ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_the_heading_of_the_bundled_runs_is_their_third_angle(path):
    """They are level, so both readings agree, and nothing is added to what the file holds."""
    lines = path.read_text().splitlines()[5:]
    third = np.array([float(cells[4]) if (cells := line.split(","))[4] else np.nan for line in lines])
    found = read_track(path, "board:board").pose[:, 2]
    np.testing.assert_allclose(np.angle(np.exp(1j * (found - third))), np.where(np.isnan(third), third, 0), atol=1e-14)


def test_a_real_robot_turns_once_and_nothing_is_wrong_with_it(realdata):
    """A robot goes once round a square, clockwise."""
    path = realdata / "vicon_tracker_helical_robot.csv"
    track = read_track(path, "QBii:QBii")
    assert np.degrees(track.pose[-1, 2] - track.pose[0, 2]) == pytest.approx(-360, abs=1)
    angles = np.genfromtxt(path, delimiter=",", skip_header=5, encoding="utf-8-sig")[:, 2:5]
    R = Rotation.from_rotvec(angles).as_matrix()
    np.testing.assert_allclose(track.pose[:, 2], np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0])), atol=1e-12)
    assert find_defects(PoseSeries(track.times, track.pose))[1] == []
