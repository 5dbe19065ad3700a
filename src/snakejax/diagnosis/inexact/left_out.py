"""What effects are worth on runs left out: each train run predicted with parameters from the others."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.estimation.discrepancy.kalman import gram_matrices
from snakejax.estimation.discrepancy.least_squares import quadratic

from .search import Linear, Search
from .subsets import left_out_errors


class Gain(NamedTuple):
    """By how much an effect lowers the squared error of each run left out, `by_run` (R,), in units of the noise.

    `share`: of the squared error without any effect.
    """

    by_run: Float[np.ndarray, " R"]
    share: float

    @property
    def predicts(self) -> bool:
        """Whether the gain is above its standard error, or there is one in every run: the standard error of a few runs
        counts how unlike they are, and alone would refuse the strongest effect."""
        gained = self.by_run
        error = np.sqrt(len(gained)) * gained.std(ddof=1) if len(gained) > 1 else 0.0
        return bool(gained.sum() > error or (gained > 0).all())


class LeftOut(NamedTuple):
    """Whole runs predicted from the others: the problem is `linear`, and `judged` (R, P + 1, P + 1) are the Gram
    matrices of whole runs without any force beside the model."""

    linear: Linear
    judged: np.ndarray
    samples: int

    def error(self, effects: Iterable[str]) -> np.ndarray:
        """The squared error (R,) of each run with `effects`, in units of the noise."""
        if len(self.judged) < 2:  # a single run judges itself
            step = self.linear.subsets.with_effects(effects).step
            return np.array([quadratic(gram, step) for gram in self.judged])
        return left_out_errors(self.linear.subsets, self.linear.gram, self.judged, effects)

    def gain(self, effects: Iterable[str], effect: str) -> Gain:
        """What `effect` is worth beside the others of `effects`."""
        rest = [other for other in effects if other != effect]
        fall = self.error(rest) - self.error([*rest, effect])
        return Gain(fall, float(fall.sum() / self.error([]).sum()))

    def explained_share(self, effects: Iterable[str]) -> float:
        """The share of the squared error that all `effects` take away."""
        return float(1.0 - self.error(effects).sum() / self.error([]).sum())


def left_out(search: Search, linear: Linear) -> LeftOut:
    """Runs left out of the problem `linear`."""
    alone = linear.point.discrepancy.without_force(search.scales.least_force)
    judged, _ = gram_matrices(linear.data, alone)
    return LeftOut(linear, judged, int(linear.data.present.sum()))
