"""Rollouts: simulations of a parametrised gait, and their derivative by its unknowns."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snakejax.core.errors import InputError
from snakejax.core.parameter import Parametrised, Scalar, param
from snakejax.dynamics.inputs import AbstractInputs, G, with_signals
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Tracked
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.simulation.inverse_dynamics import effort, torques

from .gait_families import JOINTS, GaitFamily

ACCURACY = Accuracy(rtol=1e-6, atol=1e-8, max_steps=65536, derivative="forward")
"""Accuracy of the search; the result is simulated again with higher accuracy."""


class Controller(Parametrised):
    """Tracking of joint commands: by the controller of eq. (8), or exactly if it has no gains."""

    kp: Scalar | None = param("1/s^2", positive=True, default=None)
    kd: Scalar | None = param("1/s", low=0.0, default=None)

    @staticmethod
    def of(gait: AbstractInputs, names: Sequence[str] = JOINTS) -> "Controller":
        """The controller of the inputs `names` of `gait`. **Raises:** `InputError` where they have different ones."""
        signals = [gait.signal(name) for name in names]
        each = [Controller(one.kp, one.kd) if isinstance(one, Tracked) else Controller() for one in signals]
        if not all(eqx.tree_equal(each[0], other) for other in each[1:]):
            what = f"{' and '.join(names)} have different controllers, and a gait is designed for one"
            raise InputError(what, "[actuator] of case.toml", "give all joints the same kp and kd")
        return each[0] if each else Controller()

    def driven(self, command: G) -> G:
        """The gait whose joints follow `command`."""
        kp, kd = self.kp, self.kd
        if kp is None:
            return command
        assert kd is not None
        return with_signals(command, lambda signal: Tracked(signal, kp, kd))


class RolloutSpec(eqx.Module):
    """What rollouts of all gaits have in common.

    `shape`: gait family; `driver`: controller of the joints; `times` (n,) [s]; `start`: pose (3,) [m, m, rad] at rest;
    `counts_effort`: whether the effort is computed.
    """

    shape: GaitFamily
    driver: Controller
    times: Float[Array, " n"]
    start: Float[Array, " 3"]
    counts_effort: bool = eqx.field(static=True)

    def gait(self, unknowns: Float[Array, " P"]) -> AbstractInputs:
        """The gait of `unknowns`."""
        return self.driver.driven(self.shape.gait(unknowns))


class Rollouts(NamedTuple):
    """Poses (n, 3) and effort of a run; a further axis stands for several runs or for the unknowns of a derivative."""

    pose: Float[Array, "n 3"]
    effort: Scalar


def rollout(model: Model, gait: AbstractInputs, times, start, counts_effort: bool, accuracy: Accuracy) -> Rollouts:
    """Simulate one run; its poses are infinite if the simulation fails.

    The effort is NaN where it is not counted, or where the torques of the vehicle are not known.
    """
    trajectory = simulate(model, gait, times, start, accuracy=accuracy, throw=False)
    if not (counts_effort and model.board.knows_actuator_torques):
        return Rollouts(trajectory.pose, jnp.full((), jnp.nan))
    return Rollouts(trajectory.pose, effort(trajectory.times, torques(model, gait, trajectory)))


@eqx.filter_jit
def rollouts(model: Model, spec: RolloutSpec, unknowns: Float[Array, "S P"]) -> Rollouts:
    """Simulate the gaits of S rows of unknowns in one batch: poses (S, n, 3)."""
    return jax.vmap(lambda z: rollout(model, spec.gait(z), spec.times, spec.start, spec.counts_effort, ACCURACY))(
        unknowns
    )


@eqx.filter_jit
def rollout_jacobian(model: Model, spec: RolloutSpec, unknowns: Float[Array, " P"]) -> tuple[Rollouts, Rollouts]:
    """Simulate one gait: poses (n, 3), and their derivative by the unknowns (n, 3, P)."""

    def run(z):
        return rollout(model, spec.gait(z), spec.times, spec.start, spec.counts_effort, ACCURACY)

    def along(direction):
        return jax.jvp(run, (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(unknowns.size))
