"""Ensemble simulation: Tsit5 for many models at once, each member with its own step size, in one vectorised loop.

diffrax integrates single runs and fits; for thousands of small systems most of its time is overhead for each system.
Here a block of members is a few vectors that stay in the first-level cache, and a step of all of them is arithmetic
without branches. The method and its coefficients are those of `diffrax.Tsit5` (Tsitouras 2011).
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from snakejax.core.fast_math import hold
from snakejax.core.jax_config import require_x64
from snakejax.core.parallel import cores
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model

from .integrate import Accuracy
from .taylor_ensemble import Ensemble, Poses, beginning, by_taylor_series, heyoka_version

BLOCK = 64
"""Members that step together: enough to fill the vector units, few enough for the first-level cache."""
CHUNK = 256
"""Members of one call of a compiled program, so that one program serves any number of members."""
ACCURACY = Accuracy(rtol=1e-7, atol=1e-9, max_steps=200_000)
FIRST_STEP, LEAST_STEP = 1e-3, 1e-12
"""First step [s], and the step [s] below which a member has failed."""
_SAFETY, _LEAST, _MOST = 0.8, 0.2, 5.0
"""Step size control: safety factor, least and largest change of the step (Hairer, Norsett and Wanner 1993, II.4)."""

_TABLEAU = diffrax.Tsit5.tableau
_STAGES = [[float(a) for a in row] for row in _TABLEAU.a_lower]
_NODES = [float(c) for c in _TABLEAU.c]
_ERROR = [float(e) for e in _TABLEAU.b_error]

Engine = Literal["fastest", "taylor", "tsit5"]
"""How an ensemble is integrated: by Taylor series, by Tsit5, or by the fastest that is present and applies."""
Members = tuple[Model, AbstractInputs | None, Float[Array, "V k"]]
"""Stacked models, stacked gaits and starts of the members."""
Tolerances = tuple[Array, Array, Array]
"""Relative and absolute error, and the largest number of steps: arguments, so that one program serves any accuracy."""
Leaves = list[Float[Array, " B"]]
Rates = Callable[[Float[Array, " B"], Leaves], Leaves]


def _block(rates: Rates, y: Leaves, times: Float[Array, "n B"], t: Float[Array, " B"], accuracy: Tolerances):
    """The states (n, B) at `times` of one block of members that start at `t`, and whether each member reached the end.

    A member that reaches the next time waits there for the others.
    """

    rtol, atol, most_steps = accuracy

    def advance(carry, target):
        def step(carry):
            t, y, first, h_next, taken = carry
            remaining = target - t
            # The last two steps before `target` are of equal size, so that none is very short.
            h = jnp.where(h_next >= remaining, remaining, jnp.where(2 * h_next > remaining, 0.5 * remaining, h_next))
            last = h_next >= remaining
            (h,) = hold(h)
            slopes, new_state = [first], tuple(y)
            for nodes, row in zip(_NODES, _STAGES, strict=True):
                new_state = hold(*(_moved(p, h, row, [s[i] for s in slopes]) for i, p in enumerate(y)))
                slopes.append(list(hold(*rates(t + nodes * h, list(new_state)))))
            # The last stage of the method is its solution.
            square = jnp.zeros_like(t)
            for i, (a, b) in enumerate(zip(y, new_state, strict=True)):
                scale = atol + rtol * jnp.maximum(jnp.abs(a), jnp.abs(b))
                e = h * _combined(_ERROR, [s[i] for s in slopes])
                square = square + (e / scale) ** 2
            square = square / len(y)
            accepted = square <= 1.0
            # The eighth root of the error, by square roots: cheaper than the fifth root and slightly more cautious.
            root = jnp.sqrt(jnp.sqrt(jnp.sqrt(jnp.sqrt(jnp.maximum(square, 1e-30)))))
            factor = jnp.where(jnp.isfinite(square), jnp.clip(_SAFETY / root, _LEAST, _MOST), _LEAST)
            grown = h * factor
            h_next = jnp.where(accepted & (h < h_next), jnp.maximum(grown, h_next), grown)
            active = (remaining > 0) & (taken < most_steps)
            moves = accepted & active
            t = jnp.where(moves, jnp.where(last, target, t + h), t)
            y = [jnp.where(moves, b, a) for a, b in zip(y, new_state, strict=True)]
            first = [jnp.where(moves, b, a) for a, b in zip(first, slopes[-1], strict=True)]
            # Below the least step, as with rates that are not finite, the member has failed.
            taken = jnp.where(h_next < LEAST_STEP, most_steps, taken + 1.0)
            return t, y, first, jnp.where(active, h_next, carry[3]), jnp.where(active, taken, carry[4])

        def busy(carry):
            return jnp.any((carry[0] < target) & (carry[4] < most_steps))

        carry = jax.lax.while_loop(busy, step, carry)
        return carry, carry[1]

    begin = (t, y, rates(t, y), jnp.full_like(t, FIRST_STEP), jnp.zeros_like(t))
    ended, states = jax.lax.scan(advance, begin, times)
    return states, ended[0] >= times[-1]


def _combined(weights: list[float], slopes: list[Array]) -> Array:
    return sum((w * s for w, s in zip(weights, slopes, strict=True) if w != 0.0), jnp.zeros_like(slopes[0]))


def _moved(p: Array, h: Array, row: list[float], slopes: list[Array]) -> Array:
    return p + h * _combined(row, slopes)


def _poses(
    models: Model, gaits: AbstractInputs, times: Array, start: Array, accuracy: Tolerances
) -> Float[Array, "B n 3"]:
    """Poses (B, n, 3) of one block, infinite for a member that did not reach the end."""
    gaits = jax.vmap(lambda model, gait: model.prepared(gait))(models, gaits)
    delay = jax.vmap(lambda model: model.delay() + jnp.zeros(()))(models)
    begins, states = jax.vmap(beginning)(models, gaits, start)
    end_times = jnp.maximum(times[:, None] - delay[None, :], begins[None, :])
    leaves, structure = jax.tree.flatten(states)

    def member_rates(t, y, model, gait):
        return jax.tree.leaves(model.rates(t, jax.tree.unflatten(structure, y), gait))

    @jax.jit  # so that it is traced once, and not for every stage
    def rates(t, y):
        return jax.vmap(member_rates)(t, y, models, gaits)

    states, finished = _block(rates, leaves, end_times, begins, accuracy)
    bodies = jax.tree.unflatten(structure, states)[0]
    pose = jax.vmap(lambda model, body: jnp.stack(model.observe(body), axis=-1), in_axes=(0, 1))(models, bodies)
    return jnp.where(finished[:, None, None] & jnp.isfinite(pose), pose, jnp.inf)


def _chunk(
    members: Members, count: Array, gait: AbstractInputs | None, times: Array, accuracy: Tolerances
) -> Float[Array, "V n 3"]:
    """Poses (V, n, 3) of the first `count` members of a chunk, block by block."""

    def block(number, poses):
        first = number * BLOCK
        models, gaits, start = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, BLOCK), members)
        if gait is not None:
            gaits = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (BLOCK, *jnp.shape(leaf))), gait)
        block_poses = _poses(models, gaits, times, start, accuracy)
        return jax.lax.dynamic_update_slice_in_dim(poses, block_poses, first, 0)

    size = members[2].shape[0]
    return jax.lax.fori_loop(0, -(-count // BLOCK), block, jnp.zeros((size, times.size, 3)))


_OPTIONS = {"xla_cpu_prefer_vector_width": 512, "xla_backend_optimization_level": 1}
"""The first makes XLA use 512-bit vectors where the CPU has them (default 256); the second compiles faster to code of
the same speed."""


_PROGRAMS: dict[Any, Any] = {}
_COMPILING = threading.Lock()


def _program(devices: int, arguments: tuple):
    """`_chunk` compiled for `arguments`, on one device or with one chunk on each; compiled once for all threads."""
    leaves, structure = jax.tree.flatten(arguments)
    key = (devices, structure, *((leaf.shape, leaf.dtype) for leaf in leaves))
    with _COMPILING:
        if key not in _PROGRAMS:
            function = jax.jit(_alone if devices == 1 else _shared, compiler_options=_OPTIONS)
            _PROGRAMS[key] = function.lower(*arguments).compile()
        return _PROGRAMS[key]


def _alone(members: Members, counts: Array, gait: AbstractInputs | None, times: Array, accuracy: Tolerances) -> Array:
    return _chunk(members, counts[0], gait, times, accuracy)


def _shared(members: Members, counts: Array, gait: AbstractInputs | None, times: Array, accuracy: Tolerances) -> Array:
    mesh = Mesh(np.array(jax.local_devices()), ("lanes",))
    each, all_ = PartitionSpec("lanes"), PartitionSpec()

    specs = dict(in_specs=(each, each, all_, all_, all_), out_specs=each)
    return jax.shard_map(_alone, mesh=mesh, check_vma=False, **specs)(members, counts, gait, times, accuracy)  # type: ignore


def simulate_many(
    models: Model,
    gait: AbstractInputs,
    times: Float[Array, " n"],
    start: Sequence[float] | Float[Array, "V k"] = (0.0, 0.0, 0.0),
    *,
    own_gaits: bool = False,
    accuracy: Accuracy = ACCURACY,
    workers: int | None = None,
    engine: Engine = "fastest",
) -> Float[np.ndarray, "V n 3"]:
    """Poses (V, n, 3), x, y [m] and heading [rad], of many models that start at time 0, at rest or in motion.

    The members are distributed over `workers` threads (default: one for each core of this process), or by
    `jax.sharding` over several devices. The result does not depend on the number of threads; between devices it differs
    by rounding. The poses of a member that needs more than `accuracy.max_steps` steps are infinite.

    **Arguments:** `models`: a model whose arrays have a leading axis V (`stacked`). `gait`: one for all, or with
    `own_gaits` stacked like `models`. `times` [s] (n,), increasing. `start`: one pose (3,) at rest for all, or
    (V, 3); or pose and velocities, (6,) or (V, 6), as of `simulate`.
    `engine`: "taylor" (Taylor series, of the extra `taylor`), "tsit5", or the fastest: Taylor series where the extra is
    installed, and Tsit5 for the members that have no series to the end of their run.
    **Raises:** `RuntimeError` without double precision; `ValueError` for times that do not increase from 0, a wrong
    shape of `start`, an `accuracy` with a fixed step, or a model without Taylor series if these are asked for.
    """
    require_x64()
    frames, count = np.asarray(times, np.float64), jax.tree.leaves(models)[0].shape[0]
    if frames.ndim != 1 or not frames.size or not np.isfinite(frames).all() or frames[0] < 0:
        raise ValueError("Argument `times` must be a row of finite numbers from 0 on.")
    if (np.diff(frames) <= 0).any():
        raise ValueError("Argument `times` must increase.")
    if np.shape(start) not in ((3,), (count, 3), (6,), (count, 6)):
        shapes = f"(3,) or {(count, 3)}, or in motion (6,) or {(count, 6)}"
        raise ValueError(f"Argument `start` must have the shape {shapes}, but it has {np.shape(start)}.")
    if accuracy.step is not None:
        raise ValueError("Members choose their own steps: leave out the fixed step of `accuracy`.")
    starts = np.broadcast_to(np.asarray(start, np.float64), (count, np.shape(start)[-1]))
    ensemble = Ensemble.of(models, gait, starts, frames, own_gaits, by_value=True)
    return integrated(ensemble, accuracy, workers, engine).poses


def integrated(ensemble: Ensemble, accuracy: Accuracy, workers: int | None, engine: Engine) -> Poses:
    """The poses of `ensemble` by `engine`, and why a member was integrated by Tsit5: "" where it was not.

    **Raises:** `ValueError` if Taylor series are asked for and the models have none, or heyoka is not installed.
    """
    count = len(ensemble.starts)
    refused = _refused_for_all(engine)
    if engine == "taylor" and refused:
        raise ValueError(f"There are no Taylor series: {refused}.")
    if refused:
        return Poses(_by_tsit5(ensemble, np.arange(count), accuracy, workers), np.full(count, refused))
    poses, refusals = by_taylor_series(ensemble, accuracy, workers)
    left = np.flatnonzero(refusals != "")
    if left.size and engine == "taylor":
        raise ValueError(f"{left.size} of {count} members have no Taylor series: {refusals[left[0]]}.")
    if left.size:
        poses[left] = _by_tsit5(ensemble, left, accuracy, workers)
    return Poses(poses, refusals)


def _refused_for_all(engine: Engine) -> str:
    """Why no member is integrated by Taylor series; "" if any may be."""
    if engine == "tsit5":
        return "it was asked for"
    if jax.local_device_count() > 1 and engine == "fastest":
        return "the members are shared by several devices"
    return "" if heyoka_version() else "heyoka is not installed (pip install 'snakejax[taylor]')"


def engine_sentence(refusals: np.ndarray) -> str:
    """Which members were integrated by which method, and why not all by Taylor series."""
    others = refusals[refusals != ""]
    if not others.size:
        return "Integrated by Taylor series."
    reasons = "; ".join(dict.fromkeys(others.tolist()))
    who = "" if others.size == refusals.size else f" for {others.size} of {refusals.size} members"
    return f"Integrated by {'Taylor series and ' if who else ''}Tsit5{who}: {reasons}."


def _by_tsit5(
    ensemble: Ensemble, members: np.ndarray, accuracy: Accuracy, workers: int | None
) -> Float[np.ndarray, "m n 3"]:
    """The poses of the `members` by Tsit5, in chunks of one size."""
    count, own_gaits = members.size, ensemble.own_gaits
    stacked_parts = (ensemble.models, ensemble.gaits if own_gaits else None, ensemble.starts)
    tolerances = tuple(np.float64(number) for number in (accuracy.rtol, accuracy.atol, accuracy.max_steps))
    common = (None if own_gaits else ensemble.gaits, ensemble.times, tolerances)
    devices = jax.local_device_count()
    share = CHUNK * devices

    def chunk(first: int) -> np.ndarray:
        # Each device has its own chunk; it is filled up with copies of the last member, which are dropped.
        needed = min(share, count - first)
        per_device = -(-needed // devices)
        begins = np.minimum(per_device * np.arange(devices), needed)
        sizes = np.minimum(per_device, needed - begins)
        rows = members[np.minimum(first + begins[:, None] + np.arange(CHUNK), count - 1).ravel()]
        arguments = (jax.tree.map(lambda leaf: leaf[rows], stacked_parts), sizes, *common)
        poses = np.asarray(_program(devices, arguments)(*arguments))
        return np.concatenate([poses[CHUNK * d : CHUNK * d + size] for d, size in enumerate(sizes)])

    firsts = range(0, count, share)
    with ThreadPoolExecutor(1 if devices > 1 else workers or cores()) as pool:
        return np.concatenate(list(pool.map(chunk, firsts)))


def stacked(models: Sequence[Model]) -> Model:
    """Stack models of the same structure into one model whose arrays have a leading axis.

    **Raises:** `ValueError` for models of different structure.
    """
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *models)
