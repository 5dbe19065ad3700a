"""The predictive check: are held-out runs what the fitted model with its discrepancy lets one expect?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.estimation.discrepancy.kalman import (
    Discrepancy,
    SegmentData,
    deviance,
    gram_matrices,
    moved_states,
    segment_data,
    smooth,
)
from snakejax.estimation.discrepancy.least_squares import Optimum
from snakejax.estimation.discrepancy.open_loop import open_loop
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.goodness_of_fit import NOISE_SIGMAS
from snakejax.recording.run import Run

from ..explanation import RunBand, run_bands
from .search import Search
from .subsets import Subsets


class PredictiveCheck(NamedTuple):
    """`misfit`: chi^2 a sample of held-out runs against noise and random force, 1 where the model is right; `highest`:
    the upper end of what is expected."""

    misfit: float
    highest: float

    @property
    def passed(self) -> bool:
        """Whether the held-out runs are as expected."""
        return self.misfit <= self.highest


START_ROUNDS = 2
"""Corrections of the start states of simulated runs. Poses are nearly linear in them."""


def smoothed_segments(search: Search, runs: Sequence[Run], values: np.ndarray, discrepancy: Discrepancy) -> SegmentData:
    """The segments of `runs` under the parameters `values`, linearised at their smoothed states."""
    segments = Segments(search.model.model, runs, search.model.names)
    z = segments.with_steady_memories(values, segments.guess())
    z = _smoothed(segments, values, z, discrepancy)
    return segment_data(segments.cut, segments.linearise(values, z), z)


def simulated_segments(
    search: Search, runs: Sequence[Run], values: np.ndarray, discrepancy: Discrepancy
) -> SegmentData:
    """The segments of `runs` under the parameters `values`, linearised along simulations of whole runs from fitted
    start states.

    Where no force acts beside the model, a state has only its run's start to differ by. Smoothed states of all segments
    at once, of which each must then end in the next, need not converge.
    """
    segments = Segments(search.model.model, runs, search.model.names)
    z = segments.rolled_out(values, segments.with_steady_memories(values, segments.guess()))
    for _ in range(START_ROUNDS):
        z = segments.rolled_out(values, _smoothed(segments, values, z, discrepancy))
    return segment_data(segments.cut, segments.linearise(values, z), z)


def likelier_segments(search: Search, runs: Sequence[Run], values: np.ndarray, discrepancy: Discrepancy) -> SegmentData:
    """The segments of `runs` at smoothed states or along simulations, as the runs are likelier under `discrepancy`.

    Where a random force acts, a simulation leaves the recording; where it is weak, smoothed states need not converge.
    **Raises:** `FitError` where neither is finite.
    """
    both = (linearised(search, runs, values, discrepancy) for linearised in (smoothed_segments, simulated_segments))
    finite = [data for data in both if np.isfinite(data.columns).all()]
    if not finite:
        raise FitError("A simulation of a held-out run is not finite.")
    return min(finite, key=lambda data: deviance(data, discrepancy))


def _smoothed(segments: Segments, values: np.ndarray, z: np.ndarray, discrepancy: Discrepancy) -> np.ndarray:
    data = segment_data(segments.cut, segments.linearise(values, z), z)
    return moved_states(segments.cut, z, smooth(data, discrepancy, np.zeros(len(values))))


def predictive_check(data: SegmentData, best: Optimum, discrepancy: Discrepancy) -> PredictiveCheck:
    """The check of runs whose segments are `data`, under parameters as uncertain as `best` says.

    With the innovations r of the filter and their derivatives D by the parameters, of covariance C,
    chi^2 = r^T (1 + D C D^T)^-1 r.
    """
    gram, _ = gram_matrices(data, discrepancy)
    total, rows = gram.sum(axis=0), np.array(best.free, int) + 1
    right = total[rows, 0]
    normal = total[np.ix_(rows, rows)] + np.linalg.inv(best.covariance)
    chi2 = total[0, 0] - right @ np.linalg.solve(normal, right)
    samples = int(data.present.sum())
    return PredictiveCheck(float(chi2 / samples), 1.0 + NOISE_SIGMAS * float(np.sqrt(2.0 / samples)))


def bands(runs: Sequence[Run], data: SegmentData, best: Optimum, discrepancy: Discrepancy) -> tuple[RunBand, ...]:
    """How well bands of 95%, predicted from the start of each run, hold what was measured."""
    return run_bands(runs, *open_loop(data, discrepancy, best.free).predicted(covariance=best.covariance))


def left_out_bands(
    runs: Sequence[Run], data: SegmentData, problem: Subsets, gram: np.ndarray, effects: Sequence[str], discrepancy
) -> tuple[RunBand, ...]:
    """The same for train runs, each predicted with the parameters of the others; a single run predicts itself.

    `gram` (R, P + 1, P + 1): the Gram matrices of the runs, of which `problem` is the sum.
    """
    free = problem.with_effects(effects).free
    others = [problem.gram - one for one in gram] if len(gram) > 1 else [problem.gram]
    fits = [problem.with_effects(effects, other) for other in others]
    covariance = np.zeros((len(gram), len(free), len(free)))
    for k, fit in enumerate(fits):
        # What ends on a bound without the run is known as well as that bound.
        place = [free.index(column) for column in fit.free if column in free]
        kept = [fit.free.index(column) for column in fit.free if column in free]
        covariance[k][np.ix_(place, place)] = fit.covariance[np.ix_(kept, kept)]
    steps = np.array([fit.step[list(free)] for fit in fits])
    return run_bands(runs, *open_loop(data, discrepancy, free).predicted(steps, covariance))
