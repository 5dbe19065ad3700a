"""From the samples of a history to the knots of a free force."""

from typing import NamedTuple

import numpy as np

from ..latent_force.piecewise_force import SPACING


def hats_at(time: np.ndarray, first: float, count: int) -> np.ndarray:
    """The hat functions (n, `count`) of knots from `first` on at the sample times `time` (n,)."""
    return np.maximum(1 - np.abs((time[:, None] - first) / SPACING - np.arange(count)), 0.0)


class KnotFit(NamedTuple):
    """The knots of hat functions that fit a history best in n samples: `projection` (W, K, n)."""

    projection: np.ndarray

    @staticmethod
    def of(hats: np.ndarray) -> "KnotFit":
        """The least squares onto `hats` (W, n, K)."""
        turned = hats.swapaxes(1, 2)
        # A hat that no sample touches stays at zero.
        return KnotFit(np.linalg.solve(turned @ hats + 1e-6 * np.eye(hats.shape[2]), turned))

    @property
    def knots(self) -> int:
        """Knots of a window."""
        return self.projection.shape[1]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The knots (G, W, K) of a history that has the `values` (G, W, n) at the samples."""
        return (values.swapaxes(0, 1) @ self.projection.swapaxes(1, 2)).swapaxes(0, 1)


class KnotMeans(NamedTuple):
    """Knots that are the means of a history over K parts of n / K samples each; `inside` (W, K): 0 for a part after the
    end of a window."""

    inside: np.ndarray

    @property
    def knots(self) -> int:
        """Knots of a window."""
        return self.inside.shape[1]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The knots (G, W, K) of a history that has the `values` (G, W, n) at the samples."""
        return values.reshape(*values.shape[:2], self.knots, -1).mean(axis=-1) * self.inside
