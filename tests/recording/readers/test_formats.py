"""Every format of motion capture: the same motion comes out, whichever program exported it."""

import numpy as np
import pytest
from helpers.exports import PLACES, RATE, c3d, motion, motive, nexus, put, qualisys_bodies, qualisys_markers, table, trc
from scipy.spatial.transform import Rotation

from snakejax import InputError
from snakejax.recording.capture_summary import summary, summary_text
from snakejax.recording.readers import FileAnnotations, read_capture, read_track, write_csv, write_tum

NAMES = [f"board:{name}" for name in PLACES]
LOST = {(7, 0), (8, 0), (30, 2)}


def gappy():
    points = motion().points.copy()
    for frame, marker in LOST:
        points[frame, marker] = np.nan
    return points


MARKER_FILES = {
    "nexus": lambda p: nexus(p, NAMES),
    "nexus in m": lambda p: nexus(p, NAMES, "m"),
    "nexus, European": lambda p: nexus(p, NAMES).replace(",", ";").replace(".", ","),
    "trc": lambda p: trc(p, NAMES),
    "trc with commas": lambda p: trc(p, NAMES, ","),
    "trc in m": lambda p: trc(p, NAMES, unit="m"),
    "trc with decimal commas": lambda p: trc(p, NAMES).replace(".", ","),
    "qualisys": lambda p: qualisys_markers(p, NAMES),
    "qualisys without titles": lambda p: qualisys_markers(p, NAMES, titled=False),
}


@pytest.mark.parametrize("name", MARKER_FILES)
def test_markers(tmp_path, name):
    capture = read_capture(put(tmp_path, MARKER_FILES[name](gappy())))
    assert [*capture.markers] == NAMES and not capture.bodies and not capture.doubled and not capture.notes
    assert capture.rate == RATE
    np.testing.assert_allclose(capture.times, motion().times, atol=1e-12)
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), gappy(), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "up"), [("mm", "+Z"), ("m", "+Y")])
def test_c3d(tmp_path, unit, up):
    pytest.importorskip("ezc3d")
    capture = read_capture(put(tmp_path, c3d(gappy(), NAMES, unit, up=up)))
    assert [*capture.markers] == NAMES and (capture.up, capture.up_known) == (up[1].lower(), True)
    # The file holds numbers of four bytes.
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), gappy(), atol=1e-6)


def without_names(text, labels=True):
    """A TRC of markers that nobody named, with X1, Y1, Z1, ... above them or not."""
    lines = text.split("\n")
    lines[3] = "Frame#\tTime" + "\t" * 12
    if not labels:
        lines[4] = ""
    return "\n".join(lines)


NAMELESS = {
    "none": lambda t: without_names(t),
    "none, and no axes": lambda t: without_names(t, labels=False),
    "none, and no row of axes": lambda t: "\n".join(without_names(t).split("\n")[:4] + t.split("\n")[6:]),
    "the last two": lambda t: t.replace("board:left", "").replace("board:mast", ""),
    "more columns than names": lambda t: t.replace("\tboard:mast\t\t", "").replace("\tX4\tY4\tZ4", ""),
}


@pytest.mark.parametrize("name", NAMELESS)
def test_trc_markers_without_names(tmp_path, name):
    capture = read_capture(put(tmp_path, NAMELESS[name](trc(gappy(), NAMES))))
    named = 0 if name.startswith("none") else 2 if name == "the last two" else 3
    assert [*capture.markers] == NAMES[:named] + [f"marker {i + 1}" for i in range(named, 4)]
    assert f"{4 - named} of its markers have no name" in capture.notes[0]
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), gappy(), atol=1e-9)


def test_trc_dialects(tmp_path):
    text = trc(gappy(), NAMES)
    for changed in (text.replace("\tmm\t", "\tMM\t"), text.replace("Frame#\tTime", "frame\ttime")):
        capture = read_capture(put(tmp_path, changed))
        np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), gappy(), atol=1e-9)


MOTIVE = {
    "quaternion": {},
    "Euler angles": {"rotation": "XYZ"},
    "Euler angles, another order": {"rotation": "YZX"},
    "in mm": {"unit": "Millimeters"},
}


@pytest.mark.parametrize("name", MOTIVE)
def test_motive_has_y_up(tmp_path, name):
    track = read_track(put(tmp_path, motive(motion(tilt=0.02), lost=(3, 4), **MOTIVE[name])), "board")
    expected = np.column_stack([motion().position[:, :2], motion(tilt=0.02).heading])
    expected[3:5] = np.nan
    # A leaning board's heading is that of its x axis, up to the square of the lean.
    np.testing.assert_allclose(track.pose, expected, atol=3e-4)
    level = read_track(put(tmp_path, motive(motion(), **MOTIVE[name])), "board")
    np.testing.assert_allclose(level.pose[:, 2], motion().heading, atol=1e-9)


def test_motive_markers(tmp_path):
    capture = read_capture(put(tmp_path, motive(motion())))
    assert [*capture.markers] == ["board_1"] and capture.up == "y" and "1 unlabelled" in capture.notes[0]


def test_motive_axes_in_small_letters(tmp_path):
    """Somebody has edited the header."""
    text = motive(motion()).replace("Seconds),X,Y,Z,W,", "Seconds),x,Y,Z,w,")
    np.testing.assert_allclose(read_track(put(tmp_path, text), "board").pose[:, 2], motion().heading, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("X,Y,Z,W,X,", "X,Y,Z,Q,X,", 'Rotation W of "board" is missing: its columns are X, Y, Z, Q'),
        ("X,Y,Z,W,X,", "A,Y,Z,B,X,", 'Rotation X and W of "board" is missing'),
        ("Z,W,X,Y,Z,", "Z,W,X,Y,,", 'Position Z of "board" is missing'),
        ("Rotation,Rotation,Rotation,Rotation", ",,,", 'The Rigid Body "board" has a position, but no rotation'),
    ],
)
def test_motive_says_which_axis_is_missing(tmp_path, old, new, what):
    text = motive(motion())
    assert old in text
    with pytest.raises(InputError) as caught:
        read_capture(put(tmp_path, text.replace(old, new, 1)))
    assert what in caught.value.what


def test_names_that_come_twice_are_listed(tmp_path, capsys):
    names = ["front", "back", "front", "front"]
    for content in (nexus(gappy(), names), trc(gappy(), names), qualisys_markers(gappy(), names)):
        capture = read_capture(put(tmp_path, content))
        assert capture.doubled == ("front", "front") and [*capture.markers] == ["front", "back"]
        assert "front (3 times)" in summary_text(capture, {}) and summary(capture)["doubled"] == ["front"]
        with pytest.raises(InputError, match='The marker "front" appears twice'):
            read_track(
                tmp_path / "recording", "", FileAnnotations(markers={"front": (0.2, 0, 0), "back": (-0.2, 0, 0)})
            )
    text = motive(motion()).replace("board_1,board_1,board_1,Unlabeled:7,Unlabeled:7,Unlabeled:7", ",".join(["b"] * 6))
    assert read_capture(put(tmp_path, text)).doubled == ["b"]


@pytest.mark.parametrize("titled", [True, False])
def test_qualisys_bodies(tmp_path, titled):
    both = {"cart": motion(), "board": motion(tilt=0.02)}
    path = put(tmp_path, qualisys_bodies(both, titled, lost=(5,)))
    pose = read_track(path, "board").pose
    assert list(np.flatnonzero(np.isnan(pose[:, 0]))) == [5]
    expected = np.column_stack([motion().position[:, :2], motion().heading])
    np.testing.assert_allclose(np.delete(pose, 5, 0), np.delete(expected, 5, 0), atol=3e-4)
    body = read_capture(path).bodies["board"]
    there = np.isfinite(body.rotation[:, 0])
    np.testing.assert_allclose(
        np.abs((body.rotation[there] * both["board"].rotation.as_quat()[there]).sum(axis=1)), 1.0, atol=1e-9
    )


def spaced_bodies(motions, titled, timed, yaw_first=False, gone=()):
    """Several bodies as QTM writes them: an empty column after each, and titles once for all, each with a space, or
    for each body; by what is `gone`, cells that are blank where that body was not seen.
    """
    angles = ["Yaw", "Pitch", "Roll"] if yaw_first else ["Roll", "Pitch", "Yaw"]
    parts = ["X", "Y", "Z", *angles, "Residual", *(f"Rot[{i}]" for i in range(9))]
    rows = [["NO_OF_FRAMES", 60], ["NO_OF_BODIES", len(motions)], ["FREQUENCY", 100], ["DATA_INCLUDED", "6D"]]
    rows += [["BODY_NAMES", *motions, ""]]
    lead = ["Frame", "Time"] if timed else []
    if titled == "once":
        rows += [[*lead, *(f" {part}" for part in parts)]]
    elif titled == "each":
        rows += [[*lead, *(c for name in motions for c in (f"{name} X", *parts[1:], ""))]]
    for i in range(60):
        row = [i + 1, f"{i / RATE:.5f}"] if timed else []
        for name, m in motions.items():
            R = m.rotation[i]
            turned = R.as_euler("ZYX" if yaw_first else "XYZ", degrees=True)
            cells = [*m.position[i] * 1e3, *turned, 0.3, *R.as_matrix().T.ravel()]
            row += [*(("",) * 16 if name in gone and i < 40 else map(float, cells)), ""]
        rows.append(row)
    return table(rows, "\t")


@pytest.mark.parametrize("titled", ["once", "each", "never"])
@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("yaw_first", [True, False])
@pytest.mark.parametrize("gone", [(), ("a",), ("cart",), ("cart", "a")])
def test_qualisys_bodies_with_an_empty_column_after_each(tmp_path, titled, timed, yaw_first, gone):
    bodies = {"a": motion(tilt=0.02), "board": motion(tilt=0.4), "cart": motion(turns=-0.4)}
    found = read_capture(put(tmp_path, spaced_bodies(bodies, titled, timed, yaw_first, gone))).bodies
    assert [*found] == [*bodies]
    for name, m in bodies.items():
        seen = slice(40, None) if name in gone else slice(None)
        assert np.isnan(found[name].position[:40]).all() == (name in gone)
        np.testing.assert_allclose(found[name].position[seen], m.position[seen], atol=1e-12)
        apart = Rotation.from_quat(found[name].rotation[seen]) * m.rotation[seen].inv()
        assert apart.magnitude().max() < 1e-7


def test_one_qualisys_body_with_old_titles(tmp_path):
    for timed in (True, False):
        text = spaced_bodies({"board": motion()}, "once", timed, yaw_first=True)
        pose = read_track(put(tmp_path, text), "board").pose
        np.testing.assert_allclose(pose[:, 2], motion().heading, atol=1e-7)
        assert timed or "\r\n X\t Y" in text


def test_a_matrix_written_by_rows(tmp_path):
    text = qualisys_bodies({"board": motion(tilt=0.3)})
    lines = text.split("\r\n")
    for k in range(5, 65):
        cells = lines[k].split("\t")
        cells[-9:] = np.array(cells[-9:]).reshape(3, 3).T.ravel()
        lines[k] = "\t".join(cells)
    found = read_capture(put(tmp_path, "\r\n".join(lines))).bodies["board"].rotation
    assert (Rotation.from_quat(found) * motion(tilt=0.3).rotation.inv()).magnitude().max() < 1e-7


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_any_axis_may_point_up(tmp_path, up):
    axis = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}[up[-1]]
    axis = np.array(axis, float) * (-1 if up[0] == "-" else 1)
    turn = Rotation.align_vectors([axis], [[0, 0, 1]])[0]
    m = motion()
    # The body's axes are the world's at heading zero, as programs that track bodies have them.
    quaternion = (turn * m.rotation * turn.inv()).as_quat()
    rows = [["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]]
    rows += [map(float, row) for row in np.column_stack([m.times, turn.apply(m.position), quaternion])]
    pose = read_track(put(tmp_path, table(rows)), "board", FileAnnotations(up=up)).pose
    # Which way is zero is left open: compare motion as seen from above, up to a turn and a shift in the plane.
    np.testing.assert_allclose(pose[:, 2] - pose[0, 2], m.heading - m.heading[0], atol=1e-9)

    def seen_from_the_board(xy, heading):
        d, c, s = xy - xy[0], np.cos(heading[0]), np.sin(heading[0])
        return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]])

    before = seen_from_the_board(m.position[:, :2], m.heading)
    after = seen_from_the_board(pose[:, :2], pose[:, 2])
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1), atol=1e-9)
    angle = np.unwrap(np.arctan2(*after[1:, ::-1].T)) - np.unwrap(np.arctan2(*before[1:, ::-1].T))
    np.testing.assert_allclose(angle, angle[0], atol=1e-7)


def plain(**changes):
    m = motion()
    columns = {"time": m.times + 1.7e9, "x": m.position[:, 0], "y": m.position[:, 1], "yaw": m.heading} | changes
    rows = [
        [*columns],
        *([f"{v:.17g}" if isinstance(v, float) else v for v in row] for row in zip(*columns.values(), strict=True)),
    ]
    return rows


MAP = {"time": "time", "x": "x", "y": "y", "heading": "yaw"}
EXPECTED = np.column_stack([motion().position[:, :2], motion().heading])


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_plain_table_by_a_map(tmp_path, separator):
    text = table(plain(), separator)
    track = read_track(put(tmp_path, text), "anything", FileAnnotations(columns=MAP))
    np.testing.assert_allclose(track.pose, EXPECTED, atol=1e-12)
    np.testing.assert_allclose(track.times, motion().times, atol=1e-6)


def test_plain_table_with_decimal_commas_words_and_comments(tmp_path):
    rows = plain(state=["all, well"] * 30 + ['"no"'] * 30)
    text = "# a comment\n" + table(rows, ";").replace(".", ",")
    np.testing.assert_allclose(
        read_track(put(tmp_path, text), "", FileAnnotations(columns=MAP)).pose, EXPECTED, atol=1e-12
    )


def test_plain_table_with_quoted_commas(tmp_path):
    text = table(plain(**{"state": ['"well, quite"'] * 60}))
    assert read_track(put(tmp_path, text), "", FileAnnotations(columns=MAP)).pose.shape == (60, 3)


@pytest.mark.parametrize(
    ("names", "hints"),
    [
        ("t_s,x_mm,y_mm,yaw_deg", FileAnnotations()),
        ("Time [s],X (mm),Y (mm),Heading [deg]", FileAnnotations()),
        ("time,x,y,yaw\r\ns,mm,mm,deg", FileAnnotations()),
        ("t_s,x_mm,y_mm,angle_deg", FileAnnotations()),
        ("Time [s],X (mm),Y (mm),Angle [deg]", FileAnnotations()),
        ("time,x_mm,y_mm,yaw_deg\r\ns,m,m,rad", FileAnnotations()),
        (
            "time,x_mm,y_mm,yaw_deg\r\ns,m,m,rad",
            FileAnnotations(MAP | {"x": "x_mm", "y": "y_mm", "heading": "yaw_deg"}),
        ),
        ("a,b,c,d", FileAnnotations(dict(zip(MAP, "abcd", strict=True)), {"length": "mm", "angle": "deg"})),
        (None, FileAnnotations(dict(zip(MAP, "1234", strict=True)), {"length": "mm", "angle": "deg"})),
    ],
)
def test_units_of_a_plain_table(tmp_path, names, hints):
    m = motion()
    rows = np.column_stack([m.times, m.position[:, :2] * 1e3, np.rad2deg(m.heading)])
    text = ("" if names is None else names + "\r\n") + table([list(map(float, row)) for row in rows])
    track = read_track(put(tmp_path, text), "board", hints)
    np.testing.assert_allclose(track.pose, EXPECTED, atol=1e-12)


def test_an_angle_is_the_heading_only_where_nothing_else_is(tmp_path):
    text = table(plain(angle=[9.0] * 60))
    np.testing.assert_allclose(read_track(put(tmp_path, text), "", FileAnnotations()).pose, EXPECTED, atol=1e-12)


def test_a_column_may_count_frames(tmp_path):
    hints = FileAnnotations(MAP, {"time": "0.01 s"})
    track = read_track(put(tmp_path, table(plain(time=np.arange(60.0)))), "", hints)
    np.testing.assert_allclose(track.times, motion().times, atol=1e-12)


def test_dates_are_times(tmp_path):
    dates = [f"2026-01-31 12:00:{t:09.6f}Z" for t in motion().times]
    track = read_track(put(tmp_path, table(plain(time=dates))), "", FileAnnotations(columns=MAP))
    np.testing.assert_allclose(track.times, motion().times, atol=1e-6)


def test_stamps_stay_as_they_are(tmp_path):
    """An irregular clock is not made regular."""
    times = motion().times + 0.003 * np.sin(np.arange(60.0) ** 2)
    track = read_track(put(tmp_path, table(plain(time=times + 1.7e9))), "", FileAnnotations(columns=MAP))
    np.testing.assert_allclose(track.times, times - times[0], atol=1e-6)
    assert track.rate == pytest.approx(100, rel=0.2)


def test_objects_in_rows(tmp_path):
    rows = plain(name=["rotor", "board"] * 30)
    capture = read_capture(put(tmp_path, table(rows)), FileAnnotations(columns={**MAP, "object": "name"}))
    assert sorted(capture.bodies) == ["board", "rotor"]
    np.testing.assert_allclose(capture.bodies["board"].position[:, :2], EXPECTED[1::2, :2])


@pytest.mark.slow
def test_parquet(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    m = motion()
    x = [None if i == 3 else float(v) for i, v in enumerate(m.position[:, 0] * 1e3)]
    stamps = pa.array((m.times * 1e9 + 1.7e18).astype(np.int64), pa.timestamp("ns"))
    words = pa.array(["board"] * 60)
    pq.write_table(
        pa.table({"time": stamps, "x": x, "y": m.position[:, 1] * 1e3, "yaw": m.heading, "name": words}), tmp_path / "a"
    )
    hints = FileAnnotations({**MAP, "object": "name"}, {"length": "mm"})
    track = read_track(tmp_path / "a", "board", hints)
    assert np.isnan(track.pose[3]).all()
    np.testing.assert_allclose(np.delete(track.pose, 3, 0), np.delete(EXPECTED, 3, 0), atol=1e-9)
    np.testing.assert_allclose(track.times, m.times, atol=1e-6)


@pytest.mark.parametrize("mark", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "latin-1"])
def test_encodings(tmp_path, mark):
    text = nexus(gappy(), [f"plançhe:{name}" for name in PLACES])
    capture = read_capture(put(tmp_path, text.encode(mark)))
    assert [*capture.markers] == [f"plançhe:{name}" for name in PLACES]


WRITTEN = {
    "tracker of several": lambda: qualisys_bodies({"a.b": motion(tilt=0.02), "c": motion()}, lost=(5, 6)),
    "y up": lambda: motive(motion(), lost=(4,)),
    "planar": lambda: table(plain()).replace("time,x,y,yaw", "time_s,x_m,y_m,yaw_rad"),
    "markers": lambda: nexus(gappy(), NAMES),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_written_as_csv_and_read_again(tmp_path, name):
    capture = read_capture(put(tmp_path, WRITTEN[name]()))
    write_csv(capture, tmp_path / "all.csv")
    again = read_capture(tmp_path / "all.csv")
    assert [*again.markers] == [*capture.markers]
    if len(capture.bodies) + len(capture.markers) > 1:
        assert [*again.bodies] == [*capture.bodies]
    for object in capture.bodies:
        before, after = (read_track(path, object) for path in (tmp_path / "recording", tmp_path / "all.csv"))
        np.testing.assert_allclose(after.pose, before.pose, atol=1e-9)
        np.testing.assert_allclose(after.times, before.times, atol=1e-6)
    if capture.up == "z":
        for marker, points in capture.markers.items():
            np.testing.assert_allclose(again.markers[marker], points, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in WRITTEN if name != "markers"])
def test_written_as_tum(tmp_path, name):
    """Read by numpy: time, position and quaternion; lost frames are left out."""
    path = put(tmp_path, WRITTEN[name]())
    object = next(iter(read_capture(path).bodies))
    write_tum(read_capture(path), tmp_path / "a.tum", object)
    before, found = read_track(path, object), np.loadtxt(tmp_path / "a.tum")
    there = np.isfinite(before.pose[:, 0])
    assert found.shape == (there.sum(), 8)
    np.testing.assert_allclose(found[:, 1:3], before.pose[there, :2], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found[:, 4:], axis=1), 1.0, atol=1e-9)
    again = read_track(tmp_path / "a.tum", object)
    np.testing.assert_allclose(again.pose, before.pose[there], atol=1e-9)


def broken(text, line, old, new):
    lines = text.split("\n")
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new)
    return "\n".join(lines)


POINTS = motion().points
COMPLAINTS = {
    "trc rate": (broken(trc(POINTS, NAMES), 3, "100", "0"), 3, "DataRate is not above 0"),
    "trc unit": (broken(trc(POINTS, NAMES), 3, "mm", "px"), 3, 'Unknown Units "px"'),
    "trc columns": (broken(trc(POINTS, NAMES), 5, "Z4", ""), 5, "4 markers are named, but there are 11 columns"),
    "trc number": (broken(trc(POINTS, NAMES), 17, "0.100", "0.1OO"), 17, '"0.1OO" for Time is not a finite'),
    "trc times": (trc(POINTS, NAMES).replace("100\t100\t60", "250\t100\t60"), 7, "has 100 frames per second, not 250"),
    "trc half a marker": (
        without_names(trc(POINTS, NAMES)).replace("\n1\t0.000\t", "\n1\t0.000\t7\t"),
        7,
        "There are 13 columns after Frame# and Time, which is not three for each marker",
    ),
    "trc ends": (trc(POINTS, NAMES)[:60], 2, "ends before its first frame"),
    "nexus number": (broken(nexus(POINTS, NAMES), 20, "15,0", "15,0x"), 20, '"0x" for Sub Frame'),
    "motive unit": (motive(motion()).replace("Meters", "Parsecs"), 1, 'Unknown Length Units "Parsecs"'),
    "motive local": (motive(motion()).replace("Global", "Local"), 1, "local coordinates"),
    "motive rotation": (motive(motion()).replace("Quaternion", "Magic"), 1, 'Unknown Rotation Type "Magic"'),
    "motive ends": ("".join(motive(motion()).splitlines(True)[:7]), 7, "ends before its first frame"),
    "motive short row": (broken(motive(motion()), 12, ",0.0001,", ","), 12, "The row has 15 cells"),
    "qualisys names": (qualisys_markers(POINTS, NAMES).replace("MARKER_NAMES", "MARKER_NAMEZ"), 8, "names neither"),
    "qualisys rate": (qualisys_markers(POINTS, NAMES).replace("\t100\r", "\t-5\r"), 4, "FREQUENCY is not above 0"),
    "qualisys columns": (qualisys_bodies({"a": motion()}).replace("BODY_NAMES\ta", "BODY_NAMES\ta\tb"), 6, "columns"),
    "plain without names that tell": (table(plain()).replace(",x,y,", ",east,north,"), 1, "do not show x and y"),
    "binary": (b"\x01\x02\x03 nothing known".decode(), 1, "No known format"),
}


@pytest.mark.parametrize("name", COMPLAINTS)
def test_complaints(tmp_path, name):
    text, line, what = COMPLAINTS[name]
    with pytest.raises(InputError) as caught:
        read_capture(put(tmp_path, text))
    assert what in caught.value.what, caught.value
    assert caught.value.where == f"{tmp_path / 'recording'} line {line}"


PLAIN_COMPLAINTS = {
    "no such column": (plain(), {"time": "tme", "x": "x", "y": "y"}, {}, 'There is no column "tme"'),
    "unknown key": (plain(), {**MAP, "hedding": "yaw"}, {}, 'Unknown key "hedding"'),
    "nothing for y": (plain(), {"time": "time", "x": "x"}, {}, "lacks y"),
    "unit": (plain(), MAP, {"length": "furlong"}, 'Unknown unit "furlong"'),
    "blank time": (plain(time=["", *["1.0"] * 59]), MAP, {}, "The time in row 1 of the data is blank"),
    "backwards": (plain(time=motion().times[::-1]), MAP, {}, "it runs backwards or stands still"),
    "infinite": (plain(x=np.full(60, np.inf)), MAP, {}, '"inf" for x is not a finite number'),
}


@pytest.mark.parametrize("name", PLAIN_COMPLAINTS)
def test_complaints_about_a_map(tmp_path, name):
    rows, columns, units, what = PLAIN_COMPLAINTS[name]
    with pytest.raises(InputError) as caught:
        read_track(put(tmp_path, table(rows)), "", FileAnnotations(columns, units))
    assert what in caught.value.what, caught.value


@pytest.mark.slow
@pytest.mark.parametrize("grouped", ["ANGLES", "MOMENTS", "POWERS"])
def test_outputs_of_a_model_are_no_markers(tmp_path, grouped):
    pytest.importorskip("ezc3d")
    points = np.concatenate([gappy(), np.full((60, 2, 3), 37.0)], axis=1)
    content = c3d(points, [*NAMES, "LKnee", "RKnee"], outputs={grouped: ["LKnee", "RKnee"]})
    capture = read_capture(put(tmp_path, content))
    assert [*capture.markers] == NAMES
    assert capture.notes == ["2 outputs of a model are not markers and are ignored: LKnee, RKnee"]
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), gappy(), atol=1e-6)


def damaged_c3d(kind):
    """C3D that ezc3d does not read, and what it says of each."""
    raw = bytearray(c3d(gappy(), NAMES))
    if kind == "of an SGI":
        raw[512 + 3] = 86
    elif kind == "of a DEC, by its key alone":
        raw[512 + 3] = 85
    elif kind == "a parameter of another type":
        raw[raw.index(b"SCALE") + 7] = 2
    elif kind == "more frames than there are":
        raw[8:10] = (701).to_bytes(2, "little")
        return bytes(raw[: 512 * raw[512 + 2] + 1024])
    return bytes(raw)


C3D_COMPLAINTS = {
    "of an SGI": "ezc3d cannot read it (MIPS processor type not supported yet)",
    "of a DEC, by its key alone": "The frame rate of 2.4e-41 Hz is impossible",
    "a parameter of another type": "ezc3d c",
    "more frames than there are": "701 frames",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", C3D_COMPLAINTS)
def test_what_ezc3d_cannot_read_is_to_be_converted(tmp_path, kind):
    pytest.importorskip("ezc3d")
    with pytest.raises(InputError) as caught:
        read_capture(put(tmp_path, damaged_c3d(kind)))
    assert C3D_COMPLAINTS[kind] in caught.value.what
    assert "Error" not in str(caught.value) and "GitHub" not in str(caught.value)
    assert "open it in Mokka (of BTK) and save it as a new C3D or as TRC" in caught.value.remedy


@pytest.mark.slow
def test_a_cut_c3d_is_said_to_be_cut(tmp_path):
    pytest.importorskip("ezc3d")
    with pytest.raises(InputError, match=r"cut short|cannot be read|crashed"):
        read_capture(put(tmp_path, c3d(gappy(), NAMES)[:-500]))


@pytest.mark.slow
def test_the_same_trial_from_two_programs(realdata):
    """The Nexus CSV and the C3D of one trial agree to 0.01 mm, with the same gaps."""
    pytest.importorskip("ezc3d")
    one, other = (read_capture(realdata / name) for name in ("pyomeca_markers.csv", "pyomeca_markers_analogs.c3d"))
    assert [*one.markers] == [*other.markers] and one.rate == other.rate
    for name, points in one.markers.items():
        np.testing.assert_allclose(other.markers[name], points, atol=1e-5, rtol=0)  # NaN equals NaN alone
    assert sum(np.isnan(points).any(axis=1).sum() for points in one.markers.values()) > 0


def test_real_exports(realdata):
    trc = read_capture(realdata / "pyomeca_markers.trc")
    assert (len(trc.markers), len(trc.times), trc.rate) == (51, 93, 100) and "says 652" in trc.notes[0]
    walk = read_capture(realdata / "opensim_y_up.trc")
    table = np.genfromtxt(realdata / "opensim_y_up.trc", delimiter="\t", skip_header=6)[:, : 2 + 3 * 41]
    assert (len(walk.markers), walk.rate) == (41, 60)
    points = np.stack([*walk.markers.values()], axis=1)
    np.testing.assert_allclose(points, 1e-3 * table[:, 2:].reshape(-1, 41, 3), atol=1e-12)
    take = read_capture(realdata / "optitrack_motive_1.21.csv")
    assert [*take.bodies] == ["Rigid Body 1"] and (len(take.times), take.rate) == (250, 120)
    body, marker = take.bodies["Rigid Body 1"], take.markers["Rigid Body 1_1"]
    apart = np.linalg.norm(body.position - marker, axis=1)
    assert np.nanstd(apart) < 1e-3  # a marker stays where it is on its body


@pytest.mark.slow
def test_real_c3d_that_other_readers_fail_on(realdata):
    pytest.importorskip("ezc3d")
    capture = read_capture(realdata / "sample_static_optotrak.c3d")
    assert capture.units == "m" and len(capture.markers) == 41 and capture.rate == pytest.approx(69.9)


def test_the_car_lap_loads_by_a_map(realdata):
    hints = FileAnnotations({"time": "vicon time", "x": "vicon x", "y": "vicon y", "heading": "vicon yaw"})
    track = read_track(realdata / "dart_car_racetrack_lap_060.csv", "car", hints)
    assert track.pose.shape == (7238, 3) and track.times[-1] == pytest.approx(72.369, abs=1e-3)
    assert 1.9e-3 < np.diff(track.times).min() < 2e-3  # the clock is as irregular as it was
    steps = np.hypot(*np.diff(track.pose[:, :2], axis=0).T)
    assert (steps > 0.5).sum() == 6  # and nothing was smoothed away


def test_a_real_qualisys_export_of_three_bodies(realdata):
    """Old titles, once for all of them, and an empty column after each body; the angles say what the matrix says."""
    path = realdata / "qualisys_6d_three_bodies.tsv"
    capture = read_capture(path)
    assert capture.rate == 256 and not capture.notes
    table = np.genfromtxt(path, delimiter="\t", skip_header=11, missing_values="", filling_values=np.nan)
    for i, name in enumerate(("Upper Leg IMU", "Foot IMU", "Lower Leg IMU")):
        block, body = table[:, 17 * i :][:, :16], capture.bodies[name]
        np.testing.assert_allclose(body.position, block[:, :3] * 1e-3, atol=1e-12)
        turn = Rotation.from_euler("ZYX", block[:, 3:6], degrees=True)
        assert (Rotation.from_quat(body.rotation) * turn.inv()).magnitude().max() < 1e-4
