"""Least squares on a Gram matrix: any subset of the parameters free, the others where they belong, within priors."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Prior(NamedTuple):
    """Independent normal priors of a step of the parameters: `mean` (P,) and `precision` (P,), 1 / variance."""

    mean: Float[np.ndarray, " P"]
    precision: Float[np.ndarray, " P"]

    def chi2(self, step: Float[np.ndarray, " P"], some: Sequence[int] | np.ndarray) -> float:
        """The part in chi^2 of the `step` of the parameters numbered `some`."""
        return float((self.precision[some] * (step[some] - self.mean[some]) ** 2).sum())


class Optimum(NamedTuple):
    """`chi2`, the prior's part in it; the `step` (P,) of all parameters; `covariance` (k, k) of those in `free`."""

    chi2: float
    step: np.ndarray
    covariance: np.ndarray
    free: tuple[int, ...]

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation (P,) of the step of each parameter; zero where it is not free."""
        sd = np.zeros(len(self.step))
        sd[list(self.free)] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return sd

    @property
    def distance(self) -> float:
        """The length of the step in standard deviations: sqrt(d^T covariance^-1 d) (Mahalanobis distance)."""
        step = self.step[list(self.free)]
        return float(np.sqrt(max(step @ np.linalg.solve(self.covariance, step), 0.0)))


def scaled_inverse(normal: np.ndarray) -> np.ndarray:
    """The inverse of a positive definite matrix, scaled to a unit diagonal for its digits."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)


def optimum(
    gram: Float[np.ndarray, "P1 P1"],
    free: Sequence[int],
    prior: Prior,
    fixed: Float[np.ndarray, " P"],
    low: Float[np.ndarray, " P"],
    high: Float[np.ndarray, " P"],
) -> Optimum:
    """The parameters numbered `free` that minimise chi^2 = |r - D d|^2 + sum of precision (d - mean)^2.

    The other parameters make the step `fixed`. A free one whose step ends outside `low` to `high` is held at the bound
    (active set).
    """
    loose, step = list(free), np.array(fixed)
    while True:
        rest = np.array(step)
        rest[loose] = 0.0
        weights = np.concatenate([[1.0], -rest])
        left = gram @ weights
        rows = np.array(loose, int) + 1
        normal = gram[np.ix_(rows, rows)] + np.diag(prior.precision[loose])
        right = left[rows] + (prior.precision * prior.mean)[loose]
        inverse = scaled_inverse(normal) if loose else np.zeros((0, 0))
        move = inverse @ right
        excess = np.maximum(low[loose] - move, move - high[loose])
        beyond = np.flatnonzero(excess > 0)
        if not beyond.size:
            step[loose] = move
            chi2 = weights @ left - right @ move + (prior.precision * prior.mean**2)[loose].sum()
            held = [column for column in free if column not in loose]
            chi2 += prior.chi2(step, held)
            return Optimum(float(chi2), step, inverse, tuple(loose))
        sd = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
        worst = max(beyond, key=lambda k: excess[k] / sd[k])
        column = loose.pop(worst)
        step[column] = low[column] if move[worst] < low[column] else high[column]


def quadratic(gram: Float[np.ndarray, "P1 P1"], step: Float[np.ndarray, " P"]) -> float:
    """chi^2 after the `step`: |r - D d|^2."""
    weights = np.concatenate([[1.0], -step])
    return float(weights @ gram @ weights)
