"""Checks of a model that leaves only noise: the bands of each run, and whether constants explain as well."""

from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.parameter import parameters
from snakejax.estimation.discrepancy.priors import constant_sd
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.problem import Problem

from .explanation import RunBand, run_bands
from .selection.candidates import CandidateFit, CandidateSet

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
