"""The inputs of the runs of a case: logs that are held, and the actuators behind them."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.car_toml import CAR_TOML

from snakejax.core.errors import InputError
from snakejax.recording.case import load_case

CASE = (
    CAR_TOML
    + """\
{actuator}
[[runs]]
role = "train"
mocap = "run.csv"
object = "car"
joint_log = {{file = "log.csv", kind = "commanded", hold = true}}
{keys}
"""
)


def written(folder: Path, keys: str = "", actuator: str = "") -> Path:
    """A run of 15 s along x, whose drive grows by 0.1 a second."""
    (folder / "case.toml").write_text(CASE.format(keys=keys, actuator=actuator), encoding="utf-8")
    t = np.arange(0.0, 15.0, 0.02)
    poses = np.column_stack([t, t, 0 * t, 0 * t])
    np.savetxt(folder / "run.csv", poses, "%.6f", ",", header="time_s,x_m,y_m,heading_rad", comments="")
    held = np.arange(0.0, 15.0, 0.1)
    table = np.column_stack([held, 0 * held, 0.1 * held])
    np.savetxt(folder / "log.csv", table, "%.6f", ",", header="time_s,steer,drive", comments="")
    return folder


@pytest.mark.parametrize(("start", "kept"), [("rest", True), ("moving", False)])
def test_a_held_log_keeps_what_the_simulation_passes(tmp_path: Path, start: str, kept: bool) -> None:
    """A run from rest is simulated from time 0, and one under way from the start of its window."""
    case = load_case(written(tmp_path, f'window_s = [8.0, 12.0]\nstart = "{start}"'))
    drive = case.runs[0].gait.signal("drive")
    assert (float(drive.at(jnp.asarray(1.0)).angle) == pytest.approx(0.1)) is kept
    assert float(drive.at(jnp.asarray(9.05)).angle) == pytest.approx(0.9)


def test_a_window_of_words_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"window_s in .* must be a list of 2 finite numbers"):
        load_case(written(tmp_path, 'window_s = ["a", "b"]'))


def test_gains_and_a_lag_of_one_actuator_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lag_s .* stands beside kp and kd"):
        load_case(written(tmp_path, actuator="[actuator.drive]\nkp = 100.0\nkd = 10.0\nlag_s = 0.5"))
