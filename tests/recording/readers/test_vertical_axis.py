"""Which way is up where a file tells an axis at most: from where the markers are, from the motion, or by asking."""

import numpy as np
import pytest
from helpers.exports import PLACES, c3d, motion, put, trc, y_up
from scipy.spatial.transform import Rotation

from snakejax import InputError, load_case
from snakejax.commands.cli import main
from snakejax.recording.readers import FileAnnotations, read_capture, read_track

NAMES = [*PLACES]
BOARD = "mass_kg=7,rotor_inertia_kgm2=0.0238,wheelset_inertia_kgm2=0.001,half_length_m=0.25"
ENDS = ["--front", "front", "--back", "back"]
GIVEN = ["--board", BOARD, "--phi", "[[0.9, 4.0, 0.0]]", "--psi", "[]"]


def person(n=200, along=0.0):
    """Somebody walks in place, or `along` [m], z up: feet, knees, hips, hands, head, and no rigid shape."""
    t = np.linspace(0, 4, n)
    swing = 0.25 * np.sin(2 * np.pi * t)
    forward = 0.6 + along * t / 4
    lift = 0.06 * np.maximum(0, np.cos(2 * np.pi * t))
    rows = []
    for side, s in ((0.12, 1), (-0.12, -1)):
        rows += [
            (forward + s * swing, side, 0.04 + (lift if s > 0 else lift[::-1])),
            (forward + s * swing / 2, side, 0.5),
        ]
        rows += [(forward, side, 0.95), (forward - s * swing, 1.8 * side, 0.8)]
    rows += [(forward, 0.0, 1.7 + 0.02 * np.cos(4 * np.pi * t))]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=1)


def named(points):
    return [f"m{i}" for i in range(points.shape[1])]


UP = {
    "z": lambda points: points,
    "y": y_up,
    "x": lambda points: points[..., [2, 0, 1]],
    "-z": lambda points: points * [1, -1, -1],
    "-y": lambda points: y_up(points) * [-1, -1, 1],
}


@pytest.mark.parametrize("up", UP)
@pytest.mark.parametrize("who", ["walks", "passes by", "board"])
def test_trc(tmp_path, up, who):
    points = {"walks": person(), "passes by": person(along=4.0), "board": motion(300).points}[who]
    capture = read_capture(put(tmp_path, trc(UP[up](points), named(points))))
    assert (capture.up, capture.up_open) == (up, False), capture.up_said


def test_a_person_who_stands_is_taller_than_wide(tmp_path):
    points = np.abs(person(200)[:1]).repeat(200, axis=0) + 1e-4 * np.random.default_rng(0).normal(size=(200, 9, 3))
    assert read_capture(put(tmp_path, trc(np.add(y_up(person()), [0.5, 0, 1.0]), named(points)))).up == "y"
    # A shape that keeps is no person.
    assert read_capture(put(tmp_path, trc(points, named(points)))).up_open


SCREENS = {"+Z": "z", "-Z": "z", "+Y": "y", "-Y": "y", "+X": "x"}


@pytest.mark.slow
@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("below", [False, True])
def test_of_a_c3d_the_axis_is_believed_and_the_sign_is_found(tmp_path, screen, below):
    pytest.importorskip("ezc3d")
    axis = SCREENS[screen]
    points = UP[axis](person())
    capture = read_capture(put(tmp_path, c3d(-points if below else points, named(points), up=screen)))
    assert (capture.up, capture.up_known) == (f"-{axis}" if below else axis, True)
    assert ("describes a display" in capture.up_said) == (below != (screen[0] == "-"))


@pytest.mark.slow
def test_a_c3d_whose_sign_nothing_shows(tmp_path):
    pytest.importorskip("ezc3d")
    points = person() - [0.0, 0.0, 1.0]
    path = put(tmp_path, c3d(points, named(points), up="-Z"))
    capture = read_capture(path)
    assert capture.up == "z" and "neither it nor the markers show which direction is up" in capture.up_said
    track = read_track(path, "", FileAnnotations(markers={"m2": (0.12, 0, 0), "m6": (-0.12, 0, 0)}))
    assert any("neither it nor the markers show which direction is up" in note for note in track.notes)


def high(points):
    """Nothing near the floor, nothing that moves: no way is up."""
    return np.add(points[:1].repeat(60, axis=0), [3.0, -3.0, 2.0])


def test_where_nothing_shows_it_a_user_is_asked(tmp_path, capsys, monkeypatch):
    points = high(motion().points)
    path = put(tmp_path, trc(points, NAMES), "take.trc")
    with pytest.raises(InputError, match=r"Neither the TRC nor the motion of its markers shows which way is up.*--up"):
        read_track(path, "", FileAnnotations(markers=PLACES))
    assert main(["import", str(path)]) == 0
    assert "up       is not known, y is a guess: OpenSim writes y, most other programs z" in capsys.readouterr().out
    assert main(["import", str(path), *ENDS, "--to", str(tmp_path / "a.csv")]) == 2
    assert "which way is up" in capsys.readouterr().err
    assert main(["import", str(path), "--out", str(tmp_path / "open"), *GIVEN]) == 0
    assert "up (line" in capsys.readouterr().err
    case = tmp_path / "open" / "case.toml"
    case.write_text(case.read_text().replace('markers = "?"', "markers = {front = [0.2, 0, 0], back = [-0.2, 0, 0]}"))
    with pytest.raises(InputError, match=r'up \(line \d+\) is still "\?"'):
        load_case(tmp_path / "open")
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: "z" if "points up" in question else "")
    assert main(["import", str(path), *ENDS, "--out", str(tmp_path / "case"), *GIVEN]) == 0
    assert 'up = "z"' in (tmp_path / "case" / "case.toml").read_text()
    assert load_case(tmp_path / "case").reading == {}


@pytest.mark.slow
@pytest.mark.parametrize("format", ["trc", "c3d"])
@pytest.mark.parametrize("up", ["y", "-y"])
def test_a_case_says_which_way_is_up(tmp_path, capsys, format, up):
    """Turned to z up, the board is where it was, from whatever side its axis is seen."""
    pytest.importorskip("ezc3d")
    m = motion(200)
    points = UP[up](m.points)
    # Seen with -y up, x points the other way too.
    content = trc(points, NAMES) if format == "trc" else c3d(points, NAMES, up="-Y")
    path = put(tmp_path, content, f"take.{format}")
    assert main(["import", str(path), *ENDS, "--out", str(tmp_path / "case"), *GIVEN]) == 0
    assert f"{up}: perpendicular to the plane in which the object moves" in capsys.readouterr().out
    pose = np.asarray(load_case(tmp_path / "case").runs[0].pose)
    assert pose[-1, 2] - pose[0, 2] == pytest.approx(m.heading[-1] - m.heading[0], abs=1e-3)
    assert main(["check", str(tmp_path / "case")]) == 0
    assert f"up is {up}: " in capsys.readouterr().out


def test_a_tilted_floor_seen_along_minus_y(tmp_path):
    m = motion(300)
    lean = Rotation.from_rotvec([0.05, 0, 0.02])
    points = UP["-y"](m.points)
    leaning = np.stack([lean.apply(part) for part in points])
    path = put(tmp_path, trc(leaning, NAMES), "take.trc")
    assert main(["import", str(path), *ENDS, "--out", str(tmp_path / "case"), *GIVEN]) == 0
    pose = np.asarray(load_case(tmp_path / "case").runs[0].pose)
    np.testing.assert_allclose(pose[:, 2] - pose[0, 2], m.heading - m.heading[0], atol=1e-3)


@pytest.mark.slow
def test_real_files(realdata):
    """Heads are above feet."""
    found = read_capture(realdata / "opensim_y_up.trc")
    assert (found.up, found.up_open) == ("y", False)
    assert np.nanmedian(found.markers["Sternum"][:, 1]) > np.nanmedian(found.markers["R.Heel"][:, 1]) + 1
    assert read_capture(realdata / "pyomeca_markers.trc").up == "z"
    pytest.importorskip("ezc3d")
    found = read_capture(realdata / "qualisys_y_screen.c3d")
    assert found.up == "z" and "Y_SCREEN -Z describes a display" in found.up_said
    assert np.nanmedian(found.markers["L_HDF"][:, 2]) > np.nanmedian(found.markers["L_FM1"][:, 2]) + 1
    assert read_capture(realdata / "optitrack_walking.c3d").up == "z"
    assert read_capture(realdata / "sample_static_optotrak.c3d").up_open


def test_the_plane_in_which_a_person_walks_is_no_floor(tmp_path, capsys):
    points = person(along=6.0)
    points[..., 1] *= 0.01
    path = put(tmp_path, trc(points, named(points)), "sprint.trc")
    assert main(["import", str(path)]) == 0
    assert "up       z, its markers lie above the floor that way" in capsys.readouterr().out
