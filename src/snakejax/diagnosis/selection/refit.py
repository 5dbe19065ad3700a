"""Fits of the base and of models with more effects, from windows to whole train runs."""

from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initialisation import (
    best_of,
    continue_over_horizons,
    continue_to_convergence,
    fit_windows,
    require_consistent_derivative,
    require_sensitive,
)
from snakejax.estimation.many_runs import MANY
from snakejax.estimation.problem import Solution
from snakejax.estimation.sensitivity import NEARER

from .candidates import CandidateFit, CandidateSet
from .criteria import CRITERIA, SelectionCriteria

CRAWL = 2e-3
"""A model that is not the truth is fitted no further where a step lowers its misfit by less than this share."""


def base_fit(
    candidate_set: CandidateSet, effects: Sequence[str] = (), progress: Progress = no_progress
) -> CandidateFit:
    """The base: the tyre, and `effects` put in from the start, fitted to windows and then to whole train runs."""
    require_sensitive(candidate_set.problem, candidate_set.problem.values(), candidate_set.tyre, candidate_set.train)
    fit = fresh_fit(candidate_set, effects, candidate_set.problem.values(), progress)
    require_consistent_derivative(candidate_set.problem, fit.solution, candidate_set.train)
    return fit


def fresh_fit(
    candidate_set: CandidateSet,
    effects: Sequence[str],
    values: Mapping[str, float],
    progress: Progress = no_progress,
) -> CandidateFit:
    """The tyre fitted from where it began, and `effects` from `values`, to windows and then to whole train runs.

    Windows settle from two sizes of the tyre force. Where the fit ends near the noise but not in it, or not at all, the
    growing horizon is tried too: it may have missed the optimum, which must not be taken for a missing effect.
    """
    problem, train, free = candidate_set.problem, candidate_set.train, candidate_set.free(effects)
    progress(ProgressEvent(Phase.WINDOWS))
    began = {name: problem.values()[name] for name in candidate_set.tyre}
    values = {
        name: candidate_set.off_zero(name, value) if name in free else value for name, value in values.items()
    } | began
    windows = fit_windows(candidate_set.windows, values, free)
    progress(ProgressEvent(Phase.WHOLE_RUNS))
    misfit = windows.cost / max(windows.linearised.residual.size, 1)
    solution = refit(candidate_set, effects, windows.values, near=misfit < candidate_set.criteria.close_windows_misfit)
    if (
        consistent_with_noise(solution) and solution.converged
    ) or not solution.misfit < candidate_set.criteria.far_misfit:
        return CandidateFit(tuple(effects), solution, windows)
    first = continue_over_horizons(problem, values, free, train, progress)
    solution = best_of(solution, problem.fit(first.values, free, train, first.start, crawl=CRAWL, most=30))
    if consistent_with_noise(solution):
        solution = continue_to_convergence(problem, solution, train)
    return CandidateFit(tuple(effects), solution, windows)


def refit(
    candidate_set: CandidateSet,
    effects: Sequence[str],
    values: Mapping[str, float],
    start: np.ndarray | None = None,
    *,
    near: bool = True,
) -> Solution:
    """Fit a model with `effects` to whole train runs from `values`, and from `start` where it is known.

    Where windows leave little, the values there are `near` the optimum. Else the fit goes over a growing horizon, and
    stops early while the model stays far off: polishing it would only make its parameters absurd.
    """
    free, train = candidate_set.free(effects), candidate_set.train
    neutral = candidate_set.problem.values()
    known = {name: (values[name] if name in free else neutral[name]) for name in candidate_set.problem.names}
    known = {name: candidate_set.off_zero(name, value) if name in free else value for name, value in known.items()}
    if near:
        solution = candidate_set.problem.fit(known, free, train, start, crawl=CRAWL, most=30)
        if solution.misfit < candidate_set.criteria.far_misfit:
            return _to_the_end(candidate_set, solution)
    first = candidate_set.problem.fit(known, free, train, until=4.0, enough=1.0, weak_prior=True, most=6)
    rough = candidate_set.problem.fit(first.values, free, train, first.start, enough=1.0, weak_prior=True, most=4)
    for other in (known, neutral):
        if np.isfinite(rough.misfit):
            break
        # With the values that follow the first seconds best, a whole run may leave the range of numbers.
        rough = candidate_set.problem.fit(other, free, train, start, enough=1.0, weak_prior=True, most=4)
    if not rough.misfit < candidate_set.criteria.far_misfit:
        return rough
    solution = candidate_set.problem.fit(rough.values, free, train, rough.start, crawl=CRAWL, most=30)
    return _to_the_end(candidate_set, solution)


def _to_the_end(candidate_set: CandidateSet, solution: Solution) -> Solution:
    """`solution` fitted on until it converges, where whole runs begin in motion: their first velocities and the tyre
    trade off along a curved valley, in which 30 steps end far from the optimum."""
    train = candidate_set.train
    free_velocities = np.asarray(candidate_set.problem.batch.free_start)[train, 3:]
    if len(train) > MANY or not free_velocities.any():
        return solution
    return continue_to_convergence(candidate_set.problem, solution, train)


def no_worse(candidate_set: CandidateSet, before: CandidateFit, effects: Sequence[str], refitted: Solution) -> Solution:
    """The fit with `effects`, which hold those of `before`: as it was `refitted`, or from where that step ended.

    There the new effects are neutral, or nearly so where they have no slope, and a fit only goes downhill.
    """
    if refitted.misfit <= before.solution.misfit:
        return refitted
    free, probes = candidate_set.free(effects), candidate_set.probes()
    close = {name: NEARER * probes[name] for name in free if name in probes and before.solution.values[name] == 0.0}
    values, start = before.solution.values | close, before.solution.start
    return best_of(refitted, candidate_set.problem.fit(values, free, candidate_set.train, start, crawl=CRAWL, most=30))


def is_worse(then: Solution, now: Solution, criteria: SelectionCriteria = CRITERIA) -> bool:
    """Whether a fit has failed: `then` holds all that the model of `now` has, and leaves more than that, beyond what a
    fit may stop short of.
    """
    rise = then.samples * (then.misfit - now.misfit)
    return not rise <= criteria.refit_tolerance + criteria.refit_tolerance_share * now.samples * now.misfit
