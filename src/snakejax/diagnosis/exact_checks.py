"""Checks of a model that leaves only noise: the bands of each run, and runs that differ from the others."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.parameter import parameters
from snakejax.estimation.discrepancy.priors import constant_sd
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.problem import Problem

from .explanation import RunBand, run_bands
from .odd_runs import OddRun, odd_runs, run_grams, run_that_alone_shows
from .selection.candidates import CandidateFit, CandidateSet
from .selection.score_test import projected
from .selection.screening import window_sensitivities
from .selection.steps import SelectionStep
from .selection.working_step import WorkingStep, selection_step

STATED_WELL = 3.5
"""A constant is not off by more than so many standard deviations of what is known of it: one in two thousand."""
HOPELESS = 0.02
"""The fit of constants that are to explain all stops where a step of it lowers a large misfit by less than this share.
"""
NEARER = 0.5
"""It goes on from there where it has brought the misfit nearer to that of noise by this share."""


def bands_of(fitted: FittedModel) -> tuple[RunBand, ...]:
    """The share of each run inside the bands of 95%, which are those of the noise alone."""
    sd = np.asarray(fitted.noise.channels)
    residuals = [residual * sd for residual in fitted.residuals]
    return run_bands(fitted.recordings, residuals, [np.broadcast_to(sd, residual.shape) for residual in residuals])


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


def odd_run_rather_than_effect(
    steps: Sequence[WorkingStep], show: Callable[[SelectionStep], None]
) -> list[WorkingStep]:
    """`steps`, and after them one for each effect that is dropped because one run alone is the better explanation.

    Where a model leaves only noise before an effect is added, the effect is an answer to little, and a single run may
    be a better one: where a parameter with a value of its own in that run lowers chi^2 by `distinct_chi2` more than the
    effect does in all runs, or where that run alone shows the effect. The effects added after it are dropped too: they
    were chosen beside an effect that stood for the run.
    """
    for number, (before, after) in enumerate(itertools.pairwise(steps), 1):
        added = all(step.record.change == "added" for step in steps[number:])
        if added and consistent_with_noise(before.step.solution) and _one_run_is_better(before, after):
            return _without_last(steps, number, show)
    return list(steps)


def _one_run_is_better(before: WorkingStep, after: WorkingStep) -> bool:
    """Whether one run alone explains better what the effect added in the step `after` explains."""
    candidate_set, solution = before.candidate_set, before.step.solution
    odd = odd_runs_beside(candidate_set, before.step)
    if not odd:
        return False
    fall = solution.samples * (solution.misfit - after.step.solution.misfit)
    better = max(one.fall for one in odd) > fall + candidate_set.criteria.distinct_chi2
    return better or one_run_alone_shows(after.candidate_set, after.step, after.record.name)


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


def constants_explain(candidate_set: CandidateSet, step: CandidateFit, stated: Mapping[str, float]) -> bool:
    """Whether the constants of the vehicle, once they are free, explain the train runs without a further effect.

    The fit `step` has to leave only noise then, and each constant has to be within `STATED_WELL` standard deviations of
    its value: those `stated` [SI], or those of its kind.
    """
    freed, sds = _with_free_constants(candidate_set, step.effects, stated)
    known, names = parameters(freed.model), freed.names
    values = {name: value for name, value in step.solution.values.items() if name in names}
    before, solution = step.solution, freed.fit(values, names, candidate_set.train, step.solution.start, crawl=HOPELESS)
    # In a valley that bends one step may do little. A fit that has come much nearer goes on from where it stopped.
    while not consistent_with_noise(solution) and solution.misfit - 1 < NEARER * (before.misfit - 1):
        before = solution
        solution = freed.fit(before.values, names, candidate_set.train, before.start, crawl=HOPELESS)
    if not consistent_with_noise(solution):
        return False
    moved = {name: abs(np.log(solution.values[name] / float(known[name].value))) for name in sds}
    return all(moved[name] <= STATED_WELL * sd for name, sd in sds.items())


def _with_free_constants(
    candidate_set: CandidateSet, effects: Sequence[str], stated: Mapping[str, float]
) -> tuple[Problem, dict[str, float]]:
    """The problem of the tyre, `effects` and the constants of the vehicle, and the standard deviations of these."""
    problem = candidate_set.problem
    absent = [name for name in candidate_set.candidates if name not in effects]
    model = problem.model.without(*absent)
    known = parameters(model)
    sds = {name: sd for name, sd in constant_sd(model, stated).items() if name in known}
    names = [*candidate_set.free(effects), *sds]
    return Problem.of(model, problem.runs, problem.noise, names, len(names), threshold=problem.threshold), sds


def compile_later_programs(candidate_set: CandidateSet, effects: Sequence[str], stated: Mapping[str, float]) -> None:
    """Compile the programs that an explanation needs after its windows: of fits with several effects, and with free
    constants. They are run for no recording at all."""
    for problem in (candidate_set.problem, _with_free_constants(candidate_set, effects, stated)[0]):
        problem.evaluate(problem.at(problem.values(), problem.names[: problem.width]), [])
