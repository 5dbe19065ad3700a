"""Residuals of several runs, linearised: the few rows of them that a step of least squares needs."""

from functools import cached_property
from typing import Any, Self

import numpy as np
from jaxtyping import Float


class LinearResiduals:
    """Residuals r of R runs, linearised at a point z of K parameters and S components of the start of each run.

    `residual` (R, m); `jacobian` (R, m, K + S) by the parameters and by the start of the run; `prior_residual` (K,) and
    `strength` (K,): residuals of a prior and their derivative, each by its own parameter; `detail`: what else is known
    at this point. z is in the order parameters, start of the first run, of the second, ...
    """

    def __init__(
        self,
        residual: Float[np.ndarray, "R m"],
        jacobian: Float[np.ndarray, "R m K+S"],
        prior_residual: Float[np.ndarray, " K"],
        strength: Float[np.ndarray, " K"],
        detail: Any = None,
    ) -> None:
        self.residual, self.jacobian = residual, jacobian
        self.prior_residual, self.strength, self.detail = prior_residual, strength, detail

    @cached_property
    def is_finite(self) -> bool:
        """Whether all residuals and derivatives are finite."""
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.jacobian).all())

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Basis (R, m, k) and triangle (R, k, K + S + 1) of the QR decomposition of [J r], run by run."""
        return np.linalg.qr(np.concatenate([self.jacobian, self.residual[..., None]], axis=-1))

    @cached_property
    def rows(self) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M N"]]:
        """A residual and a Jacobian of the same norm, gradient and curvature, in far fewer rows.

        The residual is infinite where a number is not finite.
        """
        runs, width = len(self.residual), len(self.strength)
        own = self.jacobian.shape[-1] - width
        below = np.eye(width, width + runs * own) * self.strength[:, None]
        if self.is_finite:
            triangle = self._factors[1]
        else:
            count = min(self.residual.shape[1], width + own + 1)
            triangle = np.zeros((runs, count, width + own + 1))
            triangle[..., -1] = np.inf
        wide = np.zeros((*triangle.shape[:2], width + runs * own))
        wide[..., :width] = triangle[..., :width]
        for k in range(runs):
            wide[k, :, width + k * own : width + (k + 1) * own] = triangle[k, :, width:-1]
        residual = np.concatenate([triangle[..., -1].ravel(), self.prior_residual])
        return residual, np.concatenate([wide.reshape(-1, width + runs * own), below])

    def beyond(self, step: Float[np.ndarray, " N"], then: Self) -> Float[np.ndarray, "R m"]:
        """2 (r(z + d) - r(z) - J d) after the `step` d, with the residuals `then`: the second derivative along d, but
        for terms of the third order."""
        width = len(self.strength)
        own = step[width:].reshape(len(self.residual), -1)
        along = np.einsum("rmk,k->rm", self.jacobian[..., :width], step[:width])
        along += np.einsum("rms,rs->rm", self.jacobian[..., width:], own)
        return 2 * (then.residual - self.residual - along)

    def in_rows(self, vector: Float[np.ndarray, "R m"]) -> Float[np.ndarray, " M"]:
        """What of a `vector` of all residuals lies in the `rows`; a prior has no part in it."""
        within = np.einsum("rmk,rm->rk", self._factors[0], vector)
        return np.concatenate([within.ravel(), np.zeros(len(self.strength))])
