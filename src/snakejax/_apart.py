"""Telling effects apart: how surely runs say which of two candidates acts, from what each changes in them.

All of it is linear about a fit. With columns c_k of what a step of parameter k changes, in standard deviations of the
noise and with the start poses projected out, runs add up in the matrix G = sum C^T C. The tyre, which the fit does not
know either, is eliminated from it: S = G_EE - G_Et G_tt^-1 G_tE, E the parameters of both effects.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._units import Scalar

SURE, UNSURE = 0.95, 0.7
"""The share of right answers that is enough, and that of the given runs at the strength a design is made for."""
MOST_REPEATS = 50
_DRAWS = 40_000
_RIDGE = 1e-9


class Pair(NamedTuple):
    """Two effects among K parameters: `first` and `second`, the places of theirs; `tyre`, those of what a fit frees;
    `sizes` (K,), the strength of each effect's parameters at which they are to be told apart; `low` (K,) and `high`
    (K,), how far each parameter may be from where it is.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    tyre: tuple[int, ...]
    sizes: Float[np.ndarray, " K"]
    low: Float[np.ndarray, " K"]
    high: Float[np.ndarray, " K"]


def without_tyre(G, effects: Sequence[int], tyre: Sequence[int], xp=np):
    """S: the information on `effects` when the `tyre` is estimated too; `xp` is NumPy or jax.numpy."""
    e, t = list(effects), list(tyre)
    S = G[np.ix_(e, e)]
    if not t:
        return S
    inner, across = G[np.ix_(t, t)], G[np.ix_(t, e)]
    inner = inner + _RIDGE * xp.diag(xp.diag(inner))
    return S - across.T @ xp.linalg.solve(inner, across)


def gap(S, first: int, sizes, low, high, xp=np):
    """By how much chi^2 rises, at least, where the first effect acts at `sizes` and the second is fitted instead.

    The least of a^T S_aa a - 2 b^T S_ba a + b^T S_bb b over b, the parameters of the first effect the leading `first`
    of S; a single b keeps to its domain, `low` to `high`: what only its other sign could imitate, it cannot.
    """
    a = sizes[:first]
    own, pull, other = a @ S[:first, :first] @ a, S[first:, :first] @ a, S[first:, first:]
    b = xp.linalg.solve(other + _RIDGE * xp.diag(xp.diag(other)), pull)
    b = xp.clip(b, low, high) if b.shape == (1,) else b
    return own - 2 * b @ pull + b @ other @ b


def both_gaps(G, pair: Pair, xp=np):
    """`gap` with the first effect acting, and with the second."""
    found = []
    for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
        S = without_tyre(G, (*one, *other), pair.tyre, xp)
        mine, theirs = np.array(one), np.array(other)
        sizes, low, high = xp.asarray(pair.sizes)[mine], xp.asarray(pair.low)[theirs], xp.asarray(pair.high)[theirs]
        found.append(gap(S, len(one), sizes, low, high, xp))
    return found


def certainty(G: Float[np.ndarray, "K K"], pair: Pair, seed: int = 0) -> float:
    """The probability that the effect that acts is the one that lowers chi^2 more, each acting in half of the cases.

    From draws of the noise: with y = S a + noise of covariance S, each effect lowers chi^2 by the most of
    2 b^T y - b^T S b over its own parameters b, which keep to their domains.
    """
    rng = np.random.default_rng(seed)
    right = []
    for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
        both = (*one, *other)
        S = without_tyre(G, both, pair.tyre)
        values, vectors = np.linalg.eigh(S)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        mean = S[:, : len(one)] @ pair.sizes[list(one)]
        y = mean + rng.standard_normal((_DRAWS, len(both))) @ root.T
        split = len(one)
        mine = _fall(S[:split, :split], y[:, :split], pair, one) - 2 * len(one)
        theirs = _fall(S[split:, split:], y[:, split:], pair, other) - 2 * len(other)
        # Where neither lowers chi^2, as where both would need the wrong sign, the answer is a guess.
        right.append(float(np.mean(mine > theirs) + np.mean(mine == theirs) / 2))
    return float(np.mean(right))


def _fall(S, y: np.ndarray, pair: Pair, places: Sequence[int]) -> np.ndarray:
    if len(places) == 1:
        k = places[0]
        size = max(float(S[0, 0]), 1e-300)
        b = np.clip(y[:, 0] / size, pair.low[k], pair.high[k])
        return 2 * b * y[:, 0] - b**2 * size
    return np.einsum("nk,kl,nl->n", y, np.linalg.pinv(S, hermitian=True), y)


def strength(G: Float[np.ndarray, "K K"], pair: Pair, share: float) -> float:
    """The factor on the sizes of a pair at which the share of right answers is `share`; infinite where none is."""

    def sure(factor: float) -> bool:
        return certainty(G, pair._replace(sizes=factor * pair.sizes)) >= share

    low, high = 1e-3, 1e-3
    while not sure(high):
        low, high = high, high * 4
        if high > 1e7:
            return np.inf
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if sure(middle) else (middle, high)
    return float(high)


def repeats(given: np.ndarray, run: np.ndarray, pair: Pair) -> int | None:
    """How many repeats of a run, beside the given ones, make the answer `SURE`; None where `MOST_REPEATS` do not."""
    if certainty(given, pair) >= SURE:
        return 0
    low, high = 0, 1
    while certainty(given + high * run, pair) < SURE:
        low, high = high, 2 * high
        if low >= MOST_REPEATS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if certainty(given + middle * run, pair) >= SURE else (middle, high)
    return high


def information(
    poses: Float[Array, "M n 3"], steps: Float[Array, " K"], weight: Float[Array, " 3"]
) -> Float[Array, "K K"]:
    """G of one run: `poses` of the board as fitted, then with each of K parameters moved by `steps`.

    `weight`: one over the noise of a sample. The start is where the run begins: moving it shifts all poses, or turns
    them about it.
    """
    base = poses[0]
    moved = jnp.moveaxis((poses[1:] - base[None]) / steps[:, None, None] * weight[None, None], 0, -1)
    x, y = base[:, 0] - base[0, 0], base[:, 1] - base[0, 1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    starts = [(one, zero, zero), (zero, one, zero), (-y, x, one)]
    nuisance = jnp.stack([jnp.stack(part, axis=1) * weight[None] for part in starts], axis=-1)
    columns, nuisance = moved.reshape(-1, moved.shape[-1]), nuisance.reshape(-1, 3)
    within = nuisance.T @ columns
    return columns.T @ columns - within.T @ jnp.linalg.solve(nuisance.T @ nuisance, within)


def loss(G: Float[Array, "K K"], pair: Pair) -> Scalar:
    """What a design makes small: minus the logarithm of the gaps, of which the smaller counts more."""
    first, second = both_gaps(G, pair, jnp)
    return jnp.log(1 / first + 1 / second)
