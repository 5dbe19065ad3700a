"""The random force along the recorded runs, as its most likely history: what is missing beside the effects."""

import numpy as np

from snakejax.estimation.discrepancy.kalman import moved_states, smoothed
from snakejax.estimation.discrepancy.segment_dynamics import FORCE

from ..latent_force.missing_force import LatentForce, RunForce
from .search import Point, Search

ROUNDS = 2
"""Linearisations of the states at which the force is estimated."""


def random_force(search: Search, point: Point, switched: bool) -> LatentForce:
    """The force of each run near `point`, with its parameters and its discrepancy, without variables or laws; the
    standard deviations are those with the parameters known. `switched`: see `LatentForce`.

    A force is constant over a segment, and stands at its middle.
    **Raises:** `FitError` where the simulation is not finite.
    """
    segments, none = search.segments, np.zeros(len(point.values))
    cut, sd = segments.cut, np.zeros(0)
    for _ in range(ROUNDS):
        deviation, sd = smoothed(search.data(point), point.discrepancy, none)
        point = point._replace(z=moved_states(cut, point.z, deviation))
    ratio, forces = segments.force_ratio(point.values), []
    for number, run in enumerate(segments.runs):
        own = cut.run == number
        times = (cut.times[own, 0] + cut.times[own, -1]) / 2
        error = sd[number, : own.sum(), -FORCE:] * ratio
        forces.append(RunForce(run.name, times, point.z[own, -FORCE:] * ratio, error))
    return LatentForce(tuple(forces), (), None, None, {}, switched)
