"""Whether an effect acts in all runs, or one run differs from the others."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from snakejax.core.parameter import parameters
from snakejax.estimation.goodness_of_fit import consistent_with_noise

from .odd_runs import OddRun, odd_runs, run_grams, run_that_alone_shows
from .selection.candidates import CandidateFit, CandidateSet
from .selection.score_test import projected
from .selection.screening import window_sensitivities
from .selection.steps import SelectionStep
from .selection.working_step import WorkingStep, selection_step


class AgainstOddRuns(NamedTuple):
    """Steps judged against odd runs: all `steps`, those that drop effects among them; and the runs that may be odd
    `instead` of an effect, which each of them names."""

    steps: list[WorkingStep]
    instead: tuple[OddRun, ...] = ()


class _RunByRun(NamedTuple):
    """The Gram matrices of each train run at a fit, the columns of all parameters, and those of the fitted ones."""

    gram: np.ndarray
    columns: dict[str, int]
    fitted: list[int]

    @staticmethod
    def of(candidate_set: CandidateSet, step: CandidateFit) -> "_RunByRun | None":
        """By the sensitivities of whole runs; None where they are not told apart."""
        solution, names = step.solution, candidate_set.problem.names
        rest = projected(window_sensitivities(candidate_set, solution.values, solution.start, windows=False))
        if rest.run is None:
            return None
        columns = {name: k for k, name in enumerate(names)}
        fitted = [columns[name] for name in candidate_set.free(step.effects) if name not in solution.held]
        return _RunByRun(run_grams(rest.residual, -rest.columns, rest.run), columns, fitted)


def odd_runs_beside(candidate_set: CandidateSet, step: CandidateFit) -> tuple[OddRun, ...]:
    """The train runs to which the fit `step` does not apply, by the sensitivities of whole runs."""
    values, problem = step.solution.values, candidate_set.problem
    linear = _RunByRun.of(candidate_set, step)
    if linear is None:
        return ()
    runs = [problem.runs[k].name for k in candidate_set.train]
    known = parameters(problem.model)
    shifts = odd_runs(linear.gram, runs, linear.columns, linear.fitted)
    return tuple(shift.in_units(known[shift.parameter].domain, float(values[shift.parameter])) for shift in shifts)


def one_run_alone_shows(candidate_set: CandidateSet, step: CandidateFit, effect: str) -> bool:
    """Whether the `effect` of the fit `step` is in one run alone, and the others exclude it."""
    known, neutral = parameters(candidate_set.problem.model), candidate_set.problem.values()
    parts = [name for name in candidate_set.candidates.get(effect, ()) if name not in step.solution.held]
    if not parts or any(known[name].domain.multiplicative for name in parts):
        return False
    linear = _RunByRun.of(candidate_set, step)
    if linear is None:
        return False
    value = np.array([step.solution.values[name] - neutral[name] for name in parts])
    some = [linear.columns[name] for name in parts]
    return run_that_alone_shows(linear.gram, linear.fitted, some, value) is not None


def against_odd_runs(steps: Sequence[WorkingStep], show: Callable[[SelectionStep], None]) -> AgainstOddRuns:
    """`steps`, and after them one for each effect that is dropped because one run alone is the better explanation.

    Where a model leaves only noise before an effect is added, the effect is an answer to little, and one run that
    differs may be a better one: where a parameter with a value of its own in one of R runs lowers chi^2 by 2 ln R more
    than the effect does in all runs (one of R runs is chosen), or where that run alone shows the effect. The effects
    added after it are dropped too: they were chosen beside an effect that stood for the run. Where the two lower chi^2
    by the same but for `distinct_chi2`, these runs cannot tell which it is, whichever is kept.
    """
    instead: list[OddRun] = []
    for number, (before, after) in enumerate(pairwise(steps), 1):
        added = all(step.record.change == "added" for step in steps[number:])
        if not (added and consistent_with_noise(before.step.solution)):
            continue
        odd, effect = odd_runs_beside(before.candidate_set, before.step), after.record.name
        if not odd:
            continue
        oddest, solution = max(odd, key=lambda one: one.fall), before.step.solution
        lead = oddest.fall - solution.samples * (solution.misfit - after.step.solution.misfit)
        if abs(lead) < before.candidate_set.criteria.distinct_chi2:
            instead.append(oddest._replace(effects=(effect,)))
        runs = len(before.candidate_set.train)
        if lead > 2 * np.log(runs) or one_run_alone_shows(after.candidate_set, after.step, effect):
            return AgainstOddRuns(_without_last(steps, number, show), tuple(instead))
    return AgainstOddRuns(list(steps), tuple(instead))


def _without_last(
    steps: Sequence[WorkingStep], number: int, show: Callable[[SelectionStep], None]
) -> list[WorkingStep]:
    """`steps`, and the effects added by those from `number` on dropped one by one, the last first."""
    judged = list(steps)
    for before, after in zip(reversed(steps[number - 1 : -1]), reversed(steps[number:]), strict=True):
        name = after.record.name
        judged.append(selection_step(before.candidate_set, "dropped", name, before.step, before.ranking))
        show(judged[-1].record)
    return judged
