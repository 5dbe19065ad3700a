"""Plain tables as people write them: what the names of columns say, units that nobody states, markers, dates."""

import numpy as np
import pytest
from helpers.exports import PLACES, RATE, motion, put, table

from snakejax import InputError, load_case
from snakejax.commands.cli import main
from snakejax.recording.readers import FileAnnotations, read_capture, read_track

M = motion()
Q = M.rotation.as_quat()
POSE = np.column_stack([M.position[:, :2], M.heading])
BOARD = "mass_kg=7,rotor_inertia_kgm2=0.0238,wheelset_inertia_kgm2=0.001,half_length_m=0.25"
GIVEN = ["--board", BOARD, "--phi", "[[0.9, 4.0, 0.0]]", "--psi", "[]"]
x, y, z = M.position.T
qx, qy, qz, qw = Q.T
t = M.times


def rows(header, *columns):
    cells = [[f"{v:.17g}" if isinstance(v, float) else v for v in row] for row in zip(*columns, strict=True)]
    return table([header.split(","), *cells])


def wrapped(heading, turn):
    return (heading + turn / 2) % turn - turn / 2


POSES = {
    "SI": rows("time,x,y,theta", t, x, y, wrapped(M.heading, 2 * np.pi)),
    "degrees that wrap": rows("t,x,y,yaw", t, x, y, wrapped(np.rad2deg(M.heading), 360)),
    "degrees from 0 to 360": rows("t,x,y,yaw", t, x, y, np.rad2deg(M.heading) % 360),
    "degrees that go on and on": rows("t,x,y,yaw", t, x, y, np.rad2deg(M.heading)),
    "quaternion": rows("time,x,y,z,qw,qx,qy,qz", t, x, y, z, qw, qx, qy, qz),
    "capitals": rows("Time,X,Y,Theta", t, x, y, M.heading),
    "words": rows("Time (s),Position X (mm),Position Y (mm),Heading [deg]", t, 1e3 * x, 1e3 * y, np.rad2deg(M.heading)),
    "w of a quaternion": rows("sec,pos_x,pos_y,pos_z,w,x,y,z", t, x, y, z, qw, qx, qy, qz),
    "rostopic": rows(
        "%time,field.header.seq,field.pose.position.x,field.pose.position.y,field.pose.position.z,"
        "field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w",
        [str(1721384116962754965 + round(1e9 * s)) for s in t],
        range(60),
        *(x, y, z, qx, qy, qz, qw),
    ),
    "ROS 2": rows(
        "header.stamp.sec,header.stamp.nanosec,pose.position.x,pose.position.y,pose.orientation.x,"
        "pose.orientation.y,pose.orientation.z,pose.orientation.w",
        [str(1721384116 + int(s + 0.7)) for s in t],
        [str(round(1e9 * ((s + 0.7) % 1))) for s in t],
        *(x, y, qx, qy, qz, qw),
    ),
    "milliseconds since 1970": rows("timestamp,x,y,yaw", 1.7e12 + 1e3 * t, x, y, M.heading),
    "speeds beside": rows("time,vx,vy,v_x,vel_x,x,y,yaw_rate,yaw", t, *[9 + t] * 4, x, y, 9 + t, M.heading),
    "units in a row": rows(
        "time,x,y,yaw", ["s", *map(str, t)], ["mm", *(1e3 * x)], ["mm", *(1e3 * y)], ["rad", *M.heading]
    ),
    "day, month and year": rows("time,x,y,yaw", [f"15/08/2022 09:42:{s:09.6f}" for s in t], x, y, M.heading),
    "month, day and year": rows("time,x,y,yaw", [f"08/15/2022 09:42:{s:09.6f}" for s in t], x, y, M.heading),
    "one digit of an hour": rows(
        "time,x,y,yaw", [f"2022-08-15 9:59:{59 + s:09.6f}" for s in t], x, y, M.heading
    ).replace("9:59:59.59", "9:59:59.59"),
}


@pytest.mark.parametrize("name", POSES)
def test_names_say_what_columns_hold(tmp_path, name):
    path = put(tmp_path, POSES[name])
    track = read_track(path, "anything")
    np.testing.assert_allclose(track.pose, POSE, atol=1e-9)
    np.testing.assert_allclose(track.times, t, atol=1e-6)
    said = [note for note in track.notes if "no unit is stated" in note]
    stated = name in ("words", "units in a row")
    assert len(said) == (not stated)
    if name.startswith("degrees"):
        assert "the angles (read in deg)" in said[0]
    elif not stated:
        assert "the lengths (read in m)" in said[0] and "deg" not in said[0]
    if name == "speeds beside":
        unused = "columns that are not used: vx, vy, v_x, vel_x, yaw_rate"
        assert unused in read_capture(path).notes


def test_seconds_and_nanoseconds_are_one_clock(tmp_path):
    """ROS 2 writes a time as two columns; the first alone shows the same second in up to 100 rows."""
    clock = 1721384116.7 + t
    split = [str(int(s)) for s in clock], [str(round(1e9 * (s % 1))) for s in clock]
    for names in ("sec,nanosec", "secs,nsecs", "field.header.stamp.secs,field.header.stamp.nsecs"):
        capture = read_capture(put(tmp_path, rows(f"{names},x_m,y_m,yaw_rad", *split, x, y, M.heading)))
        np.testing.assert_allclose(capture.times, clock, atol=1e-6)
    # Two whole clocks are no sum.
    text = rows("time_s,time_ns,x_m,y_m,yaw_rad", 0.5 + t, [str(round(1e9 * s)) for s in t], x, y, M.heading)
    capture = read_capture(put(tmp_path, text))
    np.testing.assert_allclose(capture.times, 0.5 + t, atol=1e-12)
    assert "columns that are not used: time_ns" in capture.notes


def test_a_clock_without_its_fraction_is_refused(tmp_path):
    path = put(tmp_path, rows("sec,x_m,y_m,yaw_rad", [str(int(10 * s)) for s in t], x, y, M.heading))
    with pytest.raises(InputError, match=r"55 of 60 rows show the time of another row.*the clock is too coarse"):
        read_capture(path)
    # The same frame written twice is a defect of the recording, not of the table.
    twice = rows("time_s,x_m,y_m,yaw_rad", *(np.repeat(column, 2) for column in (t, x, y, M.heading)))
    assert len(read_capture(put(tmp_path, twice)).times) == 2 * len(t)


def test_rows_of_several_objects_are_not_one(tmp_path):
    data = [
        [float(s), who, float(a + far), float(b), float(c)]
        for s, a, b, c in zip(t, x, y, M.heading, strict=True)
        for who, far in (("car", 0.0), ("cone", 2.0))
    ]
    path = put(tmp_path, table([["time_s", "id", "x_m", "y_m", "yaw_rad"], *data]))
    with pytest.raises(InputError, match=r'61 of 120 rows show the time of another row.*columns = \{object = "name'):
        read_capture(path)
    car = read_track(path, "car", FileAnnotations({"object": "id"}))
    np.testing.assert_allclose(car.pose, POSE, atol=1e-12)


def test_a_time_of_day_without_a_date(tmp_path):
    clock = [f"23:59:{59.7 + s:09.6f}" if s < 0.295 else f"0:00:{s - 0.3:09.6f}" for s in t]
    track = read_track(put(tmp_path, rows("time,x_m,y_m,yaw_rad", clock, x, y, M.heading)), "")
    np.testing.assert_allclose(np.diff(track.times), np.diff(t), atol=1e-6)
    with pytest.raises(InputError, match=r'"23:61:59\.700000" is no date and time.*line 2'):
        read_capture(put(tmp_path, rows("time,x_m,y_m,yaw_rad", ["23:61:59.700000", *clock[1:]], x, y, M.heading)))


def test_excel_states_its_separator(tmp_path):
    text = "sep=;\r\n" + rows("time_s,x_m,y_m,yaw_rad", t, x, y, M.heading).replace(",", ";")
    np.testing.assert_allclose(read_track(put(tmp_path, text), "").pose, POSE, atol=1e-12)


def test_an_hour_passes(tmp_path):
    clock = [f"2022/8/5 {9 + (59.7 + s >= 60):d}:{'00' if 59.7 + s >= 60 else '59'}:{(59.7 + s) % 60:09.6f}" for s in t]
    for zone in ("", "Z", "+02:00"):
        text = rows("time,x,y,yaw", [c + zone for c in clock], x, y, M.heading)
        np.testing.assert_allclose(read_track(put(tmp_path, text), "").times, t, atol=1e-6)
    with pytest.raises(InputError, match=r"is no date and time.*line 3: .*one time zone"):
        read_capture(put(tmp_path, text.replace("+02:00", "+01:00", 1)))


ASKED = {
    "degrees or radians": (rows("time,x,y,yaw", 30 * t, x, y, 60 * t), "angle=deg", "no unit and goes from 0 to 35.4"),
    "millimetres": (rows("time,x,y,yaw", t, 1e3 * x, 1e3 * y, M.heading), "length=mm", "as metres they would go to"),
    "milliseconds": (rows("time,x,y,yaw", 1e3 * t, x, y, M.heading), "time=ms", "its steps would be of 10 s"),
    "frames": (rows("time,x,y,yaw", np.arange(60.0), x, y, M.heading), "time=0.01 s", "its steps would be of 1 s"),
}


@pytest.mark.parametrize("name", ASKED)
def test_units_that_are_not_si_are_asked_for(tmp_path, name, capsys):
    text, units, what = ASKED[name]
    path = put(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_capture(path)
    assert what in caught.value.what and "option --units" in caught.value.remedy
    assert main(["import", str(path), "--units", units, "--to", str(tmp_path / "a.csv")]) == 0
    pose = read_track(tmp_path / "a.csv", "").pose
    expected = POSE if name != "degrees or radians" else np.column_stack([x, y, np.deg2rad(60 * t)])
    np.testing.assert_allclose(pose, expected, atol=1e-9)


def test_columns_without_names_have_numbers(tmp_path):
    """As a real trolley's: the quaternion has one name for four columns."""
    text = rows("time,x,y,z,rotation,,,", t, x, y, z, qx, qy, qz, qw)
    path = put(tmp_path, text)
    capture = read_capture(path)
    assert [*capture.markers] == [""] and "columns that are not used: rotation, 6, 7, 8" in capture.notes
    assert any("a position without heading" in note for note in capture.notes)
    columns = {"qx": "rotation", "qy": "6", "qz": "7", "qw": "8"}
    np.testing.assert_allclose(read_track(path, "", FileAnnotations(columns)).pose, POSE, atol=1e-9)
    whole = {"time": "1", "x": "2", "y": "3", **columns}
    np.testing.assert_allclose(read_track(path, "", FileAnnotations(whole)).pose, POSE, atol=1e-9)
    with pytest.raises(InputError, match=r'no column "9".*known: time, x, y, z, rotation, 6, 7, 8'):
        read_capture(path, FileAnnotations(columns | {"qw": "9"}))


def test_rows_may_be_the_clock(tmp_path, capsys):
    text = rows("x,y,yaw", x, y, M.heading)
    path = put(tmp_path, text)
    with pytest.raises(InputError, match=r'do not show the time: x, y, yaw.*time = "row" with units'):
        read_capture(path)
    with pytest.raises(InputError, match="the time between two rows is not given"):
        read_capture(path, FileAnnotations({"time": "row"}))
    track = read_track(path, "", FileAnnotations({"time": "row"}, {"time": "0.01 s"}))
    np.testing.assert_allclose(track.pose, POSE, atol=1e-12)
    np.testing.assert_allclose(track.times, t, atol=1e-12)


POINTS = M.points.copy()
POINTS[7, 0], POINTS[20:25, 2] = np.nan, np.nan
NAMES = [*PLACES]


def markers(name, axes=("x", "y", "z"), scale=1.0, first="time", more=""):
    """A table with the columns `name`, an f-string of marker and axis."""
    header = [first, *(name.format(m=m, a=a) for m in NAMES for a in axes)]
    data = [[float(s), *map(float, scale * p.ravel())] for s, p in zip(t, POINTS, strict=True)]
    return table([header, *([more.split("|")] if more else []), *data])


def two_rows(first, fill, units=(), index=(), suffix=""):
    above = ["", *(c for m in NAMES for c in (m + suffix, *([m] * 2 if fill else ["", ""])))]
    below = ["", *("x", "y", "z") * 4] if first == "above" else ["Time", *("X", "Y", "Z") * 4]
    above[0] = "time" if first == "above" else ""
    data = [[float(s), *map(float, p.ravel())] for s, p in zip(t, POINTS, strict=True)]
    return table([above, below, *([list(units)] if units else []), *([list(index)] if index else []), *data])


MARKERS = {
    "name_x": markers("{m}_{a}"),
    "name x": markers("{m} {a}"),
    "name.X": markers("{m}.{a}", "XYZ", first="Time"),
    "name (x)": markers("{m} ({a})"),
    "name[0]": markers("{m}[{a}]", "012", first="Time"),
    "nameX": markers("{m}{a}", "XYZ"),
    "name:X": markers("{m}:{a}", "XYZ"),
    "X:name": markers("{a}:{m}", "XYZ"),
    "mm in the names": markers("{m}_{a} (mm)", scale=1e3, first="time [s]"),
    "position in the names": markers("{m} Position {a}", "XYZ"),
    "semicolons": markers("{m}_{a}").replace(",", ";").replace(".", ","),
    "a row of names, a row of axes": two_rows("below", fill=False),
    "names repeated": two_rows("above", fill=True),
    "and a row of units": two_rows("below", fill=False, units=["s", *["m"] * 12]),
    "units beside the names": two_rows("below", fill=False, suffix=" (m)"),
    "as pandas writes them": two_rows("x", fill=True, index=["time", *[""] * 12]).replace("\r\nTime,", "\r\n,"),
}


@pytest.mark.parametrize("name", MARKERS)
def test_tables_of_markers(tmp_path, name):
    capture = read_capture(put(tmp_path, MARKERS[name]))
    assert [*capture.markers] == NAMES and not capture.bodies
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), POINTS, atol=1e-12)
    np.testing.assert_allclose(capture.times, t, atol=1e-12)


def test_a_homogeneous_column_is_none_of_the_place(tmp_path):
    header = ["Time", *(f"{m}[{k}]" for m in NAMES for k in range(4))]
    ones = np.concatenate([POINTS, np.ones((60, 4, 1))], axis=2)
    capture = read_capture(
        put(tmp_path, table([header, *([float(s), *map(float, p.ravel())] for s, p in zip(t, ones, strict=True))]))
    )
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), POINTS, atol=1e-12)


def test_markers_in_mm_that_do_not_say_so(tmp_path):
    path = put(tmp_path, markers("{m}_{a}", scale=1e3))
    with pytest.raises(InputError, match="as metres they would go to"):
        read_capture(path)
    found = read_capture(path, FileAnnotations(units={"length": "mm"}))
    np.testing.assert_allclose(np.stack([*found.markers.values()], axis=1), POINTS, atol=1e-12)


def test_a_marker_may_be_called_by_a_letter(tmp_path):
    above, below = ["", "a", "", "", "v", "", ""], ["Time", *"XYZXYZ"]
    data = [[float(s), *map(float, p.ravel())] for s, p in zip(t, POINTS[:, :2], strict=True)]
    capture = read_capture(put(tmp_path, table([above, below, *data])))
    np.testing.assert_allclose(np.stack([*capture.markers.values()], axis=1), POINTS[:, :2], atol=1e-12)
    assert [*capture.markers] == ["a", "v"]


def test_speeds_and_forces_are_no_markers(tmp_path):
    text = rows("time,vel_x,vel_y,vel_z,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z,F_x,F_y,F_z", t, *[x] * 12)
    with pytest.raises(InputError, match="do not show x and y"):
        read_capture(put(tmp_path, text))


def test_a_quaternion_called_x_y_z_w_is_no_place(tmp_path):
    with pytest.raises(InputError, match="do not show x and y"):
        read_capture(put(tmp_path, rows("time,w,x,y,z", t, qw, qx, qy, qz)))


def test_bodies_and_markers_beside_each_other(tmp_path):
    header = (
        "time,car_x,car_y,car_yaw,cone_x,cone_y,cone_z,drone_px,drone_py,drone_pz,drone_qx,drone_qy,drone_qz,drone_qw"
    )
    capture = read_capture(put(tmp_path, rows(header, t, x, y, M.heading, y, x, z, x, y, z, qx, qy, qz, qw)))
    assert [*capture.bodies] == ["car", "drone"] and [*capture.markers] == ["cone"]
    np.testing.assert_allclose(capture.bodies["drone"].position, M.position, atol=1e-12)
    np.testing.assert_allclose(capture.markers["cone"], np.column_stack([y, x, z]), atol=1e-12)


def test_the_object_is_called_as_the_user_calls_it(tmp_path):
    path = put(tmp_path, POSES["SI"], "lap.csv")
    assert main(["import", str(path), "--object", "car", "--out", str(tmp_path / "case"), *GIVEN]) == 0
    assert 'object = "car"' in (tmp_path / "case" / "case.toml").read_text()
    assert "no unit is stated" in load_case(tmp_path / "case").reading["lap"][0]
    path = put(tmp_path, MARKERS["name_x"], "board.csv")
    ends = ["--front", "front", "--back", "back"]
    assert main(["import", str(path), "--object", "car", "--out", str(tmp_path / "two"), *ends, *GIVEN]) == 0
    assert 'object = "car"' in (tmp_path / "two" / "case.toml").read_text()
    assert len(load_case(tmp_path / "two").runs[0].times) == len(t)


def test_a_real_trolley(realdata):
    """Hours of one digit, and columns without names."""
    path = realdata / "trolley_plain.csv"
    lines = path.read_text(encoding="utf-8-sig").splitlines()[1:]
    expected = np.array([[float(c) for c in line.split(",")[1:4]] for line in lines])
    days = [line.split(",")[0].replace(" 9:", " 09:") for line in lines]
    times = np.array(days, "datetime64[us]").astype(np.int64) * 1e-6
    capture = read_capture(path)
    np.testing.assert_allclose(capture.markers[""], expected, atol=1e-12)
    np.testing.assert_allclose(capture.times, times, atol=1e-6)
    turned = read_capture(path, FileAnnotations({"qx": "rotation", "qy": "6", "qz": "7", "qw": "8"})).bodies[""]
    np.testing.assert_allclose(turned.rotation[:, 3], [float(line.split(",")[7]) for line in lines], atol=1e-12)


def test_the_real_lap_needs_no_map(realdata):
    """vicon time, vicon x, vicon y, vicon yaw say enough; acc x (IMU) is no place."""
    path = realdata / "dart_car_racetrack_lap_060.csv"
    by_name = read_track(path, "vicon")
    by_map = read_track(path, "car", FileAnnotations({"time": "11", "x": "12", "y": "13", "heading": "14"}))
    np.testing.assert_array_equal(by_name.pose, by_map.pose)
    np.testing.assert_array_equal(by_name.times, by_map.times)
    assert len(by_name.times) == 7238 and pytest.approx(by_name.rate, rel=1e-3) == RATE


@pytest.mark.parametrize("parts", ["rot_z", "rot_x,rot_y,rot_z", "q_x,q_y,q_z"])
def test_a_part_of_a_quaternion_is_not_used_and_said(tmp_path, parts) -> None:
    turns = [0.1 * t] * (parts.count(",") + 1)
    capture = read_capture(put(tmp_path, rows(f"time,x,y,{parts}", t, x, y, *turns)))
    assert f"columns that are not used: {parts.replace(',', ', ')}" in capture.notes
    assert not capture.bodies


def test_numbered_markers(tmp_path) -> None:
    capture = read_capture(put(tmp_path, rows("time,x1,y1,z1,X_2,Y_2,Z_2", t, x, y, z, 1 + x, y, z)))
    assert [*capture.markers] == ["1", "2"]
    assert np.allclose(capture.markers["2"] - capture.markers["1"], [1, 0, 0])


def test_day_and_month_are_in_one_order_in_all_rows(tmp_path) -> None:
    """12 January before midnight, 13 January after it: only the second shows which number is the day."""
    since = 23 * 3600 + 59 * 60 + 59.7 + t
    clock = [
        f"{12 + int(s // 86400)}/01/2022 {int(s % 86400 // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:09.6f}"
        for s in since
    ]
    track = read_track(put(tmp_path, rows("time,x,y,yaw", clock, x, y, M.heading)), "board")
    np.testing.assert_allclose(track.times, t, atol=1e-5)


@pytest.mark.parametrize(
    ("units", "what"),
    [
        ({"lenght": "mm"}, 'Unknown key "lenght" in units'),
        ({"length": "inches"}, 'Unknown unit "inches" of length'),
    ],
)
def test_units_that_nobody_knows_are_refused(tmp_path, units, what) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,x,y,heading\n" + "".join(f"{k / 100},{k},0,0\n" for k in range(20)))
    with pytest.raises(InputError, match=what):
        read_capture(path, FileAnnotations(units=units))


@pytest.mark.parametrize("columns", [None, {"time": "t_s", "x": "x_mm", "y": "y_mm", "heading": "yaw_deg"}])
def test_stated_units_overrule_the_names_of_columns_with_and_without_a_map(tmp_path, columns) -> None:
    path = put(tmp_path, rows("t_s,x_mm,y_mm,yaw_deg", t, 100 * x, 100 * y, np.rad2deg(M.heading)))
    track = read_track(path, "", FileAnnotations(columns=columns, units={"length": "cm"}))
    np.testing.assert_allclose(track.pose, POSE, atol=1e-12)


def test_objects_in_a_column_and_in_names_are_refused(tmp_path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(f"{k / 100},a,{k},0,0\n" for k in range(20))
    path.write_text("time,id,robot_x,robot_y,robot_yaw\n" + rows)
    columns = {"object": "id"}
    captured = read_capture(path, FileAnnotations(columns, {"length": "m", "angle": "rad", "time": "s"}))
    assert list(captured.bodies) == ["a"]
