"""The search for effects on a made-up linear problem: sets of effects, and one effect after the other."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.linear_problem import LinearProblem, linear_problem
from scipy import stats

from snakejax.diagnosis.selection import beam_search as beam
from snakejax.diagnosis.selection import stepwise
from snakejax.diagnosis.selection.beam_search import CandidateSubset, beam_search
from snakejax.diagnosis.selection.ranking import RankedCandidate
from snakejax.diagnosis.selection.score_test import ScoreTest
from snakejax.diagnosis.selection.screening import ScreenedCandidate
from snakejax.diagnosis.selection.stepwise import stepwise_selection


def screened(problem: LinearProblem, effects=()) -> list[ScreenedCandidate]:
    """Each further effect fitted beside `effects`, the best first."""
    known, none = problem.candidate_set, np.zeros(0)
    base, found = problem.fit(effects), []
    for effect, parts in known.candidates.items():
        if effect not in effects:
            with_it = problem.fit((*effects, effect)).solution
            fall = with_it.samples * (base.solution.misfit - with_it.misfit)
            p_value = 4 * float(stats.chi2.sf(fall, 1))
            values = {part: with_it.values[part] for part in parts}
            score = ScoreTest(effect, values, values, fall, fall, p_value, values, none, none)
            found.append(ScreenedCandidate(score, with_it.values, with_it.misfit, with_it.samples))
    return sorted(found, key=lambda s: s.misfit)


@pytest.fixture
def bench(monkeypatch):
    """A candidate set whose windows are those of the linear problem, told by `bench(problem)`."""

    def of(problem: LinearProblem):
        known: Any = problem.candidate_set

        def effects_of(free) -> tuple[str, ...]:
            return tuple(name.split(".")[1] for name in free if name.startswith("effects."))

        def settle(values, free, start, rounds):
            del values, rounds
            solution = problem.fit(effects_of(free)).solution
            cost = solution.misfit * solution.samples
            return SimpleNamespace(values=solution.values, start=start, cost=cost)

        def tested(_, free, remaining, *rest):
            scores = [s.score for s in screened(problem, effects_of(free)) if s.score.effect in remaining]
            return scores, 0.0, problem.data.size

        monkeypatch.setattr(beam, "window_sensitivities", lambda *_: None)
        monkeypatch.setattr(beam, "tested", tested)
        known.windows = SimpleNamespace(settle=settle)
        known.off_zero = lambda name, value: value
        return known

    return of


def test_the_true_pair_is_found_where_an_effect_like_both_comes_first(bench):
    """c is nearly a + b, so that it explains most by itself; the pair a, b leaves only noise."""
    problem = linear_problem({"D": 3.0, "a": 4.0, "b": 4.0})
    first = screened(problem)
    assert first[0].score.effect == "c"
    sets = beam_search(bench(problem), problem.fit(()), first, 3)
    assert set(sets[0].effects) == {"a", "b"}
    assert sets[0].misfit == pytest.approx(problem.fit(("a", "b")).solution.misfit)
    assert [s.misfit for s in sets] == sorted(s.misfit for s in sets)
    assert max(len(s.effects) for s in sets) == 2, "two explain the windows, so no third is looked for"


def test_only_the_first_is_followed_by_a_beam_of_one(bench):
    problem = linear_problem({"D": 3.0, "a": 4.0, "b": 4.0})
    known = bench(problem)
    known.criteria = known.criteria._replace(beam_width=1)
    assert all("c" in s.effects for s in beam_search(known, problem.fit(()), screened(problem), 2))


def test_the_search_ends_where_a_further_effect_brings_little(bench):
    """A slope that no candidate has: the misfit stays far above noise, and each further effect lowers it by chance."""
    problem = linear_problem({"D": 3.0, "a": 4.0})
    data = problem.data + 5.0 * np.random.default_rng(9).normal(size=problem.data.shape)
    sets = beam_search(bench(problem._replace(data=data)), problem.fit(()), screened(problem), 4)
    assert max(len(s.effects) for s in sets) == 1


@pytest.fixture
def steps(monkeypatch):
    """The names of the steps that stepwise selection takes on a linear problem, with the change of each."""

    def ranking(bench, step, *, progress=None):
        del bench, progress
        made = []
        for s in screened(steps_of.problem, step.effects):
            refit = steps_of.problem.fit((*step.effects, s.score.effect)).solution
            made.append(RankedCandidate(s.score.effect, s.score, s.misfit, refit, (), s))
        return made

    def steps_of(problem: LinearProblem) -> list[tuple[str, str]]:
        steps_of.problem = problem
        base = problem.fit(())
        stages = stepwise_selection(
            problem.candidate_set, base, tuple(ranking(None, base)), [], lambda _: None, lambda _: None
        )
        return [(stage.record.change, stage.record.name) for stage in stages]

    monkeypatch.setattr(stepwise, "rank", ranking)
    monkeypatch.setattr(stepwise, "refit_to_convergence", lambda bench, step, progress: step)
    monkeypatch.setattr(stepwise, "refit_without", lambda bench, step, rest: steps_of.problem.fit(rest).solution)
    monkeypatch.setattr(
        stepwise,
        "selection_step",
        lambda bench, change, name, step, ranking=(): SimpleNamespace(
            record=SimpleNamespace(change=change, name=name), step=step
        ),
    )
    monkeypatch.setattr(stepwise, "add_subset", lambda *_: ([], False))
    return steps_of


def test_effects_are_added_by_what_they_bring_until_noise_is_left(steps):
    assert steps(linear_problem({"D": 3.0, "a": 0.9, "d": 0.5})) == [("added", "a"), ("added", "d")]


def test_noise_alone_takes_no_step(steps):
    assert steps(linear_problem({"D": 3.0})) == []


def test_an_effect_that_others_make_needless_is_dropped(steps):
    """c comes first, as it is like both a and b; once these are in, it explains nothing."""
    taken = steps(linear_problem({"D": 3.0, "a": 0.8, "b": 0.8}, rows=600))
    assert taken[0] == ("added", "c") and taken[-1] == ("dropped", "c")
    assert sorted(taken[1:-1]) == [("added", "a"), ("added", "b")]


def test_no_more_effects_are_added_than_the_criteria_allow(steps, monkeypatch):
    problem = linear_problem({"D": 3.0, "a": 0.9, "d": 0.5})
    few = LinearProblem.candidate_set.fget
    assert few is not None

    def allowed(self):
        known = few(self)
        known.criteria = known.criteria._replace(most_effects=1)
        return known

    monkeypatch.setattr(LinearProblem, "candidate_set", property(allowed))
    assert steps(problem) == [("added", "a")]


@pytest.mark.parametrize(
    ("few", "searched", "added"),
    [(("d", "a"), False, ["a", "d"]), (("a", "b"), True, ["a", "d"]), (("a", "unknown"), True, ["a", "d"])],
)
def test_windows_are_searched_only_where_the_effects_at_hand_leave_more_than_noise(
    monkeypatch: pytest.MonkeyPatch, few: tuple[str, ...], searched: bool, added: list[str]
) -> None:
    """The effects at hand are added in the order in which each lowers the misfit."""
    problem = linear_problem({"D": 3.0, "a": 4.0, "d": 3.0})
    base, beams = problem.fit(()), []
    known: Any = problem.candidate_set
    known.off_zero = lambda name, value: value
    known.windows = SimpleNamespace(settle=lambda values, *_, rounds: SimpleNamespace(values=values, start=None))

    def beam(candidate_set, step, first, most, progress):
        beams.append(most)
        return [CandidateSubset(("a", "d"), {})]

    def refit(candidate_set, effects, values, near=True):
        return problem.fit(tuple(effects)).solution

    monkeypatch.setattr(stepwise, "beam_search", beam)
    monkeypatch.setattr(stepwise, "refit", refit)
    monkeypatch.setattr(stepwise, "continue_to_convergence", lambda problem, solution, train: solution)
    monkeypatch.setattr(stepwise, "accept_addition", lambda *_: True)
    monkeypatch.setattr(stepwise, "no_worse", lambda candidate_set, before, effects, solution: solution)
    monkeypatch.setattr(stepwise, "rank", lambda *_, progress: [])
    ranking = [RankedCandidate(s.score.effect, s.score, s.misfit, None, (), s) for s in screened(problem)]
    path, hopeless = stepwise.add_subset(
        known, base, ranking, lambda _: None, CandidateSubset(few, base.solution.values)
    )
    assert bool(beams) is searched
    assert [step.name for step in path] == added and not hopeless
