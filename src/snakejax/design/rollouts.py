"""Rollouts: simulations of a parametrised gait, and their derivative by its unknowns."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snakejax.core.errors import InputError
from snakejax.core.parameter import Parametrised, Scalar, param
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Tracked
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.simulation.inverse_dynamics import effort, torques

from .gait_families import GaitFamily

ACCURACY = Accuracy(rtol=1e-6, atol=1e-8, max_steps=65536, derivative="forward")
"""Accuracy of the search; the result is simulated again with higher accuracy."""


class Controller(Parametrised):
    """Tracking of joint commands: by the controller of eq. (8), or exactly if it has no gains."""

    kp: Scalar | None = param("1/s^2", positive=True, default=None)
    kd: Scalar | None = param("1/s", low=0.0, default=None)

    @staticmethod
    def of(gait: Gait) -> "Controller":
        """The controller of the joints of `gait`. **Raises:** `InputError` where they have different ones."""
        steering, rotor = (
            Controller(joint.kp, joint.kd) if isinstance(joint, Tracked) else Controller()
            for joint in (gait.phi, gait.psi)
        )
        if not eqx.tree_equal(steering, rotor):
            what = "phi and psi have different controllers, and a gait is designed for one"
            raise InputError(what, "[actuator] of case.toml", "give both joints the same kp and kd")
        return steering

    def driven(self, command: Gait) -> Gait:
        """The gait whose joints follow `command`."""
        if self.kp is None:
            return command
        return Gait(Tracked(command.phi, self.kp, self.kd), Tracked(command.psi, self.kp, self.kd))


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

    def gait(self, unknowns: Float[Array, " P"]) -> Gait:
        """The gait of `unknowns`."""
        return self.driver.driven(self.shape.gait(unknowns))


class Rollouts(NamedTuple):
    """Poses (n, 3) and effort of a run; a further axis stands for several runs or for the unknowns of a derivative."""

    pose: Float[Array, "n 3"]
    effort: Scalar


def rollout(model: Model, gait: Gait, times, start, counts_effort: bool, accuracy: Accuracy) -> Rollouts:
    """Simulate one run; its poses are infinite if the simulation fails."""
    trajectory = simulate(model, gait, times, start, accuracy=accuracy, throw=False)
    if not counts_effort:
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
