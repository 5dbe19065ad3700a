"""Discrimination of two effects: the probability that runs select the right one (Atkinson and Fedorov 1975).

All is linear about a fit. C has a column for each parameter: the change of the residuals [standard deviations of the
noise] by a unit step, with the start poses projected out. The information of several runs is the sum G = sum C^T C.
The tyre parameters t are estimated as well and eliminated by the Schur complement S = G_EE - G_Et G_tt^-1 G_tE, with E
the parameters of both effects.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar

SURE, UNSURE = 0.95, 0.7
"""Probability of correct selection that suffices, and that of the given runs at the strength a design is made for."""
MOST_REPEATS = 50
"""Largest number of repeats of a run that is considered."""
_DRAWS = 40_000
"""Samples of the noise: the standard error of a probability is below 0.0025."""
_RIDGE = 1e-9
"""Relative ridge on the diagonal of matrices that may be singular."""


class EffectPair(NamedTuple):
    """Two effects among K parameters.

    `first`, `second`: indices of their parameters; `tyre`: indices of the parameters that a fit frees; `sizes` (K,):
    values of the parameters of each effect at which the effects are to be distinguished; `low`, `high` (K,): bounds of
    the change of each parameter from its present value.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    tyre: tuple[int, ...]
    sizes: Float[np.ndarray, " K"]
    low: Float[np.ndarray, " K"]
    high: Float[np.ndarray, " K"]


def marginal_information(G, effects: Sequence[int], tyre: Sequence[int], xp=np):
    """Information S on `effects` if the `tyre` is estimated too: Schur complement of G; `xp` is NumPy or jax.numpy."""
    e, t = list(effects), list(tyre)
    S = G[np.ix_(e, e)]
    if not t:
        return S
    tyre_block, cross_block = G[np.ix_(t, t)], G[np.ix_(t, e)]
    tyre_block = tyre_block + _RIDGE * xp.diag(xp.diag(tyre_block))
    return S - cross_block.T @ xp.linalg.solve(tyre_block, cross_block)


def noncentrality(S, first: int, sizes, low, high, xp=np):
    """The noncentrality: rise of chi^2 if the first effect acts at `sizes` and the second is fitted instead.

    It is the minimum over b of a^T S_aa a - 2 b^T S_ba a + b^T S_bb b, where the first `first` rows of S belong to a,
    the parameters of the acting effect. A single b is limited to its domain, `low` to `high`.
    """
    a = sizes[:first]
    acting, cross, other = a @ S[:first, :first] @ a, S[first:, :first] @ a, S[first:, first:]
    b = xp.linalg.solve(other + _RIDGE * xp.diag(xp.diag(other)), cross)
    b = xp.clip(b, low, high) if b.shape == (1,) else b
    return acting - 2 * b @ cross + b @ other @ b


def noncentralities(G, pair: EffectPair, xp=np):
    """The `noncentrality` if the first effect acts, and if the second acts."""
    values = []
    for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
        S = marginal_information(G, (*one, *other), pair.tyre, xp)
        acting_index, other_index = np.array(one), np.array(other)
        sizes, low, high = (
            xp.asarray(pair.sizes)[acting_index],
            xp.asarray(pair.low)[other_index],
            xp.asarray(pair.high)[other_index],
        )
        values.append(noncentrality(S, len(one), sizes, low, high, xp))
    return values


def correct_selection_probability(G: Float[np.ndarray, "K K"], pair: EffectPair, seed: int = 0) -> float:
    """The probability that the acting effect has the lower AIC, if each effect acts in half of the cases.

    From samples of the noise: with y = S a + noise of covariance S, an effect with q parameters b lowers AIC by
    max_b (2 b^T y - b^T S b) - 2 q, with a single b limited to its domain.
    """
    rng = np.random.default_rng(seed)
    probabilities = []
    for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
        both = (*one, *other)
        S = marginal_information(G, both, pair.tyre)
        values, vectors = np.linalg.eigh(S)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        mean = S[:, : len(one)] @ pair.sizes[list(one)]
        y = mean + rng.standard_normal((_DRAWS, len(both))) @ root.T
        split = len(one)
        acting_gain = _fall(S[:split, :split], y[:, :split], pair, one) - 2 * len(one)
        other_gain = _fall(S[split:, split:], y[:, split:], pair, other) - 2 * len(other)
        # A tie, as where both would need the wrong sign, counts as a guess.
        probabilities.append(float(np.mean(acting_gain > other_gain) + np.mean(acting_gain == other_gain) / 2))
    return float(np.mean(probabilities))


def _fall(S, y: np.ndarray, pair: EffectPair, places: Sequence[int]) -> np.ndarray:
    if len(places) == 1:
        k = places[0]
        size = max(float(S[0, 0]), 1e-300)
        b = np.clip(y[:, 0] / size, pair.low[k], pair.high[k])
        return 2 * b * y[:, 0] - b**2 * size
    return np.einsum("nk,kl,nl->n", y, np.linalg.pinv(S, hermitian=True), y)


def scale_for_probability(G: Float[np.ndarray, "K K"], pair: EffectPair, share: float) -> float:
    """The factor on the sizes of a pair at which `correct_selection_probability` is `share`; infinite above 1e7."""

    def sufficient(factor: float) -> bool:
        return correct_selection_probability(G, pair._replace(sizes=factor * pair.sizes)) >= share

    low, high = 1e-3, 1e-3
    while not sufficient(high):
        low, high = high, high * 4
        if high > 1e7:
            return np.inf
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if sufficient(middle) else (middle, high)
    return float(high)


def repeats_needed(given: np.ndarray, run: np.ndarray, pair: EffectPair) -> int | None:
    """The number of repeats of a `run`, added to the `given` information, that reaches `SURE`; None if more than
    `MOST_REPEATS` are needed."""
    if correct_selection_probability(given, pair) >= SURE:
        return 0
    low, high = 0, 1
    while correct_selection_probability(given + high * run, pair) < SURE:
        low, high = high, 2 * high
        if low >= MOST_REPEATS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (
            (low, middle) if correct_selection_probability(given + middle * run, pair) >= SURE else (middle, high)
        )
    return high


def information(
    poses: Float[Array, "M n 3"], steps: Float[Array, " K"], weight: Float[Array, " 3"]
) -> Float[Array, "K K"]:
    """Information G of one run by finite differences, with the start pose eliminated.

    **Arguments:** `poses`: of the fitted model, then with each of K parameters moved by `steps`; `weight`: 1 / standard
    deviation of the noise of a sample. A change of the start pose shifts all poses or turns them about the start.
    """
    base = poses[0]
    moved = jnp.moveaxis((poses[1:] - base[None]) / steps[:, None, None] * weight[None, None], 0, -1)
    x, y = base[:, 0] - base[0, 0], base[:, 1] - base[0, 1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    starts = [(one, zero, zero), (zero, one, zero), (-y, x, one)]
    nuisance = jnp.stack([jnp.stack(part, axis=1) * weight[None] for part in starts], axis=-1)
    flat_columns, nuisance = moved.reshape(-1, moved.shape[-1]), nuisance.reshape(-1, 3)
    projection = nuisance.T @ flat_columns
    return flat_columns.T @ flat_columns - projection.T @ jnp.linalg.solve(nuisance.T @ nuisance, projection)


def criterion(G: Float[Array, "K K"], pair: EffectPair) -> Scalar:
    """The design criterion to minimise: ln(1 / g_1 + 1 / g_2) of both noncentralities; the smaller one dominates."""
    first, second = noncentralities(G, pair, jnp)
    return jnp.log(1 / first + 1 / second)
