"""Whole runs predicted from their start: what parameters, random force and cameras make uncertain.

With M the deviation of the state from where the segments were linearised (its first column) and the sensitivity of that
deviation to the parameters (the others),

    M_(k+1) = A_k M_k + [F_k - z_(k+1) | B_k]       and      P_(k+1) = A_k P_k A_k^T + Q

carry both through a run that no measurement corrects. The force has mean zero; its variance is in P.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .kalman import Discrepancy, SegmentData
from .segment_dynamics import FORCE
from .segmented_runs import LENGTH


class OpenLoop(NamedTuple):
    """Runs predicted from their start: `columns` (R, K, n, 3, 1 + k), measured less predicted pose [m, m, rad], then
    the derivatives of the prediction by the k parameters; `variance` (R, K, n, 3) of random force and cameras;
    `present` (R, K, n, 3): 1 where a pose was measured."""

    columns: Float[np.ndarray, "R K n 3 k1"]
    variance: Float[np.ndarray, "R K n 3"]
    present: Float[np.ndarray, "R K n 3"]

    def predicted(
        self, step: Float[np.ndarray, "R k"] | None = None, covariance: np.ndarray | None = None
    ) -> tuple[Float[np.ndarray, "R N 3"], Float[np.ndarray, "R N 3"]]:
        """Measured less predicted pose of all samples in their order [m, m, rad], NaN where none was measured, and the
        standard deviation of each.

        The prediction is that after a `step` (R, k) of the parameters, one for each run, whose errors have the
        `covariance` (k, k) or (R, k, k).
        """
        derivatives = self.columns[..., 1:]
        residual, variance = self.columns[..., 0], self.variance
        if step is not None:
            residual = residual - np.einsum("rkncp,rp->rknc", derivatives, step)
        if covariance is not None:
            each = np.broadcast_to(covariance, (len(residual), *np.shape(covariance)[-2:]))
            variance = variance + np.einsum("rkncp,rpq,rkncq->rknc", derivatives, each, derivatives)
        flat = (len(residual), -1, residual.shape[-1])
        return np.where(self.present > 0, residual, np.nan).reshape(flat), np.sqrt(variance).reshape(flat)

    @property
    def rms_sd(self) -> Float[np.ndarray, "R 3"]:
        """Root mean square standard deviation of x, y and heading in each run."""
        total = (self.present * self.variance).sum(axis=(1, 2))
        return np.sqrt(total / np.maximum(self.present.sum(axis=(1, 2)), 1))


def open_loop(data: SegmentData, discrepancy: Discrepancy, free: Sequence[int] = ()) -> OpenLoop:
    """The runs of `data` from their start states on, with derivatives by the parameters numbered `free`."""
    data = data.keeping(np.asarray(free, int))
    R, K, _, _, nz = data.state.shape
    force_variance = np.concatenate([np.zeros(nz - FORCE), discrepancy.force**2])
    decay = np.exp(-LENGTH / discrepancy.force_time)
    innovation = (1 - decay**2) * np.diag(force_variance)
    columns, variance = np.zeros(data.columns.shape), np.zeros(data.present.shape)
    noise = discrepancy.white**2 + discrepancy.wander**2
    M = np.zeros((R, nz, 1 + len(free)))
    M[:, nz - FORCE :, 0] = -data.force[:, 0]
    P = np.tile(np.diag(force_variance), (R, 1, 1))
    for k in range(K):
        if k:
            F = data.transition[:, k].copy()
            F[:, nz - FORCE :, :] = 0.0
            F[:, range(nz - FORCE, nz), range(nz - FORCE, nz)] = decay
            M = F @ M + data.shift[:, k]
            M[:, nz - FORCE :, 0] = -data.force[:, k]
            P = F @ P @ F.transpose(0, 2, 1) + innovation
        S = data.state[:, k]
        columns[:, k] = data.columns[:, k] - np.einsum("rnci,rip->rncp", S, M)
        variance[:, k] = np.einsum("rnci,rij,rncj->rnc", S, P, S) + noise
    return OpenLoop(columns, variance, data.present)
