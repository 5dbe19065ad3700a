"""Joint torques by inverse dynamics, and the effort of a run."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._gait import Gait
from ._model import Model
from ._simulate import Trajectory
from ._units import Scalar


def torques(model: Model, gait: Gait, ran: Trajectory) -> Float[Array, "n 2"]:
    """The torques [N m] of the steering and of the rotor joint at every sample of a run (rows phi and psi of eq. 2).

        tau_phi = 2 J_w phi''        tau_psi = J_r (psi'' + rdot)

    with r the yaw rate of the body, s under the coupled structure. The wheelsets turn against each other, so that the
    turning of the body costs the steering nothing, and a wheel without trail takes no moment from its traction.
    """

    def at(t: Scalar, state) -> Float[Array, " 2"]:
        def turning(t, state):
            return model.motion(t, state[0], gait).r

        motion = model.motion(t, state[0], gait)
        rates = model.rates(t, state, gait)
        turn = jax.jvp(turning, (t, state), (jnp.ones(()), jax.tree.map(jnp.asarray, rates)))[1]
        steering = 2 * model.board.wheelset_inertia * motion.steering.acceleration
        return jnp.stack([steering, model.board.rotor_inertia * (motion.rotor.acceleration + turn)])

    return jax.vmap(at)(ran.command_times, ran.state)


def effort(times: Float[Array, " n"], torque: Float[Array, "n 2"]) -> Scalar:
    """The integral of the squared joint torques [N^2 m^2 s], by the trapezoidal rule."""
    return jnp.trapezoid(jnp.sum(torque**2, axis=1), times)
