"""The Rayleigh board that comes nearest to each board of a sweep, and its coefficient as a polynomial."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ._effect import Floor, Grip, Memory
from ._gait import Gait
from ._lanes import ACCURACY, simulate_many
from ._model import Model
from ._pieces import Columns
from ._recording import CHANNELS
from ._skid import Ideal
from ._sweep import Axes, How, boards, coordinates, found_of, possible
from ._tyre import Rayleigh
from ._units import parameters

if TYPE_CHECKING:
    import xarray

COARSE = np.geomspace(1e-2, 1e4, 49)
"""The Rayleigh coefficients k_s [N s/m] from which the search starts; beyond its ends a board slides, or is ideal."""
BETWEEN = 8
FINE = np.geomspace(COARSE[0], COARSE[-1], (len(COARSE) - 1) * BETWEEN + 1)
"""Those among which it goes on, around the best of `COARSE`; steps of 3.7 %."""
AROUND = 3
"""The polynomial between them goes through so many on either side."""
FOLLOWS = 0.1
"""A Rayleigh board follows another where the rms distance of their paths is below this share of the path."""
ORDER = 4
GROUPS = 16
"""Sets of Rayleigh boards that are held in memory at a time."""


def rayleigh(model: Model, k_s: float) -> Model:
    """`model` with a Rayleigh tyre, less the effects that need another."""
    alien = [n for n, e in model.effects.items() if isinstance(e, Floor | Grip | Memory)]
    return Model(model.board, Rayleigh(k_s), model.skid, model.without(*alien).effects)


def nearest_rayleigh(
    model: Model,
    gait: Gait,
    times: Float[Array, " n"],
    over: Axes | Mapping[str, Sequence[float]],
    **how: Unpack[How],
) -> "xarray.Dataset":
    """For each board of a sweep the Rayleigh board nearest to it: least rms distance of (x, y) over `times`.

    The search takes the best of 49 k_s, simulates 17 around it, and finds the least of the polynomial of order 6
    through the squared distances of the best seven, by golden sections (optimistix).

    **Arguments:** as `sweep`. **Returns:** along the axes `k_s` [N s/m], NaN where none fits: where the mismatch is
    above `FOLLOWS`, or the best is at an end of the grid; `mismatch`, the rms distance of the two paths over the path
    length of the first; `best`, the k_s of that distance in any case; `path` [m]; and `x`, `y`, `heading` at the end,
    infinite for a board whose own simulation needs too many steps, of which all else is NaN.
    **Raises:** `ValueError` as `sweep`, and for a model that is itself a Rayleigh or an ideal board.

    Source: Salman et al., CDC 2016, Figs. 5 to 8.
    """
    import xarray

    if isinstance(model.tyre, Rayleigh) or isinstance(model.skid, Ideal):
        raise ValueError("A Rayleigh or ideal board needs no other to come near it: vary those of a Pacejka board.")
    axes = possible(model, over)
    columns = found_of(_nearest, model, gait, times, axes, how)
    found = {name: axes.laid_out(column) for name, column in columns.items()}
    units = {"k_s": "N s/m", "best": "N s/m", "mismatch": "1", "path": "m", "x": "m", "y": "m", "heading": "rad"}
    data = {name: (axes.dims, found[name], {"units": unit}) for name, unit in units.items()}
    return xarray.Dataset(data, coordinates(model, axes))


def _nearest(model: Model, gait: Gait, times: np.ndarray, start: Sequence[float], columns: Columns) -> Columns:
    def simulated(models: Model) -> np.ndarray:
        return simulate_many(models, gait, times, start, accuracy=ACCURACY, workers=1)

    pose = simulated(boards(model, columns))
    paths = pose[..., :2]
    finished = np.isfinite(pose).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(axis=1)
    twin = rayleigh(model, 1.0)
    felt = {name: column for name, column in columns.items() if name in parameters(twin)}

    def trial(lanes: Sequence[int], numbers: Sequence[int]) -> np.ndarray:
        """Paths of the Rayleigh twins of `lanes` with k_s from `FINE`."""
        moved = {name: column[list(lanes)] for name, column in felt.items()}
        twins = boards(twin, {"tyre.k_s": FINE[list(numbers)], **moved})
        return simulated(twins)[..., :2]

    # Where only the tyre is varied, one row of Rayleigh boards serves all.
    everyone = np.arange(len(paths))
    groups = [everyone] if not felt else list(everyone[:, None])
    best, square = np.full(len(paths), np.nan), np.full(len(paths), np.inf)
    for first in range(0, len(groups), GROUPS):
        _search(trial, groups[first : first + GROUPS], paths, best, square)
    best, square, length = (np.where(finished & np.isfinite(square), part, np.nan) for part in (best, square, length))
    mismatch = np.sqrt(square) / np.where(length > 0, length, np.nan)
    inside = (best > COARSE[0]) & (best < COARSE[-1])
    with np.errstate(invalid="ignore"):
        fits = inside & (mismatch < FOLLOWS)
    end = {name: pose[:, -1, k] for k, name in enumerate(CHANNELS)}
    return {"k_s": np.where(fits, best, np.nan), "best": best, "mismatch": mismatch, "path": length, **end}


def _search(trial, groups: Sequence[np.ndarray], paths: np.ndarray, best: np.ndarray, square: np.ndarray) -> None:
    """Write k_s and mean squared distance [m^2] of the nearest Rayleigh board of each lane into `best` and `square`.

    The lanes of a group share their Rayleigh boards, which are those of its first lane.
    """
    coarse = range(0, len(FINE), BETWEEN)
    tried = _tried(trial, groups, {(g, k) for g in range(len(groups)) for k in coarse})
    near: dict[int, tuple[int, list[int]]] = {}
    for g, lanes in enumerate(groups):
        rough = np.stack([tried[g, k] for k in coarse])
        for lane in lanes:
            middle = int(np.argmin(_away(rough, paths[lane]))) * BETWEEN
            around = range(middle - BETWEEN, middle + BETWEEN + 1)
            near[int(lane)] = (g, [k for k in around if 0 <= k < len(FINE)])
    tried = _tried(trial, groups, {(g, k) for g, ks in near.values() for k in ks})
    stencils: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for lane, (g, ks) in near.items():
        squares = _away(np.stack([tried[g, k] for k in ks]), paths[lane])
        middle = int(np.argmin(squares))
        best[lane], square[lane] = FINE[ks[middle]], squares[middle]
        if 0 < ks[middle] < len(FINE) - 1 and np.isfinite(squares).all():
            first = int(np.clip(middle - AROUND, 0, len(ks) - 2 * AROUND - 1))
            stencil = slice(first, first + 2 * AROUND + 1)
            stencils[lane] = (np.log(FINE[ks[stencil]]), squares[stencil])
    if stencils:
        nodes, heights = (np.stack(part) for part in zip(*stencils.values(), strict=True))
        places, least = _least(jnp.asarray(nodes), jnp.asarray(heights))
        best[list(stencils)], square[list(stencils)] = np.exp(places), least


def _tried(trial, groups: Sequence[np.ndarray], wanted: set[tuple[int, int]]) -> dict[tuple[int, int], np.ndarray]:
    """The path of each wanted (group, number in `FINE`). Boards of like k_s step together: stiff ones delay others."""
    pairs = sorted(wanted, key=lambda pair: pair[::-1])
    return dict(zip(pairs, trial([groups[g][0] for g, _ in pairs], [k for _, k in pairs]), strict=True))


def _away(tried: Float[np.ndarray, "k n 2"], path: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " k"]:
    """Mean squared distance [m^2] of each path from `path`; infinite where one of them is not finite."""
    with np.errstate(invalid="ignore"):
        away = ((tried - path) ** 2).sum(axis=-1).mean(axis=-1)
    return np.where(np.isfinite(away), away, np.inf)


@jax.jit
def _least(nodes: Float[Array, "V m"], heights: Float[Array, "V m"]) -> tuple[Array, Array]:
    """Where the polynomial through (nodes, heights) is least between the outermost nodes, and its value there."""
    solver = optx.GoldenSearch(rtol=0.0, atol=1e-9)

    def one(x, y):
        span = x[-1] - x[0]
        scaled, scale = (x - x[0]) / span, jnp.max(y)
        coefficients = jnp.linalg.solve(jnp.vander(2 * scaled - 1), y / scale)

        def height(place, _):
            return jnp.polyval(coefficients, 2 * place - 1)

        ends = {"lower": 0.0, "upper": 1.0}
        place = optx.minimise(height, solver, jnp.asarray(0.5), options=ends, max_steps=80, throw=False).value
        return x[0] + span * place, jnp.maximum(height(place, None), 0.0) * scale

    return jax.vmap(one)(nodes, heights)


class Polynomial(NamedTuple):
    """k_s as a polynomial of one parameter: `coefficients`, highest order first, over `fitted_range`.

    `r_squared` is None where k_s does not change.
    """

    coefficients: tuple[float, ...]
    r_squared: float | None
    fitted_range: tuple[float, float]

    def __call__(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """k_s [N s/m] at `values`."""
        return np.polyval(self.coefficients, values)


def polynomial(values: Float[np.ndarray, " V"], k_s: Float[np.ndarray, " V"]) -> Polynomial | None:
    """The polynomial of order 4 through `k_s` over the longest stretch of `values`, which ascend, that have one.

    None where this stretch has fewer than 6 values. Source: paper, Fig. 8.
    """
    known = np.isfinite(k_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    stretches = list(zip(edges[::2], edges[1::2], strict=True))
    first, last = max(stretches, key=lambda s: s[1] - s[0], default=(0, 0))
    if last - first < ORDER + 2:
        return None
    x, y = values[first:last], k_s[first:last]
    fitted = np.polynomial.Polynomial.fit(x, y, ORDER)
    spread = float(((y - y.mean()) ** 2).sum())
    constant = spread <= y.size * (1e-9 * np.abs(y).max()) ** 2
    r_squared = None if constant else 1.0 - float(((y - fitted(x)) ** 2).sum()) / spread
    coefficients = tuple(float(c) for c in fitted.convert().coef[::-1])
    coefficients = (0.0,) * (ORDER + 1 - len(coefficients)) + coefficients
    return Polynomial(coefficients, r_squared, (float(x[0]), float(x[-1])))
