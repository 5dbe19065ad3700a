"""An effect that only stands for one odd run is dropped; one that explains all runs is not."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import effect_or_odd_run
from snakejax.diagnosis.effect_or_odd_run import against_odd_runs
from snakejax.diagnosis.odd_runs import OddRun
from snakejax.diagnosis.selection.criteria import CRITERIA

SAMPLES, RUNS = 10_000, 5
CHOICE = 2 * math.log(RUNS)
"""What the choice of one of the runs gains in chi^2."""


def step(change: str, name: str, misfit: float, odd_fall: float = 0.0, alone: bool = False) -> Any:
    """A working step that leaves `misfit`, beside which a shift of one run lowers chi^2 by `odd_fall`; its last effect
    is in one run `alone`."""
    solution = SimpleNamespace(misfit=misfit, samples=SAMPLES, loose=())
    odd = (OddRun("two", "tyre.D", odd_fall**0.5, 1.0, 1e-4),) if odd_fall else ()
    return SimpleNamespace(
        record=SimpleNamespace(change=change, name=name),
        candidate_set=SimpleNamespace(criteria=CRITERIA, train=range(RUNS)),
        step=SimpleNamespace(solution=solution, odd=odd, alone=alone),
        ranking=(),
    )


@pytest.fixture
def changes(monkeypatch: pytest.MonkeyPatch):
    """The effects that are dropped at the end of some steps, and those instead of which a run may be odd."""
    monkeypatch.setattr(effect_or_odd_run, "odd_runs_beside", lambda _, fit: fit.odd)
    monkeypatch.setattr(effect_or_odd_run, "one_run_alone_shows", lambda _, fit, effect: fit.alone)
    monkeypatch.setattr(
        effect_or_odd_run,
        "selection_step",
        lambda _, change, name, fit, ranking: step(change, name, fit.solution.misfit),
    )

    def of(*steps: Any) -> tuple[list[str], list[str]]:
        shown: list[str] = []
        judged = against_odd_runs(steps, lambda record: shown.append(record.name))
        assert judged.steps[: len(steps)] == list(steps)
        dropped = judged.steps[len(steps) :]
        names = [one.record.name for one in dropped]
        assert {one.record.change for one in dropped} <= {"dropped"} and shown == names
        return names, [effect for odd in judged.instead for effect in odd.effects]

    return of


FALL = 20.0
AFTER = 1.0 - FALL / SAMPLES


def test_an_effect_that_only_stands_for_an_odd_run_is_dropped(changes) -> None:
    odd = FALL + 1.1 * CRITERIA.distinct_chi2
    assert changes(step("base", "", 1.0, odd), step("added", "com_offset", AFTER)) == (["com_offset"], [])


def test_an_effect_that_one_run_alone_shows_is_dropped(changes) -> None:
    assert changes(step("base", "", 1.0, 0.5 * FALL), step("added", "slope", AFTER, alone=True)) == (["slope"], [])
    assert changes(step("base", "", 1.0), step("added", "slope", AFTER, alone=True)) == ([], [])


@pytest.mark.parametrize("odd", [0.0, FALL - 1.1 * CRITERIA.distinct_chi2])
def test_an_effect_that_explains_more_than_an_odd_run_stays(changes, odd: float) -> None:
    assert changes(step("base", "", 1.0, odd), step("added", "com_offset", AFTER)) == ([], [])


@pytest.mark.parametrize("lead", [-0.9 * CRITERIA.distinct_chi2, 0.9 * CHOICE])
def test_an_effect_that_explains_no_more_than_an_odd_run_stays_beside_it(changes, lead: float) -> None:
    """One of five runs is chosen."""
    steps = step("base", "", 1.0, FALL + lead), step("added", "com_offset", AFTER)
    assert changes(*steps) == ([], ["com_offset"])


def test_an_effect_that_explains_hardly_less_than_an_odd_run_is_dropped_and_told(changes) -> None:
    odd = FALL + 0.5 * (CHOICE + CRITERIA.distinct_chi2)
    assert changes(step("base", "", 1.0, odd), step("added", "com_offset", AFTER)) == (["com_offset"], ["com_offset"])


def test_an_effect_without_which_more_than_noise_is_left_stays(changes) -> None:
    """There an odd run may be one of many things that the model lacks."""
    assert changes(step("base", "", 3.0, 1e6), step("added", "com_offset", 1.0)) == ([], [])


def test_what_was_added_after_an_effect_that_stands_for_an_odd_run_is_dropped_too(changes) -> None:
    """Beside the first effect the run may not look odd any more."""
    odd, second = FALL + 2 * CRITERIA.distinct_chi2, AFTER - FALL / SAMPLES
    for beside in (0.0, odd):
        steps = (step("base", "", 1.0, odd), step("added", "a", AFTER, beside), step("added", "b", second))
        assert changes(*steps)[0] == ["b", "a"]
    assert changes(step("base", "", 3.0, odd), step("added", "a", AFTER, odd), step("added", "b", second)) == (
        ["b"],
        [],
    )


def test_steps_that_go_back_already_are_left(changes) -> None:
    steps = (step("base", "", 1.0, 1e3), step("added", "a", AFTER), step("removed", "a", 1.0))
    assert changes(*steps) == ([], [])
