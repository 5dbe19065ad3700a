"""The predictive check: are held-out runs what the fitted model with its discrepancy lets one expect?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.estimation.discrepancy.kalman import Discrepancy, gram_matrices, moved_states, segment_data, smooth
from snakejax.estimation.discrepancy.least_squares import Optimum
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.goodness_of_fit import NOISE_SIGMAS
from snakejax.recording.run import Run

from .search import Search


class PredictiveCheck(NamedTuple):
    """`misfit`: chi^2 a sample of held-out runs against noise and random force, 1 where the model is right; `highest`:
    the upper end of what is expected."""

    misfit: float
    highest: float

    @property
    def passed(self) -> bool:
        """Whether the held-out runs are as expected."""
        return self.misfit <= self.highest


def predictive_check(
    search: Search, runs: Sequence[Run], values: np.ndarray, best: Optimum, discrepancy: Discrepancy
) -> PredictiveCheck | None:
    """The check of `runs` under the parameters `values`, uncertain as `best` says; None if there is no run.

    With the innovations r of the filter and their derivatives D by the parameters, of covariance C,
    chi^2 = r^T (1 + D C D^T)^-1 r.
    """
    if not runs:
        return None
    segments = Segments(search.model.model, runs, search.model.names)
    z = segments.with_steady_memories(values, segments.guess())
    data = segment_data(segments.cut, segments.linearise(values, z), z)
    z = moved_states(segments.cut, z, smooth(data, discrepancy, np.zeros(len(values))))
    data = segment_data(segments.cut, segments.linearise(values, z), z)
    gram, _ = gram_matrices(data, discrepancy)
    total, rows = gram.sum(axis=0), np.array(best.free, int) + 1
    right = total[rows, 0]
    normal = total[np.ix_(rows, rows)] + np.linalg.inv(best.covariance)
    chi2 = total[0, 0] - right @ np.linalg.solve(normal, right)
    samples = int(data.present.sum())
    return PredictiveCheck(float(chi2 / samples), 1.0 + NOISE_SIGMAS * float(np.sqrt(2.0 / samples)))
