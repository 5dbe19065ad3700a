"""Joint logs on a clock of their own: what is given, what the motion alone tells, and what is noticed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.logged_case import CLOCKS, LEVEL, logged_case

from snakejax import load_case
from snakejax.core.errors import InputError
from snakejax.recording.quality import clocks, lag
from snakejax.recording.run import LogClock


@pytest.mark.slow
def test_a_given_clock_is_believed(tmp_path):
    case = load_case(logged_case(tmp_path / "case", "offset_s = -0.2, drift = -0.01"))
    raw = load_case(logged_case(tmp_path / "raw", "offset_s = -0.25"))
    assert case.runs[0].log == LogClock(-0.2, -0.01)
    t = 1.3
    expected = raw.runs[0].gait.psi.at(jnp.asarray(t * 0.99 - 0.2 + 0.25)).angle
    np.testing.assert_allclose(case.runs[0].gait.psi.at(jnp.asarray(t)).angle, expected, rtol=1e-9)


@pytest.mark.slow
def test_the_motion_alone_tells_the_offset(tmp_path):
    """To some hundredths of a second, on every run: with its standard error of 0.05 s."""
    case = load_case(logged_case(tmp_path / "case", 'offset_s = "estimate"'))
    for run in case.runs:
        assert run.log.free == ("offset",) and run.log.source == "the motion alone"
        assert abs(run.log.offset - CLOCKS[run.name][0]) < 1.5 * run.log.offset_sd
        assert run.log.offset_sd < 0.08


@pytest.mark.slow
def test_clocks_that_start_at_different_epochs(tmp_path):
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"')
    path = folder / "train-arc-1-joints.csv"
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    moved = [f"{float(t) + 86400:.6f},{phi},{psi}" for t, phi, psi in cells]
    path.write_text("\n".join([head, *moved]) + "\n", encoding="utf-8")
    (run,) = [run for run in load_case(folder).runs if run.name == "train-arc-1"]
    assert run.log.offset == pytest.approx(86400.4, abs=0.1)


@pytest.mark.slow
def test_a_log_of_another_run_is_said(tmp_path):
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"')
    log = folder / "train-rotate-1-joints.csv"
    rng = np.random.default_rng(0)
    wander = np.cumsum(rng.normal(size=(1300, 2)) * 0.01, axis=0)
    rows = "".join(f"{0.01 * k:.2f},{a:.6f},{b:.6f}\n" for k, (a, b) in enumerate(wander))
    log.write_text("time_s,phi_rad,psi_rad\n" + rows, encoding="utf-8")
    with pytest.raises(InputError, match=r"does not match the logged joints.*run train-rotate-1: check that the log"):
        load_case(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "complaint"),
    [('offset_s = "guess"', "must be a number"), ("drift = 0.5", "but is 0.5"), ("offest_s = 1", 'write "offset_s"')],
)
def test_what_cannot_be_a_clock(tmp_path, keys, complaint):
    with pytest.raises(InputError, match=complaint):
        load_case(logged_case(tmp_path / "case", keys))


def test_gaits_and_cameras_go_together_and_half_a_second_is_noticed():
    run = load_case(LEVEL).runs[3]
    assert clocks(run) == [] and abs(lag(run, 1.0).offset) < 0.06
    late = eqx.tree_at(lambda r: r.pose, run, run.pose[50:])
    late = eqx.tree_at(lambda r: r.times, late, run.times[:-50])
    found = clocks(late)
    assert found[0].kind == "clock_offset" and found[0].size == pytest.approx(0.5, abs=0.1)


def test_a_clock_that_runs_at_another_pace_is_noticed():
    run = load_case(LEVEL).runs[3]
    slow = eqx.tree_at(lambda r: r.times, run, run.times * 1.05)
    assert [f.kind for f in clocks(slow)] == ["clock_offset"]
