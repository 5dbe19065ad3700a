"""Vicon Tracker CSV and joint logs: what is read, and what is said about what cannot be."""

import math
from pathlib import Path

import numpy as np
import pytest

from snakejax.core.errors import InputError
from snakejax.recording.readers import read_joint_log, read_track
from snakejax.recording.readers.vicon import ANGLED, QUATERNION

FRAMES = 12
MM = ("rad", "rad", "rad", "mm", "mm", "mm")


def tracker_csv(rows, columns=ANGLED, units=MM, objects=("board:board",), rate="100", section="Objects", frames=None):
    """The text of a Tracker CSV whose `rows` hold the cells of all objects."""
    frames = range(1, len(rows) + 1) if frames is None else frames
    names = ",".join(f"Global Angle {name}" + "," * (len(columns) - 1) for name in objects)
    lines = [section, rate, f",,{names}", ",".join(["Frame", "Sub Frame", *columns * len(objects)])]
    lines += [",".join(["", "", *units * len(objects)])]
    lines += [",".join([str(f), "0", *map(str, row)]) for f, row in zip(frames, rows, strict=True)]
    return "\r\n".join(lines) + "\r\n"


def straight(n=FRAMES, heading=0.0):
    return [[0.0, 0.0, heading, 10.0 * i, -5.0, 60.0] for i in range(n)]


def write(folder: Path, text: str, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def read(folder: Path, text: str, object: str = "board:board"):
    return read_track(write(folder, text), object)


def test_pose_and_time(tmp_path):
    track = read(tmp_path, tracker_csv(straight(heading=0.5)))
    assert track.rate == 100
    np.testing.assert_allclose(track.times, np.arange(FRAMES) / 100)
    np.testing.assert_allclose(track.pose[3], [0.03, -0.005, 0.5])


@pytest.mark.parametrize(("angle", "length"), [("deg", "m"), ("deg", "cm"), ("rad", "m"), ("deg", "mm")])
def test_units_row_is_obeyed(tmp_path, angle, length):
    turn = {"rad": 1.0, "deg": 180 / math.pi}[angle]
    scale = {"mm": 1.0, "cm": 0.1, "m": 0.001}[length]
    rows = [[0.01 * turn, 0.0, 0.1 * i * turn, 10.0 * i * scale, -5.0 * scale, 60 * scale] for i in range(FRAMES)]
    track = read(tmp_path, tracker_csv(rows, units=(*[angle] * 3, *[length] * 3)))
    np.testing.assert_allclose(track.pose, [[0.01 * i, -0.005, 0.1 * i] for i in range(FRAMES)], atol=1e-12)


def test_heading_is_unwrapped_through_gaps(tmp_path):
    turn = 0.4 * np.arange(40)
    rows = [[0, 0, (a + math.pi) % (2 * math.pi) - math.pi, 0, 0, 0] for a in turn]
    for i in (0, 7, 8, 9, 30):
        rows[i] = [""] * 6
    pose = read(tmp_path, tracker_csv(rows)).pose
    lost = np.isnan(pose).any(axis=1)
    assert list(np.flatnonzero(lost)) == [0, 7, 8, 9, 30]
    np.testing.assert_allclose(pose[~lost, 2], turn[~lost])


def test_one_blank_cell_loses_the_frame(tmp_path):
    rows = straight()
    rows[4][3] = ""
    assert np.isnan(read(tmp_path, tracker_csv(rows)).pose[4]).all()


def test_skipped_frames_are_missing(tmp_path):
    track = read(tmp_path, tracker_csv(straight(), frames=[*range(101, 107), *range(110, 116)]))
    np.testing.assert_allclose(track.times, np.arange(15) / 100)
    assert list(np.flatnonzero(np.isnan(track.pose[:, 0]))) == [6, 7, 8]
    np.testing.assert_allclose(track.pose[9, 0], 0.06)


def test_quaternion_equals_euler(tmp_path):
    headings = np.linspace(0, 9, 30)
    quaternions = [[0, 0, math.sin(a / 2), math.cos(a / 2), 1, 2, 3] for a in headings]
    wrapped = [[0, 0, math.remainder(a, 2 * math.pi), 1, 2, 3] for a in headings]
    units = ("", "", "", "", "mm", "mm", "mm")
    by_quaternion = read(tmp_path, tracker_csv(quaternions, columns=QUATERNION, units=units)).pose
    np.testing.assert_allclose(by_quaternion, read(tmp_path, tracker_csv(wrapped)).pose, atol=1e-12)
    np.testing.assert_allclose(by_quaternion[:, 2], headings)


@pytest.mark.parametrize(
    "change", [lambda t: "\ufeff" + t, lambda t: t.replace("\r\n", "\n"), lambda t: t + ",,,,,,,\r\n"]
)
def test_dialects(tmp_path, change):
    text = tracker_csv(straight())
    np.testing.assert_array_equal(read(tmp_path, change(text)).pose, read(tmp_path, text).pose)


def test_semicolons_with_decimal_commas(tmp_path):
    text = tracker_csv([[0, 0, 0.25, 1.5, 2.5, 3.5]] * FRAMES)
    european = text.replace(",", ";").replace(".", ",")
    np.testing.assert_array_equal(read(tmp_path, european).pose, read(tmp_path, text).pose)


def test_segments_and_other_sections(tmp_path):
    text = tracker_csv(straight(), section="Segments")
    other = "Devices\r\n1000\r\n,,Force\r\nFrame,Sub Frame,Fx\r\n,,N\r\n1,0,5\r\n\r\n"
    np.testing.assert_array_equal(read(tmp_path, other + text).pose, read(tmp_path, text).pose)


def test_the_object_asked_for(tmp_path):
    rows = [a + b for a, b in zip(straight(heading=1.0), straight(heading=2.0), strict=True)]
    text = tracker_csv(rows, objects=("cart:cart", "board:board"))
    assert read(tmp_path, text).pose[0, 2] == 2.0
    assert read(tmp_path, text, "cart:cart").pose[0, 2] == 1.0


GOOD = tracker_csv(straight())
ROW = "4,0,0.0,0.0,0.0,30.0,-5.0,60.0"
QUATERNIONS = tracker_csv([[0, 0, 0, 2, 0, 0, 0]] * FRAMES, columns=QUATERNION, units=("", *MM))
COMPLAINTS = {
    "missing column": (GOOD.replace("RZ,TX,TY,TZ", "RZ,TX,TY"), 4, "Missing column TZ", "RX,RY,RZ,TX,TY,TZ"),
    "extra column": (GOOD.replace("TX,TY,TZ", "TX,TY,TZ,QQ"), 4, "Extra column QQ", "export RX,RY"),
    "column twice": (GOOD.replace("TX,TY,TZ", "TX,TY,TZ,TZ"), 4, "Extra column TZ", "export RX,RY"),
    "missing frame column": (GOOD.replace("Frame,Sub Frame", "Sub Frame,Frame"), 4, "Missing column Frame", "begin"),
    "unknown unit": (GOOD.replace("rad,mm,", "rad,inch,"), 5, 'Unknown unit "inch" of column TX', "mm or cm or m"),
    "blank unit": (GOOD.replace(",,rad,", ",,,"), 5, 'Unknown unit "" of column RX', "rad or deg"),
    "object": (GOOD.replace("board:board", "bord:bord"), 3, 'no object "board:board"', 'write "bord:bord"'),
    "few samples": (tracker_csv([*straight(9), *[[""] * 6] * 5]), 6, "Only 9 samples", "check that"),
    "backwards": (GOOD.replace("\n4,0", "\n2,0"), 9, "Frame 2 comes after frame 3: time runs backwards", "sort"),
    "duplicate": (GOOD.replace("\n4,0", "\n3,0"), 9, "Frame 3 comes twice", "keep one"),
    "huge skip": (GOOD.replace("\n12,0", "\n9000000,0"), 17, "jumps from 11 to 9000000", "correct"),
    "fraction": (GOOD.replace("\n4,0", "\n4.5,0"), 9, '"4.5" is not whole', "number the frames"),
    "nan": (GOOD.replace(ROW, ROW.replace("30.0", "nan")), 9, '"nan" for TX is not a finite number', "blank"),
    "inf": (GOOD.replace(ROW, ROW.replace("30.0", "-inf")), 9, '"-inf" for TX is not a finite number', "blank"),
    "unreadable": (GOOD.replace(ROW, ROW.replace("30.0", "3O.0")), 9, '"3O.0" for TX', "write a finite number"),
    "short row": (GOOD.replace(ROW, "4,0,0.0"), 9, "3 cells, but there are 8 columns", "complete the row"),
    "long row": (GOOD.replace(ROW, ROW + ",7"), 9, "9 cells, but there are 8 columns", "complete the row"),
    "blank line": (GOOD.replace(ROW, ""), 9, "A blank line divides the data", "remove the line"),
    "rate": (GOOD.replace("\r\n100\r\n", "\r\n0\r\n"), 2, "The frame rate is not above 0", "frames per second"),
    "rate text": (GOOD.replace("\r\n100\r\n", "\r\nfast\r\n"), 2, '"fast" for the frame rate', "finite"),
    "no frames": ("\r\n".join(GOOD.split("\r\n")[:5]), 5, "ends before its first frame", "export"),
    "quaternion": (QUATERNIONS, 6, 'quaternion of "board:board" is not of length 1', "RX,RY,RZ,RW"),
    "empty": ("", 1, "The file is empty", "export"),
    "other format": ("Dear reader\r\n0,1,2\r\n", 1, 'begins with "Dear reader"', "Vicon CSV, C3D"),
}


@pytest.mark.parametrize("name", COMPLAINTS)
def test_complaint(tmp_path, name):
    text, line, what, remedy = COMPLAINTS[name]
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert what in caught.value.what and remedy in caught.value.remedy
    assert caught.value.where == f"{tmp_path / 'run.csv'} line {line}"
    assert message == f"{caught.value.what}, {caught.value.where}: {caught.value.remedy}" and "\n" not in message


def test_objects_that_are_there_are_listed(tmp_path):
    text = tracker_csv([[*a, *a] for a in straight()], objects=("cart:cart", "wand:wand"))
    with pytest.raises(InputError, match=r"line 3: .*known: cart:cart, wand:wand"):
        read(tmp_path, text)


def test_object_twice(tmp_path):
    text = tracker_csv([[*a, *a] for a in straight()], objects=("board:board", "board:board"))
    with pytest.raises(InputError, match=r'"board:board" is there 2 times, .*line 3: rename'):
        read(tmp_path, text)


def test_not_utf8(tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(GOOD.encode().replace(b"4,0,", b"4,0\xff,"))
    with pytest.raises(InputError, match=r"not UTF-8, .*run.csv line 9: save it again as UTF-8"):
        read_track(path, "board:board")


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"Cannot read the file \(No such file.*run.csv: check"):
        read_track(tmp_path / "run.csv", "board:board")


LOG = "time_s,phi_rad,psi_rad\n" + "".join(f"{0.1 * i:.1f},{i},{-i}\n" for i in range(6))


def test_joint_log(tmp_path):
    log = read_joint_log(write(tmp_path, LOG))
    np.testing.assert_allclose(log.times, 0.1 * np.arange(6))
    np.testing.assert_array_equal([log.phi, log.psi], [np.arange(6), -np.arange(6)])
    assert log.phi_back is None


def test_joint_log_in_any_order_with_the_back(tmp_path):
    rows = "".join(f"{4 * i},{3 * i},{2 * i},{i}\n" for i in range(6))
    log = read_joint_log(write(tmp_path, "phi_back_rad,psi_rad,phi_rad,time_s\n" + rows))
    for part, factor in zip(log, (1, 2, 3, 4), strict=True):
        np.testing.assert_array_equal(part, factor * np.arange(6))


LOG_COMPLAINTS = {
    "missing column": (LOG.replace(",psi_rad", ""), 1, "Missing column psi_rad", "time_s,phi_rad,psi_rad"),
    "extra column": (LOG.replace("psi_rad", "psi_deg"), 1, 'Extra column "psi_deg"', 'write "psi_rad"'),
    "column twice": (LOG.replace("psi_rad", "phi_rad"), 1, 'Extra column "phi_rad"', "remove it"),
    "backwards": (LOG.replace("0.3,", "0.1,"), 5, "from 0.2 s to 0.1 s: it runs backwards", "sort the rows"),
    "nan": (LOG.replace("0.3,3", "0.3,nan"), 5, '"nan" for phi_rad', "finite"),
    "blank": (LOG.replace("0.3,3", "0.3,"), 5, "The cell of phi_rad is blank", "fill"),
    "short row": (LOG.replace("0.3,3,-3", "0.3,3"), 5, "2 cells, but there are 3 columns", "complete"),
    "few rows": ("\n".join(LOG.split("\n")[:4]), 4, "has 3 rows, but at least 4", "whole run"),
}


@pytest.mark.parametrize("name", LOG_COMPLAINTS)
def test_complaint_about_a_joint_log(tmp_path, name):
    text, line, what, remedy = LOG_COMPLAINTS[name]
    with pytest.raises(InputError) as caught:
        read_joint_log(write(tmp_path, text, "joints.csv"))
    assert what in caught.value.what and remedy in caught.value.remedy
    assert caught.value.where == f"{tmp_path / 'joints.csv'} line {line}"
