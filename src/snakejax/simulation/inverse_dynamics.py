"""Inverse dynamics: joint torques and the effort of a run."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model

from .integrate import Trajectory


def torques(model: Model, gait: AbstractInputs, trajectory: Trajectory) -> Float[Array, "n 2"]:
    """Torques (n, 2) [N m] of the steering and the rotor joint at every sample of a run (rows phi and psi of eq. 2).

        tau_phi = 2 J_w phi''        tau_psi = J_r (psi'' + rdot)

    with r the yaw rate of the body (s under the coupled structure). The wheelsets turn in opposite directions, so the
    yaw acceleration of the body needs no steering torque; a wheel without trail has no moment from its lateral force.
    """

    def at(t: Scalar, state) -> Float[Array, " 2"]:
        def yaw_rate(t, state):
            return model.motion(t, state[0], gait).r

        motion = model.motion(t, state[0], gait)
        rates = model.rates(t, state, gait)
        yaw_acceleration = jax.jvp(yaw_rate, (t, state), (jnp.ones(()), jax.tree.map(jnp.asarray, rates)))[1]
        return jnp.stack(model.board.actuator_torques(motion.inputs, yaw_acceleration))

    return jax.vmap(at)(trajectory.command_times, trajectory.state)


def effort(times: Float[Array, " n"], torque: Float[Array, "n 2"]) -> Scalar:
    """The integral of the squared joint torques [N^2 m^2 s], by the trapezoidal rule."""
    return jnp.trapezoid(jnp.sum(torque**2, axis=1), times)
