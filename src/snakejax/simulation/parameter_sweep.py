"""Parameter sweep: simulations of many parameter values under one gait, as arrays with named axes."""

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import parameters, with_parameters
from snakejax.core.progress import Progress, no_progress
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Bakker

from .chunks import Columns, Executor, fingerprint, length, local_executor, map_chunks
from .ensemble import ACCURACY, Engine, engine_sentence, integrated
from .taylor_ensemble import Ensemble, Poses, heyoka_version

if TYPE_CHECKING:
    import xarray


class Axes(NamedTuple):
    """The V members of a sweep along named axes.

    `columns`: value (V,) of each varied parameter; `dims`, `shape`: names and lengths of the axes; `coordinates`: name
    -> (axis, values along it), in the order of the columns.
    """

    columns: dict[str, np.ndarray]
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coordinates: dict[str, tuple[str, np.ndarray]]

    def moving(self, name: str, values: Sequence[float] | np.ndarray) -> "Axes":
        """The same members with the `values` (V,) of one more parameter, without an axis of its own."""
        return self._replace(columns=self.columns | {name: np.asarray(values, np.float64)})

    def effective_vehicle(self, results: np.ndarray) -> np.ndarray:
        """Results of the members (V, ...) reshaped along the axes, (*shape, ...)."""
        return results.reshape(*self.shape, *results.shape[1:])


def grid(values: Mapping[str, Sequence[float] | np.ndarray]) -> Axes:
    """All combinations of the `values` of parameters, with one axis for each parameter in the order given."""
    lines = {name: np.asarray(line, np.float64).reshape(-1) for name, line in values.items()}
    meshes = np.meshgrid(*lines.values(), indexing="ij")
    columns = {name: mesh.reshape(-1) for name, mesh in zip(lines, meshes, strict=True)}
    shape = tuple(line.size for line in lines.values())
    return Axes(columns, tuple(lines), shape, {name: (name, line) for name, line in lines.items()})


def table(columns: Mapping[str, Sequence[float] | np.ndarray]) -> Axes:
    """One member for each row of a table with one column for each parameter; the axis is called `row`.

    **Raises:** `ValueError` for columns of different length.
    """
    lines = {name: np.asarray(line, np.float64).reshape(-1) for name, line in columns.items()}
    if len({line.size for line in lines.values()}) > 1:
        lengths = ", ".join(f"{name} {line.size}" for name, line in lines.items())
        raise ValueError(f"The columns of a table must be of one length, but they have: {lengths}.")
    count = len(next(iter(lines.values()), ()))
    return Axes(lines, ("row",), (count,), {name: ("row", line) for name, line in lines.items()})


def require_possible(model: Model, axes: Axes) -> None:
    """Check the values of a sweep.

    **Raises:** `ValueError` if there are no members, or if a value is outside the domain of its parameter.
    """
    if not axes.columns or not np.prod(axes.shape):
        raise ValueError("There is nothing to vary: name at least one parameter and one value.")
    for name, column in axes.columns.items():
        for end in (column.min(), column.max(), *column[~np.isfinite(column)][:1]):
            with_parameters(model, {name: float(end)})
    if isinstance(model.tyre, Bakker):
        tyre = models_on(model, axes.columns).tyre
        for name, part in parameters(tyre).items():
            for value in np.asarray(part.value):
                if why := part.domain.complaint(float(value)):
                    where = "its load and camber are beyond Bakker's formulas"
                    raise ValueError(f"A tyre would have {name} = {float(value):.3g}, which {why}: {where}.")


def require_axes(model: Model, over: Axes | Mapping[str, Sequence[float]]) -> Axes:
    """The axes of `over`, checked against `model`. **Raises:** as `require_possible`."""
    axes = over if isinstance(over, Axes) else grid(over)
    require_possible(model, axes)
    return axes


def models_on(model: Model, columns: Columns) -> Model:
    """`model` with the parameters in `columns` (V,), as one model whose arrays have a leading axis V."""
    count = length(columns)
    models = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), model)
    models = with_parameters(models, {name: jnp.asarray(column) for name, column in columns.items()})
    if isinstance(models.tyre, Bakker):
        # Evaluate Bakker's formulas once for each member, not at every step.
        tyre = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), models.tyre.coefficients())
        models = eqx.tree_at(lambda m: m.tyre, models, tyre)
    return models


def _poses(
    model: Model, gait: AbstractInputs, times: np.ndarray, start: Sequence[float], engine: Engine, columns: Columns
) -> Columns:
    poses, refusals = members_of(models_on(model, columns), gait, times, start, engine)
    return {"pose": poses, "refusal": refusals}


def members_of(models: Model, gait: AbstractInputs, times: np.ndarray, start: Sequence[float], engine: Engine) -> Poses:
    """The poses of a chunk of `models_on`, all of which start alike."""
    starts = np.broadcast_to(np.asarray(start, np.float64), (len(jax.tree.leaves(models)[0]), len(start)))
    # What the chunk varies may be alike in it by chance: the program must not depend on that.
    ensemble = Ensemble.of(models, gait, starts, times, own_gaits=False, by_value=False)
    return integrated(ensemble, ACCURACY, 1, engine)


class SweepOptions(TypedDict, total=False):
    """Options of a sweep.

    `start`: the pose (x [m], y [m], heading [rad]) of all members at time 0, at rest (default: the origin); followed by
    (u, w [m/s], yaw rate [rad/s]) where they start in motion, as of `simulate`. `folder`: where results are saved by
    chunk; after an interruption the same call computes the missing chunks, with a result that is identical to the last
    bit. `executor`: the cores of this machine (default) or a `cluster(...)`.
    `progress` counts members. `engine`: as of `simulate_many`.
    """

    start: Sequence[float]
    folder: Path | str | None
    executor: Executor
    progress: Progress
    engine: Engine


def sweep(
    model: Model,
    gait: AbstractInputs,
    times: Float[Array, " n"],
    over: Axes | Mapping[str, Sequence[float]],
    **how: Unpack[SweepOptions],
) -> "xarray.Dataset":
    """Simulate `model` under `gait` for many values of its parameters.

    **Arguments:** `times` [s] (n,), increasing. `over`: values of parameters by dotted name (`tyre.D`,
    `effects.ground_slope.sx`), taken in all combinations; or `table(...)`. `how`: see `SweepOptions`.

    **Returns:** `x`, `y` [m] and `heading` [rad] along the axes and `time`; infinite for a member whose simulation
    needs too many steps. The attribute `engine` says how the members were integrated.

    **Raises:** `ValueError` for an unknown parameter or a value outside its domain.
    """
    import xarray

    axes = require_axes(model, over)
    columns = evaluate(_poses, model, gait, times, axes, how)
    pose = axes.effective_vehicle(columns["pose"])
    channels = (("x", "m"), ("y", "m"), ("heading", "rad"))
    data = {name: ((*axes.dims, "time"), pose[..., k], {"units": unit}) for k, (name, unit) in enumerate(channels)}
    clock = {"time": ("time", np.asarray(times, np.float64), {"units": "s"})}
    return xarray.Dataset(data, coordinates(model, axes) | clock, {"engine": engine_sentence(columns["refusal"])})


def coordinates(model: Model, axes: Axes) -> dict[str, Any]:
    """The coordinates of a dataset over `axes`, with the units of the parameters."""
    known = parameters(model)
    named = zip(axes.coordinates.items(), axes.columns, strict=False)
    return {name: (dim, line, {"units": known[column].domain.unit}) for (name, (dim, line)), column in named}


def evaluate(
    work: Callable[..., Columns],
    model: Model,
    gait: AbstractInputs,
    times: Float[Array, " n"],
    axes: Axes,
    how: SweepOptions,
) -> dict[str, np.ndarray]:
    """Apply `work(model, gait, times, start, engine, columns)` to all members; each sweep has a folder of its own."""
    # NumPy arrays can be sent to a process in which JAX has not been imported.
    arguments = (model, gait, np.asarray(times, np.float64), how.get("start", (0.0, 0.0, 0.0)))
    arguments = jax.tree.map(np.asarray, arguments)
    chunk_folder, folder, engine = None, how.get("folder"), how.get("engine", "fastest")
    if folder is not None:
        how_integrated = (engine, heyoka_version()) if engine != "tsit5" else (engine,)
        chunk_folder = Path(folder) / fingerprint(work.__qualname__, arguments, axes.columns, how_integrated)[:16]
    options = {"executor": how.get("executor", local_executor), "progress": how.get("progress", no_progress)}
    return map_chunks(functools.partial(work, *arguments, engine), axes.columns, folder=chunk_folder, **options)
