"""Cases of whole files: tables with poses and inputs, cut into windows."""

from pathlib import Path

import numpy as np
import pytest
from helpers.car_toml import CAR_TOML
from helpers.folders import DATA, beside

from snakejax.core.errors import InputError
from snakejax.dynamics.sampled_signals import Held
from snakejax.recording.case import load_case
from snakejax.recording.continuous import chosen_windows, continuous_parts

HEADER = "elapsed time sensors,voltage,safety_value,throttle,steering,vicon time,vicon x,vicon y,vicon yaw"
CASE = (
    CAR_TOML
    + """\
[[runs]]
role = "train"
group = "fast"
files = "0909_*.csv"
windows = {length_s = 1.0, most = 100}
[[runs]]
role = "heldout"
files = "0910_1.csv"
"""
)
STAMP_AHEAD = 30.0
"""The sender's clock shows so much [s] more than the cameras' time from their first frame."""


def rows(seconds: float = 10.0, network: float = 0.004) -> np.ndarray:
    """A car that goes straight at 1 m/s: frames at 100 Hz, a message every 0.1 s from 0.05 s on."""
    t = np.arange(round(100 * seconds)) / 100
    sent = np.floor((t - 0.05 - network) / 0.1 + 1e-9) * 0.1 + 0.05
    begun = sent > 0
    count = np.round((sent - 0.05) / 0.1)
    throttle, steering = 0.2 + 0.001 * count, np.where(count % 2 > 0, 0.1, -0.1)
    table = np.column_stack([sent + STAMP_AHEAD, 0 * t, 0 * t + 1, throttle, steering])
    table[~begun] = 0.0
    return np.column_stack([table, 1.7e9 + t, t, 0 * t, 0 * t])


def written(folder: Path, changed=lambda table: table) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    for name in ("0909_1", "0910_1"):
        np.savetxt(folder / f"{name}.csv", changed(rows()), "%.6f", ",", header=HEADER, comments="")
    return folder


def test_each_message_counts_once_at_its_stamp(tmp_path: Path) -> None:
    whole, held = load_case(written(tmp_path)).recordings
    assert (whole.name, whole.group, held.group) == ("0909_1", "fast", None)
    steer = whole.gait.signal("steer")
    assert isinstance(steer, Held) and len(steer.knots) == 100
    # Sent every 0.1 s from 0.05 s on, and the fastest took 4 ms, to the next frame.
    np.testing.assert_allclose(np.asarray(steer.knots), 0.05 + 0.1 * np.arange(100) + 0.01, atol=2e-3)
    np.testing.assert_array_equal(np.asarray(steer.values[:4]), [-0.1, 0.1, -0.1, 0.1])


def test_a_late_message_counts_at_its_stamp(tmp_path: Path) -> None:
    late = rows()
    late[506:514, :5] = late[505, :5]
    case = load_case(written(tmp_path, lambda _: late))
    usual = load_case(written(tmp_path / "usual"))
    signals = [c.recordings[0].gait.signal("drive") for c in (case, usual)]
    at = []
    for signal in signals:
        assert isinstance(signal, Held)
        at.append(np.asarray(signal.knots)[[0, 20, 80]])
    np.testing.assert_allclose(at[0], at[1], atol=2e-3)
    assert any("late" in note for note in case.reading["0909_1"])


def test_windows_are_cut_on_a_clock_of_their_own(tmp_path: Path) -> None:
    case = load_case(written(tmp_path))
    runs = case.having("train")
    assert len(runs) == 9 and {run.recorded_as for run in runs} == {"0909_1"}
    third = runs[2]
    assert third.moving and third.name == "0909_1@2.00" and float(third.times[0]) == 0.0
    np.testing.assert_allclose(np.asarray(third.pose[:, 0]), np.asarray(third.times) + 2.0, atol=1e-6)
    for at in (0.0, 0.33, 0.95):
        value, whole = (r.gait.signal("drive").at(s).angle for r, s in ((third, at), (case.recordings[0], at + 2.0)))
        assert float(value) == float(whole)


def test_the_throttle_acts_only_where_the_safety_is_on(tmp_path: Path) -> None:
    def off(table: np.ndarray) -> np.ndarray:
        table[300:340, 2] = 0.0
        return table

    run = load_case(written(tmp_path, off)).recordings[0]
    drive, steer = (run.gait.signal(name) for name in ("drive", "steer"))
    assert float(drive.at(3.2).angle) == 0.0 and float(drive.at(3.6).angle) > 0.2
    assert abs(float(steer.at(3.2).angle)) == pytest.approx(0.1)


def test_a_car_that_is_carried_is_left_out(tmp_path: Path) -> None:
    def carried(table: np.ndarray) -> np.ndarray:
        table[500:, 2] = 0.0
        return table

    case = load_case(written(tmp_path, carried))
    pose = np.asarray(case.recordings[0].pose)
    assert np.isfinite(pose[:590]).all() and np.isnan(pose[620:]).all()
    assert any("safety off" in note for note in case.reading["0909_1"])


def test_windows_end_at_gaps_and_jumps(tmp_path: Path) -> None:
    t = np.arange(1000) / 100
    pose = np.column_stack([t, 0 * t, 0 * t])
    pose[400:450] = np.nan
    pose[700:, 0] += 6.4
    assert [(int(p[0]), int(p[-1])) for p in continuous_parts(t, pose)] == [(0, 399), (450, 699), (700, 999)]
    windows = chosen_windows(t, pose, (t, {"drive": 0 * t}), 1.5, 100)
    assert all(np.ptp(pose[w, 0]) < 1.6 for w in windows) and len(windows) == 2 + 1 + 1


def test_few_windows_show_slow_and_fast_steady_and_varying() -> None:
    t = np.arange(6000) / 100
    speed = np.where(t < 30, 0.3, 2.0)
    pose = np.column_stack([np.cumsum(speed) / 100, 0 * t, 0 * t])
    drive = np.where((t % 20) < 10, 0.2, np.sin(20 * t))
    windows = chosen_windows(t, pose, (t, {"drive": drive}), 1.0, 8)
    assert len(windows) == 8
    seen = {(bool(t[w[0]] >= 30), bool((t[w[0]] % 20) >= 10)) for w in windows}
    assert seen == {(fast, varying) for fast in (False, True) for varying in (False, True)}


def test_frames_out_of_order_are_left_out(tmp_path: Path) -> None:
    def swapped(table: np.ndarray) -> np.ndarray:
        table[205, 5] = table[204, 5] - 5e-4
        return table

    case = load_case(written(tmp_path, swapped))
    assert case.recordings[0].times.shape == (999,)
    assert "1 frames came out of order and are left out" in case.reading["0909_1"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0909_*", "0808_*", 'files in [[runs]] 1 "0808_*.csv" matches no file'),
        ('group = "fast"', 'mocap = "a.csv"', "stands beside files"),
        ("length_s = 1.0", "length = 1.0", 'Unknown key "length"'),
        ("windows = {", 'inputs = {brake = "throttle"}\nwindows = {', 'Unknown key "brake"'),
        ("windows = {", 'inputs = {steer = "wheel"}\nwindows = {', 'There is no column "wheel"'),
        ("length_s = 1.0", "length_s = 1.0, rate_hz = 5", "leaves 6 samples in a window"),
        ("length_s = 1.0", "length_s = 60", "leaves no window in which the vehicle moves"),
    ],
)
def test_what_cannot_be_used_is_said(tmp_path: Path, old: str, new: str, message: str) -> None:
    folder = written(tmp_path)
    (folder / "case.toml").write_text(CASE.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_case(folder)
    assert message in str(caught.value)


def test_a_case_without_train_runs_can_be_judged_only(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (folder / "case.toml").write_text(CASE.replace("train", "heldout"), encoding="utf-8")
    with pytest.raises(InputError, match="a fit needs a run with role"):
        load_case(folder)
    assert not load_case(folder, to_train=False).having("train")


def test_rows_of_one_value_are_a_run(tmp_path: Path) -> None:
    t = np.tile(np.arange(20) / 20, 2)
    label = np.repeat([3, 7], 20)
    table = np.column_stack([label, t, t * (1 + label), 0 * t, 0 * t, 5 + 0 * t, 5 + 0 * t])
    names = "window,t_s,x_m,y_m,yaw_rad,l,r"
    np.savetxt(tmp_path / "robot.csv", table, "%.6f", ",", header=names, comments="")
    (tmp_path / "case.toml").write_text(
        'skid = "ideal"\n[vehicle]\nkind = "skid_steer"\nmass_kg = 50\ninertia_kgm2 = 4\nhalf_base_m = 0.25\n'
        'half_track_m = 0.27\nwheel_radius_m = 0.16\n[[runs]]\nrole = "train"\nfiles = "robot.csv"\neach = "window"\n'
        'kind = "measured"\ninputs = {left = "l", right = "r"}\n',
        encoding="utf-8",
    )
    case = load_case(tmp_path)
    assert [run.name for run in case.runs] == ["robot[3]", "robot[7]"] == [run.name for run in case.recordings]
    assert float(case.runs[1].pose[-1, 0]) == pytest.approx(0.95 * 8)


def test_the_recordings_of_the_car_are_read_as_they_stand(tmp_path: Path) -> None:
    real = beside("realcar")
    text = CASE.replace("0909_*.csv", f"{real}/0925_1002*.csv").replace("0910_1.csv", f"{real}/0904_121123.csv")
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    case = load_case(tmp_path)
    assert any("jumps at 15.3 s" in note for note in case.reading["0925_100232"])
    assert any("out of order" in note for note in case.reading["0904_121123"])
    assert all(np.ptp(np.asarray(run.pose)[:, 0]) < 3 for run in case.runs)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "groups"), [("car", {"circles", "ramp", "fast laps"}), ("robot", {None})])
def test_the_recorded_vehicles_of_data_are_cases(name: str, groups: set[str | None]) -> None:
    case = load_case(DATA / name)
    assert {run.group for run in case.having("heldout")} == groups and len(case.having("train")) > 40
    assert all(np.isfinite(np.asarray(run.pose)).all() for run in case.runs)
    assert all(1.4 < float(run.times[-1]) < 2.0 for run in case.runs)


def edited(folder: Path, edit) -> Path:
    """The case with `edit` of the lines of its first file."""
    path = written(folder) / "0909_1.csv"
    path.write_text("\n".join(edit(path.read_text(encoding="utf-8").split("\n"))), encoding="utf-8")
    return folder


def test_a_blank_cell_of_an_input_is_refused_with_its_line(tmp_path: Path) -> None:
    def blank(lines: list[str]) -> list[str]:
        cells = lines[200].split(",")
        return [*lines[:200], ",".join([*cells[:4], "", *cells[5:]]), *lines[201:]]

    with pytest.raises(InputError, match=r"The cell of steering is blank, .*line 201: fill it"):
        load_case(edited(tmp_path, blank))


def test_a_mark_a_comment_and_a_column_of_words_change_nothing(tmp_path: Path) -> None:
    def dressed(lines: list[str]) -> list[str]:
        rows = [f"{line},auto" if line else "" for line in lines[1:]]
        return ["\ufeff# logged by hand", f"{lines[0]},mode", *rows]

    plain, other = (
        load_case(case).recordings[0] for case in (written(tmp_path / "a"), edited(tmp_path / "b", dressed))
    )
    np.testing.assert_array_equal(plain.gait.signal("drive").values, other.gait.signal("drive").values)
    np.testing.assert_array_equal(plain.pose, other.pose)


def test_a_pattern_matches_files_alone(tmp_path: Path) -> None:
    (written(tmp_path) / "0909_plots.csv").mkdir()
    assert [run.name for run in load_case(tmp_path).recordings] == ["0909_1", "0910_1"]
