"""Sweeps: what many boards do under one gait, as arrays with named axes."""

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._gait import Gait
from ._lanes import ACCURACY, simulate_many
from ._model import Model
from ._pieces import Columns, Executor, fingerprint, in_pieces, length, local
from ._tyre import Bakker
from ._units import parameters, with_parameters

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]


def silent(done: int, total: int) -> None:
    """Nobody wants to know."""


class Axes(NamedTuple):
    """The boards of a sweep, V in all: `columns`, the value (V,) of each parameter that is moved; `shape`, how they
    are laid out along the axes `dims`; `coordinates`, the values along them: name -> (axis, values), in the order of
    the columns they stand for.
    """

    columns: dict[str, np.ndarray]
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coordinates: dict[str, tuple[str, np.ndarray]]

    def moving(self, name: str, values: Sequence[float] | np.ndarray) -> "Axes":
        """These boards, a further parameter of which follows along: `values` (V,)."""
        return self._replace(columns=self.columns | {name: np.asarray(values, np.float64)})

    def laid_out(self, found: np.ndarray) -> np.ndarray:
        """What was found of each board (V, ...), along the axes."""
        return found.reshape(*self.shape, *found.shape[1:])


def grid(values: Mapping[str, Sequence[float] | np.ndarray]) -> Axes:
    """Every combination of the `values` of some parameters, one axis each, in the order given."""
    lines = {name: np.asarray(line, np.float64).reshape(-1) for name, line in values.items()}
    meshes = np.meshgrid(*lines.values(), indexing="ij")
    columns = {name: mesh.reshape(-1) for name, mesh in zip(lines, meshes, strict=True)}
    shape = tuple(line.size for line in lines.values())
    return Axes(columns, tuple(lines), shape, {name: (name, line) for name, line in lines.items()})


def table(columns: Mapping[str, Sequence[float] | np.ndarray]) -> Axes:
    """A board for each row of a table with one column for each parameter; the axis is called `row`.

    **Raises:** `ValueError` for columns of unlike length.
    """
    lines = {name: np.asarray(line, np.float64).reshape(-1) for name, line in columns.items()}
    if len({line.size for line in lines.values()}) > 1:
        lengths = ", ".join(f"{name} {line.size}" for name, line in lines.items())
        raise ValueError(f"The columns of a table must be of one length, but they have: {lengths}.")
    count = len(next(iter(lines.values()), ()))
    return Axes(lines, ("row",), (count,), {name: ("row", line) for name, line in lines.items()})


def require_possible(model: Model, axes: Axes) -> None:
    """**Raises:** `ValueError` where there are no boards, or a value is outside the domain of its parameter."""
    if not axes.columns or not np.prod(axes.shape):
        raise ValueError("There is nothing to vary: name at least one parameter and one value.")
    for name, column in axes.columns.items():
        for end in (column.min(), column.max(), *column[~np.isfinite(column)][:1]):
            with_parameters(model, {name: float(end)})
    if isinstance(model.tyre, Bakker):
        tyre = boards(model, axes.columns).tyre
        for name, part in parameters(tyre).items():
            for value in np.asarray(part.value):
                if why := part.domain.complaint(float(value)):
                    where = "its load and camber are beyond Bakker's formulas"
                    raise ValueError(f"A tyre would have {name} = {float(value):.3g}, which {why}: {where}.")


def possible(model: Model, over: Axes | Mapping[str, Sequence[float]]) -> Axes:
    """The axes of `over`, which `model` can have. **Raises:** as `require_possible`."""
    axes = over if isinstance(over, Axes) else grid(over)
    require_possible(model, axes)
    return axes


def boards(model: Model, columns: Columns) -> Model:
    """`model` with the parameters in `columns` (V,), as one model whose arrays have a leading axis V."""
    count = length(columns)
    many = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), model)
    many = with_parameters(many, {name: jnp.asarray(column) for name, column in columns.items()})
    if isinstance(many.tyre, Bakker):
        # Its formulas once for each board, and not at every step.
        tyre = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), many.tyre.coefficients())
        many = eqx.tree_at(lambda m: m.tyre, many, tyre)
    return many


def _poses(model: Model, gait: Gait, times: np.ndarray, start: Sequence[float], columns: Columns) -> Columns:
    return {"pose": simulate_many(boards(model, columns), gait, times, start, accuracy=ACCURACY, workers=1)}


class How(TypedDict, total=False):
    """How a sweep is done.

    `start`: the pose (x [m], y [m], heading [rad]) where every board is at rest at time 0 (default the origin).
    `folder`: where results are kept piece by piece: killed half-way, the same call goes on from there, and what it
    finds is the same to the last bit. `executor`: who computes, the cores of this machine (default) or a
    `cluster(...)`. `progress` is told how many boards are done, of how many.
    """

    start: tuple[float, float, float]
    folder: Path | str | None
    executor: Executor
    progress: Progress


def sweep(
    model: Model,
    gait: Gait,
    times: Float[Array, " n"],
    over: Axes | Mapping[str, Sequence[float]],
    **how: Unpack[How],
) -> "xarray.Dataset":
    """What `model` does under `gait`, with any of its parameters varied.

    **Arguments:** `times` [s] (n,), increasing. `over`: values of parameters by dotted name (`tyre.D`,
    `effects.ground_slope.sx`), every combination of them; or `table(...)`. `how`, see `How`.

    **Returns:** `x`, `y` [m] and `heading` [rad] along the axes and `time`; infinite for a board whose simulation
    needs too many steps.

    **Raises:** `ValueError` for a parameter the model does not have, or a value outside its domain.
    """
    import xarray

    axes = possible(model, over)
    pose = axes.laid_out(found_of(_poses, model, gait, times, axes, how)["pose"])
    channels = (("x", "m"), ("y", "m"), ("heading", "rad"))
    data = {name: ((*axes.dims, "time"), pose[..., k], {"units": unit}) for k, (name, unit) in enumerate(channels)}
    return xarray.Dataset(
        data, {**coordinates(model, axes), "time": ("time", np.asarray(times, np.float64), {"units": "s"})}
    )


def coordinates(model: Model, axes: Axes) -> dict[str, Any]:
    """The coordinates of a dataset over `axes`, with the units of the parameters they stand for."""
    known = parameters(model)
    named = zip(axes.coordinates.items(), axes.columns, strict=False)
    return {name: (dim, line, {"units": known[column].domain.unit}) for (name, (dim, line)), column in named}


def found_of(
    work: Callable[..., Columns], model: Model, gait: Gait, times: Float[Array, " n"], axes: Axes, how: How
) -> dict[str, np.ndarray]:
    """`work(model, gait, times, start, columns)` on every board of `axes`; each sweep keeps to a folder of its own."""
    # NumPy arrays can be sent to a process where JAX has not yet started.
    given = (model, gait, np.asarray(times, np.float64), how.get("start", (0.0, 0.0, 0.0)))
    given = jax.tree.map(np.asarray, given)
    place, folder = None, how.get("folder")
    if folder is not None:
        place = Path(folder) / fingerprint(work.__qualname__, given, axes.columns)[:16]
    rest = {"executor": how.get("executor", local), "progress": how.get("progress", silent)}
    return in_pieces(functools.partial(work, *given), axes.columns, folder=place, **rest)
