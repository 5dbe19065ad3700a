"""Whatever a file holds, reading it ends in a right answer or in one line of complaint: soon, and in little memory.

A few examples run here; SNAKEJAX_FUZZ=200 tries so many of each kind, with other seeds each time.
"""

import os
import signal
import sys
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers.exports import PLACES, c3d, motion, motive, nexus, qualisys_bodies, qualisys_markers, table, tracker, trc
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from snakejax import InputError
from snakejax.recording.capture_summary import ground, summary, summary_text
from snakejax.recording.readers import FileAnnotations, pose_track, read_capture, read_joint_log

resource = pytest.importorskip("resource")  # neither it nor an alarm is there on Windows

LONG = int(os.environ.get("SNAKEJAX_FUZZ", "0"))
FEW = LONG or 20
# On a busy machine ten seconds may pass over anything: the limit proper is for the long run.
SECONDS, BYTES = 10 if LONG else 60, 2 << 30
few = settings(
    max_examples=FEW,
    deadline=None,
    derandomize=not LONG,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)
MAP = {"time": "vicon time", "x": "vicon x", "y": "vicon y", "heading": "vicon yaw"}
NAMES = [f"board:{name}" for name in PLACES]
SHORT = motion(20)
PLAIN = table([["time_s", "x_m", "y_m", "heading_rad"], *([float(i), 0.5, -1e-3, 0.1] for i in range(20))])
LOG = table([["time_s", "phi_rad", "psi_rad"], *([float(i), 0.5, -1e-3] for i in range(20))])
TWO_ROWS = table([["", "a", "", "", "b", "", ""], ["Time", *"XYZXYZ"], *([0.1 * i, *[0.5 + i] * 6] for i in range(20))])
ANGLED = (
    nexus(SHORT.points[:, :2], NAMES[:2]).replace("Trajectories", "Objects").replace("X,Y,Z,X,Y,Z", "RX,RY,RZ,TX,TY,TZ")
)
ANGLED = ANGLED.replace(",,mm,mm,mm,", ",,rad,rad,rad,").replace("board:back", "")
SYNTHETIC = {
    "tracker": tracker({"a": SHORT, "b": SHORT}, lost=(3,)),
    "nexus": nexus(SHORT.points, NAMES),
    "trc": trc(SHORT.points, NAMES),
    "motive": motive(SHORT),
    "motive Euler": motive(SHORT, rotation="XYZ"),
    "qualisys markers": qualisys_markers(SHORT.points, NAMES),
    "qualisys bodies": qualisys_bodies({"a": motion(60)}),
    "plain": PLAIN,
    "semicolons": PLAIN.replace(",", ";").replace(".", ","),
    "angles": ANGLED,
    "marker table": TWO_ROWS,
    "no units": table([["t", "x", "y", "theta"], *([float(i) / 10, 0.5, -1e-3, 0.1 * i] for i in range(20))]),
    "log": LOG,
}
REAL = ("pyomeca_markers.csv", "pyomeca_markers.trc", "optitrack_motive_1.21.csv", "dart_car_racetrack_lap_060.csv")
REAL += ("opensim_y_up.trc", "qualisys_6d_three_bodies.tsv", "vicon_tracker_helical_robot.csv", "trolley_plain.csv")
REAL_C3D = (
    "optitrack_walking.c3d",
    "pyomeca_markers_analogs.c3d",
    "sample_static_optotrak.c3d",
    "qualisys_y_screen.c3d",
)


@contextmanager
def limited():
    """Some seconds, and the memory of this process not above two gibibytes more than it was."""

    def late(*_):
        raise TimeoutError(f"not done after {SECONDS} s")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    old = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, old)
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < BYTES


def one_line(error):
    text = str(error)
    assert "\n" not in text and len(text) < 1200 and text.isprintable(), text


def survives(path: Path, hints: FileAnnotations | None = None) -> bool:
    """Whether it was read; where it was not, the complaint is one line."""
    with limited(), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            capture = read_capture(path, hints or FileAnnotations())
        except InputError as error:
            one_line(error)
            return False
        assert all(
            np.isfinite(b.position).sum() >= 0 and len(b.times) == len(b.position) for b in capture.bodies.values()
        )
        assert not any(np.isinf(points).any() for points in capture.markers.values())
        summary(capture), summary_text(capture, {})
        for name in [*capture.bodies][:5]:
            try:
                track = pose_track(capture, name)
            except InputError as error:
                one_line(error)
                continue
            assert np.isfinite(track.times).all() and (np.diff(track.times) > 0).all()
            assert np.isfinite(track.rate) and not np.isinf(track.pose).any()
            ground(capture, name)
    return True


@st.composite
def damage(draw):
    """A change to the bytes of a file, as a function."""
    kind = draw(st.sampled_from(["cut", "flip", "remove", "repeat", "write", "encode", "cell"]))
    where = draw(st.floats(0, 1))
    # Headers decide most: half of the changes are made there.
    near = draw(st.booleans())
    length = draw(st.integers(1, 200))
    seed = draw(st.integers(0, 2**32))
    words = [
        "",
        "nan",
        "inf",
        "-1e999",
        "1e308",
        "1e-320",
        "99999999999999999999",
        "-5",
        "0",
        "x",
        "é",
        '"',
        "0x1p3",
        "1_0",
    ]
    text = draw(st.sampled_from([*words, "\0", "\n", "\n\n", ",", ";", "\t", "1,5", "mm", "deg", " " * 20, "\x1b[31m"]))
    mark = draw(st.sampled_from(["utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp1252", "utf-7", "cp037"]))

    def change(raw: bytes) -> bytes:
        size = min(len(raw), 2000) if near else len(raw)
        at = int(where * size)
        random = np.random.default_rng(seed)
        if kind == "cut":
            return raw[:at]
        if kind == "flip":
            flipped = np.frombuffer(raw, np.uint8).copy()
            places = random.integers(0, max(size, 1), min(length, 20))
            flipped[places[places < len(raw)]] ^= (1 << random.integers(0, 8, (places < len(raw)).sum())).astype(
                np.uint8
            )
            return flipped.tobytes()
        if kind == "remove":
            return raw[:at] + raw[at + length :]
        if kind == "repeat":
            return raw[: at + length] + raw[at:]
        if kind == "write":
            return raw[:at] + text.encode() + raw[at + length % 7 :]
        if kind == "encode":
            return raw.decode("utf-8", "replace").encode(mark, "replace")
        begin = max(raw.rfind(sign, 0, at) for sign in (b",", b";", b"\t", b"\n")) + 1
        ends = [i for i in (raw.find(sign, begin) for sign in (b",", b";", b"\t", b"\r", b"\n")) if i >= 0]
        return raw[:begin] + text.encode() + raw[min(ends, default=len(raw)) :]

    return change


changes = st.lists(damage(), min_size=1, max_size=3)


def damaged(raw: bytes, made) -> bytes:
    for change in made:
        raw = change(raw) if raw else raw
    return raw


@pytest.mark.parametrize("name", SYNTHETIC)
@few
@given(made=changes)
def test_damaged_files(tmp_path, name, made):
    path = tmp_path / "file"
    path.write_bytes(damaged(SYNTHETIC[name].encode(), made))
    survives(path)
    try:
        read_joint_log(path)
    except InputError as error:
        one_line(error)


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
@settings(few, max_examples=LONG or 6)
@given(made=changes)
def test_damaged_real_files(tmp_path, realdata, name, made):
    path = tmp_path / "file"
    path.write_bytes(damaged((realdata / name).read_bytes(), made))
    survives(path, FileAnnotations(columns=MAP))


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL_C3D)
@settings(few, max_examples=LONG or 3)
@given(made=changes)
def test_damaged_real_c3d(tmp_path, realdata, name, made):
    pytest.importorskip("ezc3d")
    path = tmp_path / "file"
    path.write_bytes(damaged((realdata / name).read_bytes(), made))
    survives(path)


@pytest.mark.slow
@settings(few, max_examples=LONG or 12)
@given(made=changes)
def test_damaged_c3d(tmp_path, made):
    pytest.importorskip("ezc3d")
    path = tmp_path / "file"
    path.write_bytes(damaged(c3d(SHORT.points, NAMES), made))
    survives(path)


@pytest.mark.slow
@settings(few, max_examples=LONG or 8)
@given(made=changes)
def test_damaged_parquet(tmp_path, made):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    path = tmp_path / "whole"
    if not path.exists():
        columns = {"time_s": SHORT.times, "x_m": SHORT.position[:, 0], "y_m": SHORT.position[:, 1]}
        pq.write_table(pa.table(columns | {"heading_rad": SHORT.heading}), path)
    (tmp_path / "file").write_bytes(damaged(path.read_bytes(), made))
    survives(tmp_path / "file")


@pytest.mark.slow
@few
@given(raw=st.binary(max_size=3000))
@example(raw=b"")
@example(raw=b"\0" * 2000)
@example(raw=b"\xff\xfe")
@example(raw=b"\x02P" + b"\0" * 600)
@example(raw=b"#ROSBAG V2.0\n" + b"\xff" * 4000)
def test_any_bytes(tmp_path, raw):
    path = tmp_path / "file"
    path.write_bytes(raw)
    survives(path)


@few
@given(text=st.text(st.sampled_from('0123456789.,;\t\n"-+eE#_ xyztimeheadingradnfÄ\x0b\x85\u2028'), max_size=400))
@example(text="Objects")
@example(text="Trajectories\n100\n\nFrame")
@example(text="time_s,x_m,y_m\n")
def test_any_text(tmp_path, text):
    path = tmp_path / "file"
    path.write_text(text, encoding="utf-8")
    survives(path, FileAnnotations(columns={"time": "1", "x": "2", "y": "3"}))
    survives(path)


def wide_files(n):
    """Text with `n` columns, or as many lines or letters, by what it is like."""
    third = n // 3
    n = 3 * third
    xyz = "X,Y,Z," * third
    nexus = ("Frame,Sub Frame," + xyz, ",," + "mm," * n, "1,0," + "1," * n)
    return {
        "one line": ["1," * n],
        "nexus": ["Trajectories", "100", ",," + "a,,," * third, *nexus],
        "names apart": ["Trajectories", "100", ",," + ",".join(f"m{i},," for i in range(third)), *nexus],
        "motive": [
            "Format Version,1.2,Export Frame Rate,100,Length Units,Meters",
            ",," + "Marker," * n,
            ",," + "a," * n,
            ",," + "Position," * n,
            "Frame,Time," + xyz,
            "0,0," + "1," * n,
        ],
        "trc": [
            "PathFileType\t4",
            "DataRate\tUnits",
            "100\tmm",
            "Frame#\tTime\t" + "a\t\t\t" * third,
            "\t\t" + "X1\tY1\tZ1\t" * third,
            "1\t0\t" + "1\t" * n,
        ],
        "qualisys": ["NO_OF_FRAMES\t1", "FREQUENCY\t100", "MARKER_NAMES" + "\ta" * third, "1\t" * n],
        "plain": [",".join(f"c{i}" for i in range(n)), "1," * n],
        "text": ["x" * 10 * n],
        "lines": [*[""] * n, "x"],
        "sections": ["Objects\n"] * (n // 10),
    }


@pytest.mark.slow
@pytest.mark.parametrize("n", [3 * 9_999, 10**6])
@pytest.mark.parametrize("name", wide_files(3))
def test_very_many_columns(tmp_path, name, n):
    path = tmp_path / "file"
    path.write_text("\n".join(wide_files(n)[name]), encoding="utf-8")
    known = survives(path)
    assert known == (name in ("nexus", "names apart", "motive", "trc", "qualisys") and n < 30_000)
