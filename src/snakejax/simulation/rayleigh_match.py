"""Rayleigh match: the viscous model nearest to each member of a sweep, and its coefficient as a polynomial."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from snakejax.core.parameter import parameters
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.observation import CHANNELS
from snakejax.dynamics.ports import LateralForce, TyreModifier, TyreState
from snakejax.dynamics.tyres import Rayleigh

from .chunks import Columns
from .ensemble import Engine, engine_sentence
from .parameter_sweep import Axes, SweepOptions, coordinates, evaluate, members_of, models_on, require_axes

if TYPE_CHECKING:
    import xarray


COARSE = np.geomspace(1e-2, 1e4, 49)
"""Rayleigh coefficients k_s [N s/m] of the coarse search; below them a board slides freely, above them it is ideal."""
BETWEEN = 8
"""Intervals of `FINE` in one of `COARSE`."""
FINE = np.geomspace(COARSE[0], COARSE[-1], (len(COARSE) - 1) * BETWEEN + 1)
"""Coefficients of the fine search around the best of `COARSE`; steps of 3.7 %."""
AROUND = 3
"""Nodes of the interpolating polynomial on either side of the best of `FINE`."""
FOLLOWS = 0.1
"""Two boards match if the root mean square distance of their paths is below this fraction of the path length."""
ORDER = 4
"""Order of the polynomial of k_s (Salman et al. 2016, Fig. 8)."""
FEWEST = ORDER + 2
"""Consecutive values with a k_s that the polynomial needs."""
GROUPS = 16
"""Sets of Rayleigh boards that are held in memory at a time."""


def rayleigh(model: Model, k_s: float) -> Model:
    """`model` with a Rayleigh tyre of coefficient `k_s` [N s/m], without the effects that need another tyre."""
    alien = [n for n, e in model.effects.items() if isinstance(e, TyreModifier | LateralForce | TyreState)]
    return Model(model.board, Rayleigh(k_s), model.constraint, model.without(*alien).effects)


def nearest_rayleigh(
    model: Model,
    gait: AbstractInputs,
    times: Float[Array, " n"],
    over: Axes | Mapping[str, Sequence[float]],
    **how: Unpack[SweepOptions],
) -> "xarray.Dataset":
    """For each member of a sweep find the Rayleigh model with the least rms distance of (x, y) over `times`.

    The search takes the best of 49 k_s, simulates 17 values around it, and minimises the polynomial of order 6 through
    the squared distances of the seven nearest by golden section search (optimistix).

    **Arguments:** as `sweep`. **Returns:** along the axes `k_s` [N s/m], NaN without a match, that is, where the
    mismatch is above `FOLLOWS` or the best is at an end of the grid; `mismatch` [-], the rms distance of the two paths
    over the path length of the member; `best` [N s/m], the k_s of least distance in any case; `path` [m]; `x`, `y`,
    `heading` at the end, infinite for a member whose own simulation needs too many steps (all else is then NaN).
    **Raises:** `ValueError` as `sweep`, and for a model that is itself a Rayleigh or an ideal board.

    Source: Salman et al., CDC 2016, Figs. 5 to 8.
    """
    import xarray

    if isinstance(model.tyre, Rayleigh) or not model.constraint.slips:
        raise ValueError(
            "The nearest Rayleigh board is found for Pacejka boards only: vary a parameter of a Pacejka board."
        )
    axes = require_axes(model, over)
    columns = evaluate(_nearest, model, gait, times, axes, how)
    engine = {"engine": engine_sentence(columns.pop("refusal"))}
    results = {name: axes.effective_vehicle(column) for name, column in columns.items()}
    units = {"k_s": "N s/m", "best": "N s/m", "mismatch": "1", "path": "m", "x": "m", "y": "m", "heading": "rad"}
    data = {name: (axes.dims, results[name], {"units": unit}) for name, unit in units.items()}
    return xarray.Dataset(data, coordinates(model, axes), engine)


def _nearest(
    model: Model, gait: AbstractInputs, times: np.ndarray, start: Sequence[float], engine: Engine, columns: Columns
) -> Columns:
    pose, refusals = members_of(models_on(model, columns), gait, times, start, engine)
    paths = pose[..., :2]
    finished = np.isfinite(pose).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(axis=1)
    template = rayleigh(model, 1.0)
    varied_columns = {name: column for name, column in columns.items() if name in parameters(template)}

    def trial(members: Sequence[int], indices: Sequence[int]) -> np.ndarray:
        """Paths (k, n, 2) of the Rayleigh models of `members` with k_s from `FINE`."""
        varied = {name: column[list(members)] for name, column in varied_columns.items()}
        twins = models_on(template, {"tyre.k_s": FINE[list(indices)], **varied})
        return members_of(twins, gait, times, start, engine).poses[..., :2]

    # If only the tyre is varied, all members share one set of Rayleigh models.
    all_members = np.arange(len(paths))
    groups = [all_members] if not varied_columns else list(all_members[:, None])
    best, square = np.full(len(paths), np.nan), np.full(len(paths), np.inf)
    for first in range(0, len(groups), GROUPS):
        _search(trial, groups[first : first + GROUPS], paths, best, square)
    best, square, length = (np.where(finished & np.isfinite(square), part, np.nan) for part in (best, square, length))
    mismatch = np.sqrt(square) / np.where(length > 0, length, np.nan)
    inside = (best > COARSE[0]) & (best < COARSE[-1])
    with np.errstate(invalid="ignore"):
        fits = inside & (mismatch < FOLLOWS)
    end = {name: pose[:, -1, k] for k, name in enumerate(CHANNELS)}
    return {
        "k_s": np.where(fits, best, np.nan),
        "best": best,
        "mismatch": mismatch,
        "path": length,
        **end,
        "refusal": refusals,
    }


def _search(trial, groups: Sequence[np.ndarray], paths: np.ndarray, best: np.ndarray, square: np.ndarray) -> None:
    """Write k_s and mean squared distance [m^2] of the nearest Rayleigh model of each member into `best` and `square`.

    The members of a group share their Rayleigh models, which are those of its first member.
    """
    coarse = range(0, len(FINE), BETWEEN)
    paths_by_pair = _tried(trial, groups, {(g, k) for g in range(len(groups)) for k in coarse})
    neighbours: dict[int, tuple[int, list[int]]] = {}
    for g, members in enumerate(groups):
        coarse_paths = np.stack([paths_by_pair[g, k] for k in coarse])
        for member in members:
            middle = int(np.argmin(_away(coarse_paths, paths[member]))) * BETWEEN
            candidates = range(middle - BETWEEN, middle + BETWEEN + 1)
            neighbours[int(member)] = (g, [k for k in candidates if 0 <= k < len(FINE)])
    paths_by_pair = _tried(trial, groups, {(g, k) for g, ks in neighbours.values() for k in ks})
    stencils: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for member, (g, ks) in neighbours.items():
        squares = _away(np.stack([paths_by_pair[g, k] for k in ks]), paths[member])
        middle = int(np.argmin(squares))
        best[member], square[member] = FINE[ks[middle]], squares[middle]
        if 0 < ks[middle] < len(FINE) - 1 and np.isfinite(squares).all():
            first = int(np.clip(middle - AROUND, 0, len(ks) - 2 * AROUND - 1))
            stencil = slice(first, first + 2 * AROUND + 1)
            stencils[member] = (np.log(FINE[ks[stencil]]), squares[stencil])
    if stencils:
        nodes, squares_at_nodes = (np.stack(part) for part in zip(*stencils.values(), strict=True))
        log_k_s, minima = _least(jnp.asarray(nodes), jnp.asarray(squares_at_nodes))
        best[list(stencils)], square[list(stencils)] = np.exp(log_k_s), minima


def _tried(trial, groups: Sequence[np.ndarray], requested: set[tuple[int, int]]) -> dict[tuple[int, int], np.ndarray]:
    """The path of each requested (group, index in `FINE`), sorted by k_s: a stiff member delays others of its block."""
    pairs = sorted(requested, key=lambda pair: pair[::-1])
    return dict(zip(pairs, trial([groups[g][0] for g, _ in pairs], [k for _, k in pairs]), strict=True))


def _away(paths: Float[np.ndarray, "k n 2"], path: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " k"]:
    """Mean squared distance (k,) [m^2] of each path from `path`; infinite if a path is not finite."""
    with np.errstate(invalid="ignore"):
        square = ((paths - path) ** 2).sum(axis=-1).mean(axis=-1)
    return np.where(np.isfinite(square), square, np.inf)


@jax.jit
def _least(nodes: Float[Array, "V m"], heights: Float[Array, "V m"]) -> tuple[Array, Array]:
    """Minimiser (V,) and minimum (V,) of the polynomial through (nodes, heights) between the outermost nodes."""
    solver = optx.GoldenSearch(rtol=0.0, atol=1e-9)

    def minimise(x, y):
        span = x[-1] - x[0]
        scaled, scale = (x - x[0]) / span, jnp.max(y)
        coefficients = jnp.linalg.solve(jnp.vander(2 * scaled - 1), y / scale)

        def value(position, _):
            return jnp.polyval(coefficients, 2 * position - 1)

        ends = {"lower": 0.0, "upper": 1.0}
        position = optx.minimise(value, solver, jnp.asarray(0.5), options=ends, max_steps=80, throw=False).value
        return x[0] + span * position, jnp.maximum(value(position, None), 0.0) * scale

    return jax.vmap(minimise)(nodes, heights)


class Polynomial(NamedTuple):
    """k_s as a polynomial of one parameter: `coefficients`, highest order first, valid over `fitted_range`.

    `r_squared` is None if k_s is constant.
    """

    coefficients: tuple[float, ...]
    r_squared: float | None
    fitted_range: tuple[float, float]

    def __call__(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """k_s [N s/m] at `values`."""
        return np.polyval(self.coefficients, values)


def polynomial(values: Float[np.ndarray, " V"], k_s: Float[np.ndarray, " V"]) -> Polynomial | None:
    """Fit a polynomial of order 4 to `k_s` over the longest interval of ascending `values` with finite k_s.

    None if this interval has fewer than 6 values. Source: Salman et al., CDC 2016, Fig. 8.
    """
    known = np.isfinite(k_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    intervals = list(zip(edges[::2], edges[1::2], strict=True))
    first, last = max(intervals, key=lambda s: s[1] - s[0], default=(0, 0))
    if last - first < FEWEST:
        return None
    x, y = values[first:last], k_s[first:last]
    fitted = np.polynomial.Polynomial.fit(x, y, ORDER)
    variation = float(((y - y.mean()) ** 2).sum())
    constant = variation <= y.size * (1e-9 * np.abs(y).max()) ** 2
    r_squared = None if constant else 1.0 - float(((y - fitted(x)) ** 2).sum()) / variation
    coefficients = tuple(float(c) for c in fitted.convert().coef[::-1])
    coefficients = (0.0,) * (ORDER + 1 - len(coefficients)) + coefficients
    return Polynomial(coefficients, r_squared, (float(x[0]), float(x[-1])))
