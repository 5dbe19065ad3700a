"""Findings in many windows: judged together, useless windows left out, and told in brief."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA

from snakejax import load_case
from snakejax.core.errors import InputError
from snakejax.estimation.multiple_shooting import cut_windows
from snakejax.recording.quality import Finding, in_brief, inspect
from snakejax.recording.run import Case


@pytest.fixture(scope="module")
def windows() -> Case:
    """A recording cut into windows of 1.5 s."""
    case = load_case(DATA / "level-board")
    parts = [w for run in case.runs for w in cut_windows(run, 1.5) if np.isfinite(np.asarray(w.pose)).all()]
    assert len(parts) > 10
    return eqx.tree_at(lambda c: c.runs, case, tuple(parts))


def changed(case: Case, numbers: list[int], change) -> Case:
    """The case with the poses of the runs `numbers` changed."""
    runs = list(case.runs)
    for k in numbers:
        runs[k] = eqx.tree_at(lambda r: r.pose, runs[k], jnp.asarray(change(np.array(runs[k].pose))))
    return eqx.tree_at(lambda c: c.runs, case, tuple(runs))


def still(pose: np.ndarray) -> np.ndarray:
    """The pose in which the vehicle was when it was lost."""
    return np.concatenate([pose[:3], np.repeat(pose[3:4], len(pose) - 3, axis=0)])


@pytest.mark.slow
def test_windows_in_which_nothing_was_measured_are_left_out(windows) -> None:
    found = inspect(changed(windows, [2, 5], still))
    left_out = [windows.runs[k].name for k in (2, 5)]
    assert [f.run for f in found.findings if f.action == "omit"] == left_out
    assert {run.name for run in windows.runs} - {run.name for run in found.case.runs} == set(left_out)
    found.require_sound()
    told = next(f for f in found.findings if f.run == left_out[0])
    assert told.done == "the window is left out"


def test_most_windows_are_not_left_out(windows) -> None:
    most = [k for k in range(len(windows.runs)) if k % 3]
    found = inspect(changed(windows, most, still))
    assert len(found.case.runs) == len(windows.runs)
    with pytest.raises(InputError, match="holds no motion"):
        found.require_sound()


@pytest.mark.slow
def test_units_are_judged_by_all_windows(windows) -> None:
    def in_millimetres(pose):
        return pose * [1e3, 1e3, 1.0]

    few = inspect(changed(windows, [3], in_millimetres))
    assert not any(f.kind == "units" for f in few.findings)
    every = inspect(changed(windows, list(range(len(windows.runs))), in_millimetres))
    assert sum(f.kind == "units" for f in every.findings) == len(windows.runs)
    with pytest.raises(InputError, match="unit of length"):
        every.require_sound()


def test_runs_that_are_no_windows_are_refused_one_by_one() -> None:
    case = load_case(DATA / "level-board")
    found = inspect(changed(case, [0], still))
    assert len(found.case.runs) == len(case.runs)
    with pytest.raises(InputError):
        found.require_sound()


def test_what_is_found_in_many_runs_is_told_once() -> None:
    many = [
        Finding("frozen", f"frozen in run {k}", "mask it", 0.0, 1.0, action="mask", run=f"run {k}") for k in range(5)
    ]
    other = Finding("gap", "a gap", "none", 0.0, 1.0, run="run 1")
    told = in_brief([many[0], other, *many[1:]])
    assert [f.what for f in told] == ["frozen in run 0; alike in 4 more runs", "a gap"]
    assert in_brief(many[:3]) == many[:3]
