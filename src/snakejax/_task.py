"""One tuning as an optimiser sees it: guesses, costs, what must be zero, what is left below the limits."""

from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._descend import Point
from ._gait import Gait
from ._limits import Limits, room, told
from ._model import Model
from ._objective import FRAME_RATE, Objective, Ran
from ._ran import Ask, Seen, ran, seen, sloped
from ._simulate import Accuracy
from ._units import Scalar

GUESSES = 192
"""Guesses among which the starts of the descents are chosen."""
SHARP = Accuracy(derivative="forward")
MET = 0.5
"""Residuals below this share of what one would tolerate are met."""
_TOLERANCE = 1e-5
_NOWHERE = "None of the gaits {} can be simulated: the tyre is too stiff, or the limits are too wide"
Over = Literal["mean", "worst"]


class Task(eqx.Module):
    """One tuning: boards, what is asked of them, and the limits."""

    nominal: Model
    boards: tuple[Model, ...]
    ask: Ask
    objective: Objective
    limits: Limits = eqx.field(static=True)
    seconds: float = eqx.field(static=True)
    over: Over = eqx.field(static=True)

    def merits(self, runs: Sequence[Seen]) -> Float[np.ndarray, " S"]:
        """Cost plus what is not met, of the runs (S, ...) on each board: by this guesses are compared."""
        stack = jax.tree.map(lambda *parts: jnp.stack(parts, axis=1), *runs)
        return np.asarray(_merits(self.objective, self.ask.times, stack, self.over))

    def starts(self, known: Sequence[Gait], count: int, rng) -> tuple[list[np.ndarray], int]:
        """The unknowns of the known gaits and of the best guesses, `count` in all, and how many runs that took."""
        shape = self.ask.shape
        guesses = [np.clip(shape.guess(rng), *shape.bounds()) for _ in range(GUESSES)]
        mine = [z for z in (shape.like(command(g)) for g in known) if z is not None]
        every = np.array([*mine, *guesses])[:GUESSES]
        found = self.merits([seen(board, self.ask, jnp.asarray(every)) for board in self.boards])
        if not np.isfinite(found).any():
            raise RuntimeError(
                "None of the gaits tried can be simulated: the tyre is too stiff, or the limits too wide"
            )
        ranked = np.argsort(np.where(np.isfinite(found), found, np.inf))
        first = [int(k) for k in ranked if k < len(mine)][: max(count // 2, 1)]
        others = [int(k) for k in ranked if k not in first and np.isfinite(found[k])]
        return [every[k] for k in [*first, *others][:count]], len(every) * len(self.boards)

    def best(self, gaits: Sequence[Gait]) -> Gait:
        """The one of `gaits` that does best, simulated accurately."""
        costs = []
        for gait in gaits:
            runs = [looked(accurate(b, gait, self.seconds, self.ask.start), self.ask.times) for b in self.boards]
            whole = [Seen(run.pose[None], run.effort[None]) for run in runs]
            costs.append(float(self.merits(whole)[0]))
        if not np.isfinite(costs).any():
            raise RuntimeError(
                "None of the gaits found can be simulated: the tyre is too stiff, or the limits too wide"
            )
        return gaits[int(np.nanargmin(np.where(np.isfinite(costs), costs, np.inf)))]

    def runs(self, unknowns: Float[Array, " P"]) -> tuple[Seen, Seen]:
        """The runs on all boards (M, ...), and their derivatives."""
        each = [sloped(board, self.ask, unknowns) for board in self.boards]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *each)

    def point(self, unknowns: np.ndarray) -> Point:
        """The problem at `unknowns`."""
        z = jnp.asarray(unknowns)
        cost, left, cost_slope, left_slope = _together(self.objective, self.ask.times, *self.runs(z))
        space = _room(self.nominal, self.ask, self.limits, self.seconds, z)
        return Point(float(cost), *(np.asarray(part) for part in (cost_slope, left, left_slope, *space)))

    def enough(self, unknowns: np.ndarray) -> bool:
        """Whether `unknowns` meet all there is to meet."""
        found = self.point(unknowns)
        return bool((np.abs(found.equal) < MET).all() and found.cost < MET and (found.room > -_TOLERANCE).all())

    def worst(self, unknowns: np.ndarray) -> float:
        """The cost of the worst board."""
        return float(_apart(self.objective, self.ask.times, *self.runs(jnp.asarray(unknowns)))[0].max())

    def worst_point(self, unknowns: np.ndarray) -> Point:
        """The problem with one more unknown, last: a bound on the cost of every board, itself made small."""
        z, bound = jnp.asarray(unknowns[:-1]), float(unknowns[-1])
        parts = _apart(self.objective, self.ask.times, *self.runs(z))
        cost, left, cost_slope, left_slope = (np.asarray(part) for part in parts)
        space, space_slope = (np.asarray(p) for p in _room(self.nominal, self.ask, self.limits, self.seconds, z))

        def wide(slope: np.ndarray, last: float) -> np.ndarray:
            return np.append(slope, np.full((slope.shape[0], 1), last), axis=1)

        return Point(
            bound,
            np.append(np.zeros(z.size), 1.0),
            left.mean(axis=0),
            wide(left_slope.mean(axis=0), 0.0),
            np.concatenate([space, bound - cost]),
            np.concatenate([wide(space_slope, 0.0), wide(-cost_slope, 1.0)]),
        )


@eqx.filter_jit
def _merits(objective: Objective, times, runs: Seen, over: Over) -> Float[Array, " S"]:
    def one(each: Seen):
        if over == "mean":
            cost, left = objective.together(Ran(times, *each))
            return cost + jnp.sum(left**2)
        return jnp.max(jax.vmap(lambda run: _alone(objective, times, run)[0])(each))

    return jax.vmap(one)(runs)


def _alone(objective: Objective, times, run: Seen) -> tuple[Scalar, Float[Array, " k"]]:
    """Cost of a run, with what is not zero counted too, and residual."""
    looked = Ran(times, *run)
    left = objective.residual(looked)
    return objective.cost(looked) + jnp.sum(left**2), left


@eqx.filter_jit
def _together(objective: Objective, times, runs: Seen, slopes: Seen):
    """Cost and residual (k,) of runs on all boards, and their derivatives (P,) and (k, P)."""
    return _sloped(lambda each: objective.together(Ran(times, *each)), runs, slopes)


@eqx.filter_jit
def _apart(objective: Objective, times, runs: Seen, slopes: Seen):
    """Cost (M,) and residual (M, k) on each board, and their derivatives (M, P) and (M, k, P)."""
    return jax.vmap(lambda run, slope: _sloped(lambda one: _alone(objective, times, one), run, slope))(runs, slopes)


def _sloped(of: Callable[[Seen], tuple[Array, Array]], run: Seen, slope: Seen):
    def along(direction: Seen):
        return jax.jvp(of, (run,), (direction,))

    (cost, left), (cost_slope, left_slope) = jax.vmap(along, in_axes=-1, out_axes=((None, None), (-1, -1)))(slope)
    return cost, left, cost_slope, left_slope


@eqx.filter_jit
def _room(model: Model, ask: Ask, limits: Limits, seconds: float, unknowns):
    def of(z):
        return room(model, ask.gait(z), limits, seconds)

    def along(direction):
        return jax.jvp(of, (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(unknowns.size))


@eqx.filter_jit
def _accurate(model: Model, gait: Gait, times, start) -> Seen:
    return ran(model, gait, times, start, True, SHARP)


def accurate(model: Model, gait: Gait, seconds: float, start) -> Ran:
    """A run simulated accurately, 100 frames a second, with its effort."""
    times = jnp.linspace(0.0, seconds, int(np.ceil(seconds * FRAME_RATE)) + 1)
    return Ran(times, *_accurate(model, gait, times, jnp.asarray(start, jnp.float64)))


def looked(run: Ran, times) -> Ran:
    """`run` at those of its frames that are nearest to `times`."""
    frames = np.linspace(0, len(run.times) - 1, len(times)).round().astype(int)
    return Ran(jnp.asarray(times), run.pose[frames], run.effort)


def command(gait: Gait) -> Gait:
    return Gait(told(gait.phi), told(gait.psi))
