"""Many boards at once: Tsit5 for lanes that each take steps of their own, in one loop that a CPU computes side by side.

diffrax integrates single runs and fits; for thousands of small systems most of its time goes into looking after each
one. Here a block of lanes is a handful of vectors that stay in the first cache, and a step of all of them is one
straight piece of arithmetic. The method and its coefficients are those of `diffrax.Tsit5`.
"""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from ._gait import Gait
from ._math import hold
from ._model import Model
from ._simulate import Accuracy
from ._units import require_x64

BLOCK = 64
"""Lanes that step together: enough to fill the vector units, few enough to stay in the first cache."""
PIECE = 256
"""Lanes of one call of a compiled program, so that one program serves any number of lanes."""
ACCURACY = Accuracy(rtol=1e-7, atol=1e-9, max_steps=200_000)
FIRST_STEP, LEAST_STEP = 1e-3, 1e-12
_SAFETY, _LEAST, _MOST = 0.8, 0.2, 5.0

_TABLEAU = diffrax.Tsit5.tableau
_STAGES = [[float(a) for a in row] for row in _TABLEAU.a_lower]
_NODES = [float(c) for c in _TABLEAU.c]
_ERROR = [float(e) for e in _TABLEAU.b_error]

Lanes = tuple[Model, Gait | None, Float[Array, "V 3"]]
"""Stacked models and gaits, and where each lane starts."""
Leaves = list[Float[Array, " B"]]
Rates = Callable[[Float[Array, " B"], Leaves], Leaves]


def _block(rates: Rates, y: Leaves, times: Float[Array, "n B"], t: Float[Array, " B"], accuracy: Accuracy):
    """The states (n, B) at `times` of one block of lanes that start at `t`, and whether each lane got there.

    A lane whose step meets the next time waits there for the others.
    """

    def advance(carry, target):
        def step(carry):
            t, y, first, h_next, taken = carry
            left = target - t
            # The last two steps before `target` are of one size, so that none is a mere rest.
            h = jnp.where(h_next >= left, left, jnp.where(2 * h_next > left, 0.5 * left, h_next))
            last = h_next >= left
            (h,) = hold(h)
            slopes = [first]
            for nodes, row in zip(_NODES, _STAGES, strict=True):
                there = hold(*(_moved(p, h, row, [s[i] for s in slopes]) for i, p in enumerate(y)))
                slopes.append(list(hold(*rates(t + nodes * h, list(there)))))
            # The method's last stage is its solution.
            square = jnp.zeros_like(t)
            for i, (a, b) in enumerate(zip(y, there, strict=True)):
                scale = accuracy.atol + accuracy.rtol * jnp.maximum(jnp.abs(a), jnp.abs(b))
                e = h * _combined(_ERROR, [s[i] for s in slopes])
                square = square + (e / scale) ** 2
            square = square / len(y)
            good = square <= 1.0
            # The eighth root: a little more careful than the fifth, and cheap.
            root = jnp.sqrt(jnp.sqrt(jnp.sqrt(jnp.sqrt(jnp.maximum(square, 1e-30)))))
            factor = jnp.where(jnp.isfinite(square), jnp.clip(_SAFETY / root, _LEAST, _MOST), _LEAST)
            grown = h * factor
            h_next = jnp.where(good & (h < h_next), jnp.maximum(grown, h_next), grown)
            here = (left > 0) & (taken < accuracy.max_steps)
            go = good & here
            t = jnp.where(go, jnp.where(last, target, t + h), t)
            y = [jnp.where(go, b, a) for a, b in zip(y, there, strict=True)]
            first = [jnp.where(go, b, a) for a, b in zip(first, slopes[-1], strict=True)]
            # A step that shrinks to nothing, as where the rates are not finite, will get no further.
            taken = jnp.where(h_next < LEAST_STEP, float(accuracy.max_steps), taken + 1.0)
            return t, y, first, jnp.where(here, h_next, carry[3]), jnp.where(here, taken, carry[4])

        def busy(carry):
            return jnp.any((carry[0] < target) & (carry[4] < accuracy.max_steps))

        carry = jax.lax.while_loop(busy, step, carry)
        return carry, carry[1]

    begin = (t, y, rates(t, y), jnp.full_like(t, FIRST_STEP), jnp.zeros_like(t))
    ended, states = jax.lax.scan(advance, begin, times)
    return states, ended[0] >= times[-1]


def _combined(weights: list[float], slopes: list[Array]) -> Array:
    return sum((w * s for w, s in zip(weights, slopes, strict=True) if w != 0.0), jnp.zeros_like(slopes[0]))


def _moved(p: Array, h: Array, row: list[float], slopes: list[Array]) -> Array:
    return p + h * _combined(row, slopes)


def _poses(models: Model, gaits: Gait, times: Array, start: Array, accuracy: Accuracy) -> Float[Array, "B n 3"]:
    """Poses of one block, infinite where a lane did not get to the end."""
    delay = jax.vmap(lambda model: model.delay() + jnp.zeros(()))(models)
    begins = jax.vmap(lambda gait: gait.begins())(gaits)
    until = jnp.maximum(times[:, None] - delay[None, :], begins[None, :])
    states = jax.vmap(lambda model, at: model.start((at[0], at[1], at[2])))(models, start)
    leaves, structure = jax.tree.flatten(states)

    def one(t, y, model, gait):
        return jax.tree.leaves(model.rates(t, jax.tree.unflatten(structure, y), gait))

    @jax.jit  # so that it is traced once, and not for every stage
    def rates(t, y):
        return jax.vmap(one)(t, y, models, gaits)

    states, finished = _block(rates, leaves, until, begins, accuracy)
    bodies = jax.tree.unflatten(structure, states)[0]
    pose = jax.vmap(lambda model, body: jnp.stack(model.observe(body), axis=-1), in_axes=(0, 1))(models, bodies)
    return jnp.where(finished[:, None, None] & jnp.isfinite(pose), pose, jnp.inf)


def _piece(lanes: Lanes, count: Array, gait: Gait | None, times: Array, accuracy: Accuracy) -> Float[Array, "V n 3"]:
    """Poses of the first `count` of the lanes of a piece, block by block."""

    def block(number, poses):
        first = number * BLOCK
        models, gaits, start = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, BLOCK), lanes)
        if gait is not None:
            gaits = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (BLOCK, *jnp.shape(leaf))), gait)
        found = _poses(models, gaits, times, start, accuracy)
        return jax.lax.dynamic_update_slice_in_dim(poses, found, first, 0)

    size = lanes[2].shape[0]
    return jax.lax.fori_loop(0, -(-count // BLOCK), block, jnp.zeros((size, times.size, 3)))


_OPTIONS = {"xla_cpu_prefer_vector_width": 512, "xla_backend_optimization_level": 1}
"""Without the first XLA keeps to 256 bits also where the CPU has more; the second compiles in less time, no worse."""


_PROGRAMS: dict[Any, Any] = {}
_COMPILING = threading.Lock()


def _program(devices: int, arguments: tuple, accuracy: Accuracy):
    """`_piece` compiled for `arguments`, on one device or a piece on each of several; once, however many ask."""
    leaves, structure = jax.tree.flatten(arguments)
    key = (devices, accuracy, structure, *((leaf.shape, leaf.dtype) for leaf in leaves))
    with _COMPILING:
        if key not in _PROGRAMS:
            wanted = jax.jit(_alone if devices == 1 else _shared, static_argnums=4, compiler_options=_OPTIONS)
            _PROGRAMS[key] = wanted.lower(*arguments, accuracy).compile()
        return _PROGRAMS[key]


def _alone(lanes: Lanes, counts: Array, gait: Gait | None, times: Array, accuracy: Accuracy) -> Array:
    return _piece(lanes, counts[0], gait, times, accuracy)


def _shared(lanes: Lanes, counts: Array, gait: Gait | None, times: Array, accuracy: Accuracy) -> Array:
    mesh = Mesh(np.array(jax.local_devices()), ("lanes",))
    each, all_ = PartitionSpec("lanes"), PartitionSpec()

    def one(lanes, counts, gait, times):
        return _alone(lanes, counts, gait, times, accuracy)

    specs = dict(in_specs=(each, each, all_, all_), out_specs=each)
    return jax.shard_map(one, mesh=mesh, check_vma=False, **specs)(lanes, counts, gait, times)  # type: ignore


def simulate_many(
    models: Model,
    gait: Gait,
    times: Float[Array, " n"],
    start: Sequence[float] | Float[Array, "V 3"] = (0.0, 0.0, 0.0),
    *,
    own_gaits: bool = False,
    accuracy: Accuracy = ACCURACY,
    workers: int | None = None,
) -> Float[np.ndarray, "V n 3"]:
    """Poses (x [m], y [m], heading [rad]) of many boards that start at rest at time 0.

    The boards are shared out among `workers` threads (default: one for each core this process may use), or by
    `jax.sharding` among the devices where JAX has several. The numbers do not depend on how many threads there are, and
    on devices by rounding alone. The poses of a board that needs more than `accuracy.max_steps` steps are infinite.

    **Arguments:** `models`: one whose arrays have a leading axis V (`stacked`). `gait`: one for all, or with
    `own_gaits` stacked like `models`. `times` [s] (n,), increasing. `start`: the pose (3,)
    where all start, or (V, 3).
    **Raises:** `RuntimeError` without double precision; `ValueError` for times that do not increase from 0 on.
    """
    require_x64()
    frames, count = np.asarray(times, np.float64), jax.tree.leaves(models)[0].shape[0]
    if frames.ndim != 1 or not frames.size or not np.isfinite(frames).all() or frames[0] < 0:
        raise ValueError("Argument `times` must be a row of finite numbers from 0 on.")
    if (np.diff(frames) <= 0).any():
        raise ValueError("Argument `times` must increase.")
    if np.shape(start) not in ((3,), (count, 3)):
        raise ValueError(f"Argument `start` must have the shape (3,) or {(count, 3)}, but it has {np.shape(start)}.")
    if accuracy.step is not None:
        raise ValueError("Lanes choose their own steps: leave out the fixed step of `accuracy`.")
    places = np.broadcast_to(np.asarray(start, np.float64), (count, 3))
    lanes = jax.tree.map(np.asarray, (models, gait if own_gaits else None, places))
    rest = (jax.tree.map(np.asarray, None if own_gaits else gait), frames)
    devices = jax.local_device_count()
    share = PIECE * devices

    def piece(first: int) -> np.ndarray:
        # Each device has a piece of its own; where lanes are missing the last one stands in and is left out.
        wanted = min(share, count - first)
        each = -(-wanted // devices)
        begins = np.minimum(each * np.arange(devices), wanted)
        sizes = np.minimum(each, wanted - begins)
        rows = np.minimum(first + begins[:, None] + np.arange(PIECE), count - 1).ravel()
        arguments = (jax.tree.map(lambda leaf: leaf[rows], lanes), sizes, *rest)
        found = np.asarray(_program(devices, arguments, accuracy)(*arguments))
        return np.concatenate([found[PIECE * d : PIECE * d + size] for d, size in enumerate(sizes)])

    firsts = range(0, count, share)
    with ThreadPoolExecutor(1 if devices > 1 else workers or cores()) as pool:
        return np.concatenate(list(pool.map(piece, firsts)))


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def stacked(models: Sequence[Model]) -> Model:
    """Models of one structure as one whose arrays have a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *models)
