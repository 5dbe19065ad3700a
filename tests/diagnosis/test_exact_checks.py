"""An effect that only stands for one odd run is dropped; one that explains all runs is not."""

from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import exact_checks
from snakejax.diagnosis.exact_checks import odd_run_rather_than_effect
from snakejax.diagnosis.odd_runs import OddRun
from snakejax.diagnosis.selection.criteria import CRITERIA

SAMPLES = 10_000


def step(change: str, name: str, misfit: float, odd_fall: float = 0.0, alone: bool = False) -> Any:
    """A working step that leaves `misfit`, beside which a shift of one run lowers chi^2 by `odd_fall`; its last effect
    is in one run `alone`."""
    solution = SimpleNamespace(misfit=misfit, samples=SAMPLES, loose=())
    odd = (OddRun("two", "tyre.D", odd_fall**0.5, 1.0, 1e-4),) if odd_fall else ()
    return SimpleNamespace(
        record=SimpleNamespace(change=change, name=name),
        candidate_set=SimpleNamespace(criteria=CRITERIA),
        step=SimpleNamespace(solution=solution, odd=odd, alone=alone),
        ranking=(),
    )


@pytest.fixture
def changes(monkeypatch: pytest.MonkeyPatch):
    """The changes of the steps that are added to some."""
    monkeypatch.setattr(exact_checks, "odd_runs_beside", lambda _, fit: fit.odd)
    monkeypatch.setattr(exact_checks, "one_run_alone_shows", lambda _, fit, effect: fit.alone)
    monkeypatch.setattr(
        exact_checks,
        "selection_step",
        lambda _, change, name, fit, ranking: step(change, name, fit.solution.misfit),
    )

    def of(*steps: Any) -> list[str]:
        shown: list[str] = []
        judged = odd_run_rather_than_effect(steps, lambda record: shown.append(record.name))
        assert judged[: len(steps)] == list(steps)
        names = [one.record.name for one in judged[len(steps) :]]
        assert {one.record.change for one in judged[len(steps) :]} <= {"dropped"} and shown == names
        return names

    return of


FALL = 20.0
AFTER = 1.0 - FALL / SAMPLES


def test_an_effect_that_only_stands_for_an_odd_run_is_dropped(changes) -> None:
    odd = FALL + 1.1 * CRITERIA.distinct_chi2
    assert changes(step("base", "", 1.0, odd), step("added", "com_offset", AFTER)) == ["com_offset"]


def test_an_effect_that_one_run_alone_shows_is_dropped(changes) -> None:
    assert changes(step("base", "", 1.0, 0.5 * FALL), step("added", "slope", AFTER, alone=True)) == ["slope"]
    assert changes(step("base", "", 1.0), step("added", "slope", AFTER, alone=True)) == []


@pytest.mark.parametrize("odd", [0.0, FALL + 0.9 * CRITERIA.distinct_chi2])
def test_an_effect_that_explains_as_much_as_an_odd_run_stays(changes, odd: float) -> None:
    assert changes(step("base", "", 1.0, odd), step("added", "com_offset", AFTER)) == []


def test_an_effect_without_which_more_than_noise_is_left_stays(changes) -> None:
    """There an odd run may be one of many things that the model lacks."""
    assert changes(step("base", "", 3.0, 1e6), step("added", "com_offset", 1.0)) == []


def test_what_was_added_after_an_effect_that_stands_for_an_odd_run_is_dropped_too(changes) -> None:
    """Beside the first effect the run may not look odd any more."""
    odd, second = FALL + 2 * CRITERIA.distinct_chi2, AFTER - FALL / SAMPLES
    for beside in (0.0, odd):
        steps = (step("base", "", 1.0, odd), step("added", "a", AFTER, beside), step("added", "b", second))
        assert changes(*steps) == ["b", "a"]
    assert changes(step("base", "", 3.0, odd), step("added", "a", AFTER, odd), step("added", "b", second)) == ["b"]


def test_steps_that_go_back_already_are_left(changes) -> None:
    steps = (step("base", "", 1.0, 1e3), step("added", "a", AFTER), step("removed", "a", 1.0))
    assert changes(*steps) == []


@pytest.mark.parametrize(
    ("reached", "explained"), [([1.5, 1.001], True), ([2.9, 1.001], False), ([1.5, 1.4, 1.0], False)]
)
def test_the_fit_of_constants_goes_on_where_it_came_much_nearer(
    monkeypatch: pytest.MonkeyPatch, reached: list[float], explained: bool
) -> None:
    """It stops where a step did little, as in a valley that bends, and begins again where it stopped."""
    misfits, starts = iter(reached), []

    class Problem(SimpleNamespace):
        def fit(self, values, names, runs, start, crawl):
            starts.append(values)
            fitted = {"board.mass": 7.0 + 0.01 * len(starts)}
            return SimpleNamespace(misfit=next(misfits), samples=SAMPLES, loose=(), values=fitted, start=start)

    freed = Problem(names=("board.mass",), model=None)
    monkeypatch.setattr(exact_checks, "_with_free_constants", lambda *_: (freed, {"board.mass": 0.03}))
    monkeypatch.setattr(exact_checks, "parameters", lambda _: {"board.mass": SimpleNamespace(value=7.0)})
    base = SimpleNamespace(misfit=3.0, values={"board.mass": 7.0}, start=None)
    candidate_set: Any = SimpleNamespace(train=(0,))
    found = exact_checks.constants_explain(candidate_set, SimpleNamespace(solution=base, effects=()), {})  # type: ignore[arg-type]
    assert found is explained
    assert starts == [{"board.mass": 7.0}, {"board.mass": 7.01}][: 1 if reached[0] > 2 else 2]
