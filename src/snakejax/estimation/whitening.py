"""Whitening of residuals whose errors are correlated, because a noisy joint log disturbs the simulated run.

The weighted residual of such a run has the covariance I + D D^T: camera noise plus D (N, q), the weighted `wander`
(root of the covariance due to log noise). With the singular values D = U s V^T, the whitening matrix is
W = (I + D D^T)^(-1/2) = I - K K^T with K = U (1 - 1 / sqrt(1 + s^2))^(1/2). Only K is stored.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

FELT = 0.02
"""Directions of the wander with a variance s^2 below this, in units of the camera noise variance, are neglected."""


def whitening(
    wanders: Sequence[Float[Array, "_ 3 _"] | None], weight: Float[np.ndarray, "R n 3"]
) -> Float[Array, "R n 3 q"] | None:
    """The matrix K of each run, from its `wander` [m, m, rad] and its weights (1 / noise); None if no run has one."""
    if all(wander is None for wander in wanders):
        return None
    roots = []
    for wander, scale in zip(wanders, weight, strict=True):
        if wander is None:
            roots.append(np.zeros((scale.size, 0)))
            continue
        D = np.zeros((*scale.shape, wander.shape[-1]))
        D[: wander.shape[0]] = np.asarray(wander)
        U, s, _ = np.linalg.svd((D * scale[..., None]).reshape(scale.size, -1), full_matrices=False)
        significant = s**2 > FELT
        roots.append(U[:, significant] * np.sqrt(1 - 1 / np.sqrt(1 + s[significant] ** 2)))
    columns = max(root.shape[1] for root in roots)
    K = [np.pad(root, ((0, 0), (0, columns - root.shape[1]))) for root in roots]
    return jnp.asarray(np.array(K).reshape(*weight.shape, columns))


def whitened(residual: Float[Array, "n 3"], K: Float[Array, "n 3 q"] | None) -> Float[Array, "n 3"]:
    """The whitened residual W r = r - K K^T r; r itself where K is None."""
    return residual if K is None else residual - jnp.einsum("ncq,q->nc", K, jnp.einsum("ncq,nc->q", K, residual))


def coloured(residual: Float[np.ndarray, "n 3"], K: Float[Array, "n 3 q"] | None) -> Float[np.ndarray, "n 3"]:
    """The weighted residual r from the whitened W r: W^-1 = I + K (I - K^T K)^-1 K^T, where K^T K is diagonal."""
    if K is None:
        return residual
    columns = np.asarray(K, float)
    amount = np.einsum("ncq,nc->q", columns, residual) / (1 - np.square(columns).sum(axis=(0, 1)))
    return residual + columns @ amount
