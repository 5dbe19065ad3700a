"""The order of candidates, on records made up for it."""

from typing import Any, cast

import numpy as np
import pytest
from helpers.linear_problem import linear_problem

from snakejax.diagnosis.selection import ranking as module
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.diagnosis.selection.ranking import (
    RankedCandidate,
    any_refit_consistent,
    insert_by_refit,
    rank,
    significant,
    trial_order,
)
from snakejax.diagnosis.selection.score_test import ScoreTest
from snakejax.diagnosis.selection.screening import ScreenedCandidate

SOLUTION = linear_problem({"D": 3.0}).fit(()).solution


def score(effect: str, p_value: float = 1e-6, statistic: float = 100.0) -> ScoreTest:
    span = np.eye(9)[:, [ord(effect[0]) - ord("a")]]
    name = f"effects.{effect}.p"
    return ScoreTest(effect, {name: 1.0}, {name: 0.1}, 100.0, statistic, p_value, {name: 0.1}, span[:, 0], span)


def ranked(effect: str, windows: float | None, refit: float | None, p_value: float = 1e-6) -> RankedCandidate:
    solution = None if refit is None else SOLUTION._replace(misfit=refit, samples=10_000)
    return RankedCandidate(effect, score(effect, p_value), windows, solution, ())


def names(ranking) -> list[str]:
    return [r.effect for r in ranking]


def test_candidates_are_tried_as_refitted_where_one_refit_is_near_and_by_windows_where_all_are_far():
    near = [ranked("a", 1.8, 2.0), ranked("b", 1.2, 80.0), ranked("c", 1.1, None)]
    assert names(trial_order(near)) == ["a", "b"]
    far = [ranked("a", 1.8, 60.0), ranked("b", 1.2, 80.0), ranked("d", None, 70.0)]
    assert names(trial_order(far)) == ["b", "a", "d"]
    assert names(trial_order(far, CRITERIA._replace(far_misfit=65.0))) == ["a", "b", "d"]


def test_the_change_of_structure_is_never_tried_as_an_effect():
    switch = RankedCandidate("lateral_skid", None, None, SOLUTION, ())
    assert names(trial_order([switch, ranked("a", 1.8, 2.0)])) == ["a"]


def test_a_candidate_is_inserted_where_its_refit_belongs_and_those_without_stay_behind():
    ranking = [ranked("a", 1.2, 2.0), ranked("b", 1.3, 8.0), ranked("c", 1.1, None), ranked("d", 1.0, None)]
    for misfit, expected in ((1.5, "eabcd"), (5.0, "aebcd"), (9.0, "abecd")):
        assert "".join(names(insert_by_refit(ranking, ranked("e", None, misfit)))) == expected


def test_a_ranking_is_significant_where_a_corrected_p_value_is_below_the_level():
    assert significant([ranked("a", 1.2, None, 0.5), ranked("b", 1.2, None, 0.0099)])
    assert not significant([ranked("a", 1.2, None, 0.0101)])
    assert significant([ranked("a", 1.2, None, 0.0101)], CRITERIA._replace(significance_level=0.05))
    assert not significant([RankedCandidate("lateral_skid", None, None, SOLUTION, ())])


def test_a_refit_is_consistent_within_four_sigma_of_the_noise():
    edge = 1 + 4 * np.sqrt(2 / 10_000)
    assert any_refit_consistent([ranked("a", 1.2, 3.0), ranked("b", 1.2, edge - 0.001)])
    assert not any_refit_consistent([ranked("a", 1.2, edge + 0.001), ranked("c", 1.0, None)])


@pytest.fixture
def refitted(monkeypatch) -> list[str]:
    """The effects that `rank` refits, with screening and refits made up."""
    tried: list[str] = []
    misfits = {"a": 1.3, "b": 1.8, "c": 1.95, "d": 1.2, "e": 1.5, "f": 1.6}
    p_values = {"d": 0.02}
    screened = [ScreenedCandidate(score(e, p_values.get(e, 1e-9)), {}, m, 10_000) for e, m in misfits.items()]

    def refit(bench, effects, values, *, near):
        del values, near
        tried.append(effects[-1])
        return SOLUTION._replace(misfit=9.0 if effects[-1] == "e" else misfits[effects[-1]], samples=10_000)

    monkeypatch.setattr(module, "screen_candidates", lambda *_: screened)
    monkeypatch.setattr(module, "refit", refit)
    monkeypatch.setattr(module, "no_worse", lambda bench, step, effects, solution: solution)
    monkeypatch.setattr(module, "estimates_of", lambda *_: {})
    return tried


def test_the_best_significant_candidates_are_refitted_and_come_first(refitted):
    """d is not significant; the best leaves an excess of 0.3, and b and f would be the fourth and fifth."""
    problem = linear_problem({"D": 3.0})
    step = problem.fit(())
    step = step._replace(solution=step.solution._replace(misfit=4.0, samples=10_000))
    found = rank(problem.candidate_set, step)
    assert sorted(refitted) == ["a", "e", "f"]
    assert names(found)[:2] == ["a", "f"]
    (failed,) = [r for r in found if r.failed]
    assert failed.effect == "e" and failed.refit is None, "9 is worse than the 4 of the base, which it contains"


def test_a_candidate_far_behind_the_best_on_the_windows_is_not_refitted(refitted):
    """Below three times the excess 0.3 of the best, 0.9, lies b with 0.8, but not c with 0.95."""
    problem = linear_problem({"D": 3.0})
    step = problem.fit(())
    step = step._replace(solution=step.solution._replace(misfit=4.0, samples=10_000))
    rank(problem.candidate_set, step, refitted=10)
    assert sorted(refitted) == ["a", "b", "e", "f"]
    refitted.clear()
    tight: Any = cast(Any, problem.candidate_set)
    tight.criteria = CRITERIA._replace(candidate_excess_ratio=1.5)
    rank(tight, step)
    assert refitted == ["a"]


@pytest.mark.parametrize(
    ("misfits", "explained", "tried"),
    [
        # chi^2 of 10 000 samples: b is 5 above a, c is 20 above it.
        ({"a": 1.0, "b": 1.0005, "c": 1.002}, False, ["a", "b"]),
        ({"a": 2.0, "b": 2.0005, "c": 2.002}, False, ["a", "b", "c"]),
        ({"a": 2.0, "b": 2.0005, "c": 2.002}, True, []),
        ({"a": 1.0, "b": 1.0005, "c": 1.002}, True, ["a", "b"]),
    ],
)
def test_what_windows_exclude_is_not_refitted_where_a_model_leaves_only_noise(
    monkeypatch: pytest.MonkeyPatch, misfits: dict[str, float], explained: bool, tried: list[str]
) -> None:
    done: list[str] = []

    def refit(bench, effects, values, *, near):
        done.append(effects[-1])
        return SOLUTION._replace(misfit=misfits[effects[-1]], samples=10_000)

    start = np.zeros((1, 3))
    screened = [ScreenedCandidate(score(effect), {}, misfit, 10_000, start) for effect, misfit in misfits.items()]
    monkeypatch.setattr(module, "screen_candidates", lambda *_: screened)
    monkeypatch.setattr(module, "refit", refit)
    monkeypatch.setattr(module, "no_worse", lambda bench, step, effects, solution: solution)
    monkeypatch.setattr(module, "estimates_of", lambda *_: {})
    problem = linear_problem({"D": 3.0})
    step = problem.fit(())
    step = step._replace(solution=step.solution._replace(misfit=4.0, samples=10_000))
    rank(problem.candidate_set, step, explained=lambda: explained)
    assert sorted(done) == tried
