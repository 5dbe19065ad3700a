"""Sweeps: many boards under one gait, and the Rayleigh board that comes nearest to each."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ._effect import Floor, Grip, Memory
from ._gait import Gait
from ._model import Model
from ._simulate import Accuracy, simulate
from ._tyre import Rayleigh

ACCURACY = Accuracy(rtol=1e-7, atol=1e-9, derivative="forward")
GRID = np.geomspace(1e-2, 1e4, 49)
"""The Rayleigh coefficients k_s [N s/m] from which the search starts; beyond its ends a board slides, or is ideal."""
FOLLOWS = 0.1
"""A Rayleigh board follows another where the rms distance of their paths is below this share of the path."""
ORDER = 4


class Sweep(NamedTuple):
    """Boards `values` (V,) of one parameter, and the k_s (V,) [N s/m] of the nearest Rayleigh board, NaN where none is.

    `mismatch` (V,): rms distance of the two paths over the path length of the first. `polynomial`: coefficients of
    k_s as a polynomial of order 4 in the parameter, highest first, over `fitted_range`, the longest stretch of values
    that have a k_s; with `r_squared`. All three are None where this stretch has fewer than `ORDER` + 2 values.
    """

    values: np.ndarray
    k_s: np.ndarray
    mismatch: np.ndarray
    polynomial: tuple[float, ...] | None
    r_squared: float | None
    fitted_range: tuple[float, float] | None


def stacked(models: Sequence[Model]) -> Model:
    """Models of one structure as one whose arrays have a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *models)


@eqx.filter_jit
def simulated(models: Model, gait: Gait, times: Float[Array, " n"]) -> Float[Array, "V n 3"]:
    """Poses of stacked `models` that start at rest at the origin; infinite where the solver gives up."""
    return jax.lax.map(lambda model: simulate(model, gait, times, accuracy=ACCURACY, throw=False).pose, models)


def rayleigh(model: Model, k_s: float) -> Model:
    """`model` with a Rayleigh tyre, less the effects that need another."""
    alien = [n for n, e in model.effects.items() if isinstance(e, Floor | Grip | Memory)]
    return Model(model.board, Rayleigh(k_s), model.skid, model.without(*alien).effects)


def nearest_rayleigh(models: Sequence[Model], values: Sequence[float], gait: Gait, times: Float[Array, " n"]) -> Sweep:
    """For each of `models` the Rayleigh board nearest to it: least rms distance of (x, y) over time.

    The search takes the best of a grid of k_s and refines it by golden sections of ln k_s (optimistix): where the two
    paths stay apart, least squares would converge slowly. No k_s is given where the mismatch is above `FOLLOWS`, or
    the best is at an end of the grid.

    Source: Salman et al., CDC 2016, Figs. 5 to 8.
    """
    paths = simulated(stacked(models), gait, times)[..., :2]
    length = jnp.sum(jnp.linalg.norm(jnp.diff(paths, axis=1), axis=-1), axis=1)
    boards = [rayleigh(model, 1.0) for model in models]
    # Where only the tyre is varied, one row of Rayleigh boards serves all.
    rows = models[:1] if all(bool(eqx.tree_equal(boards[0], board)) for board in boards) else models
    trial = jnp.stack([simulated(stacked([rayleigh(m, k) for k in GRID]), gait, times)[..., :2] for m in rows])
    distance = jnp.sqrt(jnp.mean(jnp.sum((trial - paths[:, None]) ** 2, axis=-1), axis=-1))
    first = np.asarray(jnp.argmin(jnp.where(jnp.isfinite(distance), distance, jnp.inf), axis=1))
    k_s, rms = _refined(stacked(boards), paths, jnp.log(jnp.asarray(GRID[first])), gait, times)
    mismatch = np.asarray(rms / length)
    inside = (first > 0) & (first < len(GRID) - 1)
    found = np.where(inside & (mismatch < FOLLOWS), np.asarray(k_s), np.nan)
    return _summed_up(np.asarray(values, float), found, mismatch)


@eqx.filter_jit
def _refined(models: Model, paths: Array, start: Array, gait: Gait, times: Array) -> tuple[Array, Array]:
    """(k_s, rms distance [m]) of each lane, the least between the neighbours on the grid of ln k_s = `start`."""
    solver = optx.GoldenSearch(rtol=0.0, atol=1e-5)
    step = float(np.log(GRID[1] / GRID[0]))

    def one(lane):
        model, path, begin = lane

        def distance(above, _):
            there = eqx.tree_at(lambda m: m.tyre.k_s, model, jnp.exp(begin - step + above))
            pose = simulate(there, gait, times, accuracy=ACCURACY, throw=False).pose[:, :2]
            return jnp.sqrt(jnp.mean(jnp.sum((pose - path) ** 2, axis=-1)))

        # optimistix places its first point rightly only where the interval begins at zero.
        ends = {"lower": 0.0, "upper": 2 * step}
        found = optx.minimise(distance, solver, jnp.asarray(step), options=ends, max_steps=60, throw=False).value
        return jnp.exp(begin - step + found), distance(found, None)

    return jax.lax.map(one, (models, paths, start))


def _summed_up(values: np.ndarray, k_s: np.ndarray, mismatch: np.ndarray) -> Sweep:
    known = np.isfinite(k_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    stretches = list(zip(edges[::2], edges[1::2], strict=True))
    first, last = max(stretches, key=lambda s: s[1] - s[0], default=(0, 0))
    if last - first < ORDER + 2:
        return Sweep(values, k_s, mismatch, None, None, None)
    x, y = values[first:last], k_s[first:last]
    polynomial = np.polynomial.Polynomial.fit(x, y, ORDER)
    spread = float(((y - y.mean()) ** 2).sum())
    r_squared = 1.0 - float(((y - polynomial(x)) ** 2).sum()) / spread if spread > 0 else None
    coefficients = tuple(float(c) for c in polynomial.convert().coef[::-1])
    coefficients = (0.0,) * (ORDER + 1 - len(coefficients)) + coefficients
    return Sweep(values, k_s, mismatch, coefficients, r_squared, (float(x[0]), float(x[-1])))
