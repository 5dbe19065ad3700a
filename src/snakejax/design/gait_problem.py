"""Optimisation problem of a gait: random starts, cost, equality constraints, and slack below the limits."""

from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import AbstractInputs, G, with_signals
from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Accuracy

from .limits import Limits, limits_of, slack
from .objectives import FRAME_RATE, Objective, Rollout
from .rollouts import Rollouts, RolloutSpec, rollout, rollout_jacobian, rollouts
from .slsqp import ProblemValue

GUESSES = 192
"""Number of random gaits among which the starts of the minimisations are chosen."""
SHARP = Accuracy(derivative="forward")
MET = 0.5
"""A residual is satisfied if it is below this fraction of its tolerance."""
_TOLERANCE = 1e-5
"""Violation of a relative slack that is accepted during the search; the result is scaled to satisfy the limits."""

Robustness = Literal["mean", "worst"]


class GaitProblem(eqx.Module):
    """One gait optimisation.

    `nominal`: model for the limits; `boards`: models over which the objective is taken; `spec`: rollout specification;
    `over`: mean or worst cost over the boards.
    """

    nominal: Model
    boards: tuple[Model, ...]
    spec: RolloutSpec
    objective: Objective
    limits: Limits = eqx.field(static=True)
    seconds: float = eqx.field(static=True)
    over: Robustness = eqx.field(static=True)

    def merits(self, runs: Sequence[Rollouts]) -> Float[np.ndarray, " S"]:
        """Merit (S,) of S gaits from their runs (S, ...) on each board: cost plus squared residuals."""
        stack = jax.tree.map(lambda *parts: jnp.stack(parts, axis=1), *runs)
        return np.asarray(merits(self.objective, self.spec.times, stack, self.over))

    def starts(self, known: Sequence[AbstractInputs], count: int, rng) -> tuple[list[np.ndarray], int]:
        """Unknowns of `count` starts, from known gaits and the best random ones, and the number of simulated runs.

        **Raises:** `RuntimeError` if no gait can be simulated.
        """
        shape = self.spec.shape
        guesses = [np.clip(shape.guess(rng), *shape.bounds()) for _ in range(GUESSES)]
        known_unknowns = [z for z in (shape.like(command(g)) for g in known) if z is not None]
        candidates = np.array([*known_unknowns, *guesses])[:GUESSES]
        merit = self.merits([rollouts(board, self.spec, jnp.asarray(candidates)) for board in self.boards])
        if not np.isfinite(merit).any():
            raise RuntimeError(
                "None of the gaits tried can be simulated: the tyre is too stiff, or the limits too wide"
            )
        ranked = np.argsort(np.where(np.isfinite(merit), merit, np.inf))
        kept_known = [int(k) for k in ranked if k < len(known_unknowns)][: max(count // 2, 1)]
        others = [int(k) for k in ranked if k not in kept_known and np.isfinite(merit[k])]
        return [candidates[k] for k in [*kept_known, *others][:count]], len(candidates) * len(self.boards)

    def best(self, gaits: Sequence[AbstractInputs]) -> AbstractInputs:
        """The one of `gaits` with the least merit, simulated accurately.

        **Raises:** `RuntimeError` if none can be simulated.
        """
        costs = []
        for gait in gaits:
            runs = [rollout_of(accurate(b, gait, self.seconds, self.spec.start), self.spec.times) for b in self.boards]
            rollouts_on_boards = [Rollouts(run.pose[None], run.effort[None]) for run in runs]
            costs.append(float(self.merits(rollouts_on_boards)[0]))
        if not np.isfinite(costs).any():
            raise RuntimeError(
                "None of the gaits found can be simulated: the tyre is too stiff, or the limits too wide"
            )
        return gaits[int(np.nanargmin(np.where(np.isfinite(costs), costs, np.inf)))]

    def runs(self, unknowns: Float[Array, " P"]) -> tuple[Rollouts, Rollouts]:
        """The runs on all M boards, arrays (M, ...), and their derivatives by the unknowns, (M, ..., P)."""
        each = [rollout_jacobian(board, self.spec, unknowns) for board in self.boards]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *each)

    def point(self, unknowns: np.ndarray) -> ProblemValue:
        """Values and derivatives of the problem at `unknowns` (P,)."""
        z = jnp.asarray(unknowns)
        cost, residual, cost_slope, residual_slope = _together(self.objective, self.spec.times, *self.runs(z))
        slacks = _slack(self.nominal, self.spec, self.limits, self.seconds, z)
        return ProblemValue(
            float(cost), *(np.asarray(part) for part in (cost_slope, residual, residual_slope, *slacks))
        )

    def enough(self, unknowns: np.ndarray) -> bool:
        """Whether `unknowns` satisfy residual, cost and limits."""
        value = self.point(unknowns)
        return bool((np.abs(value.equal) < MET).all() and value.cost < MET and (value.slack > -_TOLERANCE).all())

    def worst(self, unknowns: np.ndarray) -> float:
        """The largest cost over the boards."""
        return float(_apart(self.objective, self.spec.times, *self.runs(jnp.asarray(unknowns)))[0].max())

    def worst_point(self, unknowns: np.ndarray) -> ProblemValue:
        """The min-max problem: a last unknown bounds the cost of every board and is minimised (epigraph form)."""
        z, bound = jnp.asarray(unknowns[:-1]), float(unknowns[-1])
        parts = _apart(self.objective, self.spec.times, *self.runs(z))
        cost, residual, cost_slope, residual_slope = (np.asarray(part) for part in parts)
        slacks, slacks_slope = (np.asarray(p) for p in _slack(self.nominal, self.spec, self.limits, self.seconds, z))

        def with_last_column(slope: np.ndarray, last: float) -> np.ndarray:
            return np.append(slope, np.full((slope.shape[0], 1), last), axis=1)

        return ProblemValue(
            bound,
            np.append(np.zeros(z.size), 1.0),
            residual.mean(axis=0),
            with_last_column(residual_slope.mean(axis=0), 0.0),
            np.concatenate([slacks, bound - cost]),
            np.concatenate([with_last_column(slacks_slope, 0.0), with_last_column(-cost_slope, 1.0)]),
        )


@eqx.filter_jit
def merits(objective: Objective, times, runs: Rollouts, over: Robustness) -> Float[Array, " S"]:
    def merit(each: Rollouts):
        if over == "mean":
            cost, left = objective.together(Rollout(times, *each))
            return cost + jnp.sum(left**2)
        return jnp.max(jax.vmap(lambda run: _alone(objective, times, run)[0])(each))

    return jax.vmap(merit)(runs)


def _alone(objective: Objective, times, run: Rollouts) -> tuple[Scalar, Float[Array, " k"]]:
    """Cost plus squared residual of a run, and its residual (k,)."""
    rollout = Rollout(times, *run)
    residual = objective.residual(rollout)
    return objective.cost(rollout) + jnp.sum(residual**2), residual


@eqx.filter_jit
def _together(objective: Objective, times, runs: Rollouts, slopes: Rollouts):
    """Cost and residual (k,) of runs on all boards, and their derivatives (P,) and (k, P)."""
    return _sloped(lambda each: objective.together(Rollout(times, *each)), runs, slopes)


@eqx.filter_jit
def _apart(objective: Objective, times, runs: Rollouts, slopes: Rollouts):
    """Cost (M,) and residual (M, k) on each board, and their derivatives (M, P) and (M, k, P)."""
    return jax.vmap(lambda run, slope: _sloped(lambda one: _alone(objective, times, one), run, slope))(runs, slopes)


def _sloped(of: Callable[[Rollouts], tuple[Array, Array]], run: Rollouts, slope: Rollouts):
    def along(direction: Rollouts):
        return jax.jvp(of, (run,), (direction,))

    (cost, residual), (cost_slope, residual_slope) = jax.vmap(along, in_axes=-1, out_axes=((None, None), (-1, -1)))(
        slope
    )
    return cost, residual, cost_slope, residual_slope


@eqx.filter_jit
def _slack(model: Model, spec: RolloutSpec, limits: Limits, seconds: float, unknowns):
    def of(z):
        return slack(model, spec.gait(z), limits, seconds)

    def along(direction):
        return jax.jvp(of, (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(unknowns.size))


@eqx.filter_jit
def _accurate(model: Model, gait: AbstractInputs, times, start) -> Rollouts:
    return rollout(model, gait, times, start, True, SHARP)


def accurate(model: Model, gait: AbstractInputs, seconds: float, start) -> Rollout:
    """Simulate a run accurately at `FRAME_RATE`, with its effort."""
    times = jnp.linspace(0.0, seconds, int(np.ceil(seconds * FRAME_RATE)) + 1)
    return Rollout(times, *_accurate(model, gait, times, jnp.asarray(start, jnp.float64)))


def rollout_of(run: Rollout, times) -> Rollout:
    """`run` at the frames nearest to `times` (n,) [s]."""
    frames = np.linspace(0, len(run.times) - 1, len(times)).round().astype(int)
    return Rollout(jnp.asarray(times), run.pose[frames], run.effort)


def command(gait: G) -> G:
    """The commands that the joints of `gait` follow."""
    return with_signals(gait, limits_of)
