"""Residuals whose errors belong together, made independent: the noise of the cameras, and what a noisy joint log does
to a simulation.

A run whose weighted residual has the covariance 1 + D D^T, with D (N, q) the weighted wander, is whitened by its root:
with D = U s V^T that is W = 1 - K K^T, K = U (1 - 1 / sqrt(1 + s^2))^(1/2), and K is all that is kept.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

FELT = 0.02
"""Wander of less variance than this, in units of the cameras' noise, is left."""


def whitening(
    wanders: Sequence[Float[Array, "_ 3 _"] | None], weight: Float[np.ndarray, "R n 3"]
) -> Float[Array, "R n 3 q"] | None:
    """K for each run, from its wander [m, rad] and one over the noise of its samples; None where no run wanders."""
    if all(wander is None for wander in wanders):
        return None
    kept = []
    for wander, scale in zip(wanders, weight, strict=True):
        if wander is None:
            kept.append(np.zeros((scale.size, 0)))
            continue
        D = np.zeros((*scale.shape, wander.shape[-1]))
        D[: wander.shape[0]] = np.asarray(wander)
        U, s, _ = np.linalg.svd((D * scale[..., None]).reshape(scale.size, -1), full_matrices=False)
        felt = s**2 > FELT
        kept.append(U[:, felt] * np.sqrt(1 - 1 / np.sqrt(1 + s[felt] ** 2)))
    most = max(part.shape[1] for part in kept)
    K = [np.pad(part, ((0, 0), (0, most - part.shape[1]))) for part in kept]
    return jnp.asarray(np.array(K).reshape(*weight.shape, most))


def whitened(residual: Float[Array, "n 3"], K: Float[Array, "n 3 q"] | None) -> Float[Array, "n 3"]:
    """W r = r - K K^T r."""
    return residual if K is None else residual - jnp.einsum("ncq,q->nc", K, jnp.einsum("ncq,nc->q", K, residual))


def coloured(residual: Float[np.ndarray, "n 3"], K: Float[Array, "n 3 q"] | None) -> Float[np.ndarray, "n 3"]:
    """The weighted residual r behind W r: W^-1 = 1 + K (1 - K^T K)^-1 K^T, with K^T K diagonal."""
    if K is None:
        return residual
    columns = np.asarray(K, float)
    amount = np.einsum("ncq,nc->q", columns, residual) / (1 - np.square(columns).sum(axis=(0, 1)))
    return residual + columns @ amount
