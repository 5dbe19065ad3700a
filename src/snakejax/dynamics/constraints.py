"""Constraints of the wheels: state, velocities and equations of motion of a vehicle with slipping or fixed wheels.

Each constraint defines a state, the velocities that follow from it, and Newton's law or its constrained counterpart.
With two wheelsets at l_f > 0 and l_b < 0 ahead of the centre of mass [m], at the angles phi_f and phi_b [rad],

    D = (tan phi_f - tan phi_b) / (l_f - l_b)      W = tan phi_f - l_f D

so that without slip the lateral speed is w = W u and the yaw rate r = D u.
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar

from .contact import AppliedForces, Velocities, WheelAngles
from .inputs import Gait
from .vehicle import AbstractVehicle

State = tuple[Scalar, ...]


ACROSS = 0.01
"""Least cos(phi) of a wheelset without slip, at 0.6 degrees from 90: the no-slip equations are singular at 90."""


LATERAL_SLIP_SWITCH = "lateral_skid"
"""Name in a diagnosis of the change from constrained wheels to independently slipping wheelsets."""


class NoSlip(NamedTuple):
    """W [-] and D [1/m] of a pair of wheelsets without slip, and their rates [1/s], [1/(m s)]."""

    W: Scalar
    D: Scalar
    W_rate: Scalar
    D_rate: Scalar

    @staticmethod
    def of(board: AbstractVehicle, steered: WheelAngles) -> "NoSlip":
        """W and D from the wheel angles by the equations of the module; NaN if cos(phi) <= `ACROSS` for a wheelset."""
        front, back = board.arm(board.wheelsets[0]), board.arm(board.wheelsets[1])
        # At 90 degrees the wheelset allows only sideways motion, which tan(phi) u cannot express. A solver could step
        # over the pole, so angles beyond it are excluded too.
        cosines = [jnp.where(c > ACROSS, c, jnp.nan) for c in steered.cosines]
        tangents = [s / c for s, c in zip(steered.sines, cosines, strict=True)]
        rates = [j.rate / c**2 for j, c in zip(steered.joints, cosines, strict=True)]
        D = (tangents[0] - tangents[1]) / (front - back)
        D_rate = (rates[0] - rates[1]) / (front - back)
        return NoSlip(tangents[0] - front * D, D, rates[0] - front * D_rate, D_rate)


def body_velocities(pose: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(x, y, heading, u, w, r) (n, 6) [m, m, rad, m/s, m/s, rad/s] from the pose (n, 3) and its rate (n, 3)."""
    heading = pose[:, 2]
    u = rate[:, 0] * np.cos(heading) + rate[:, 1] * np.sin(heading)
    w = rate[:, 1] * np.cos(heading) - rate[:, 0] * np.sin(heading)
    return np.stack([pose[:, 0], pose[:, 1], heading, u, w, rate[:, 2]], axis=1)


class AbstractConstraint(eqx.Module):
    """A constraint (structure): the meaning of the state, and its rate of change.

    `slips`: whether wheels may slip sideways. `tyre_acts`: whether the tyre force changes the motion. `frees_wheels`:
    whether each wheelset slips independently, at any steering angle. `allows_offset`: whether the centre of mass may be
    off the middle of the board.
    """

    slips: ClassVar[bool] = True
    tyre_acts: ClassVar[bool] = True
    frees_wheels: ClassVar[bool] = False
    allows_offset: ClassVar[bool] = True

    @abc.abstractmethod
    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        """The state at rest at (x [m], y [m], heading [rad])."""

    @abc.abstractmethod
    def in_motion(self, start: State, board: AbstractVehicle, steered: WheelAngles) -> State:
        """The state from six numbers: (x, y, heading, u, w, r), or (x, y, heading, u, beta, s) under `Coupled`."""

    @abc.abstractmethod
    def twist(self, state: State, board: AbstractVehicle, steered: WheelAngles) -> Velocities:
        """Position and velocities of the body and the wheelsets in this state."""

    @abc.abstractmethod
    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        """(x [m], y [m], heading [rad]) as motion capture measures them."""

    def observed(
        self,
        times: Float[np.ndarray, " n"],
        pose: Float[np.ndarray, "n 3"],
        rate: Float[np.ndarray, "n 3"],
        board: AbstractVehicle,
        gait: Gait,
    ) -> Float[np.ndarray, "n 6"]:
        """First guess of the six numbers of `in_motion` at `times` [s], from measured pose [m, m, rad] and its rate.

        By default (x, y, heading, u, w, r).
        """
        del times, board, gait
        return body_velocities(pose, rate)

    @abc.abstractmethod
    def corrected(self, state: State, pose: State, rate: State) -> State:
        """`state` with the given (x, y, heading) and their rates; components that these do not determine stay."""

    @abc.abstractmethod
    def rates(
        self, state: State, board: AbstractVehicle, steered: WheelAngles, twist: Velocities, loads: AppliedForces
    ) -> State:
        """The time derivative of the state under the forces `loads`."""

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        """The reason why this constraint does not apply to `board`, or None if it applies."""
        if len(board.wheelsets) != 2:
            return f"{type(self).__name__} needs two wheelsets, but the board has {len(board.wheelsets)}."
        return None


class Slipping(AbstractConstraint):
    """Every wheelset slips independently: Newton's law of a planar rigid body, without lateral constraint.

    State (x, y, theta, u, w, r), wheelset i at l_i ahead of the centre of mass:

        v_i = -u sin(phi_i) + (w + l_i r) cos(phi_i)     a_i = u cos(phi_i) + (w + l_i r) sin(phi_i)
        X += F_i sin(phi_i) - T_i cos(phi_i)      Y -= F_i cos(phi_i) + T_i sin(phi_i)      N += l_i Y_i
        m (udot - r w) = X      m (wdot + r u) = Y      I rdot + J_r psi'' = N
    """

    frees_wheels: ClassVar[bool] = True

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero)

    def in_motion(self, start: State, board: AbstractVehicle, steered: WheelAngles) -> State:
        del board, steered
        return start

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def twist(self, state: State, board: AbstractVehicle, steered: WheelAngles) -> Velocities:
        x, y, theta, u, w, r = state
        across = [w + board.arm(wheelset) * r for wheelset in board.wheelsets]
        parts = list(zip(across, steered.sines, steered.cosines, strict=True))
        lateral = tuple(-u * s + v * c for v, s, c in parts)
        rolling = tuple(u * c + v * s for v, s, c in parts)
        return Velocities(x, y, theta, theta, u, w, r, lateral, rolling)

    def corrected(self, state: State, pose: State, rate: State) -> State:
        del state
        x, y, heading = pose
        east, north, yaw_rate = rate
        u = east * jnp.cos(heading) + north * jnp.sin(heading)
        w = north * jnp.cos(heading) - east * jnp.sin(heading)
        return (x, y, heading, u, w, yaw_rate)

    def rates(
        self, state: State, board: AbstractVehicle, steered: WheelAngles, twist: Velocities, loads: AppliedForces
    ) -> State:
        del state
        u, w, r = twist.u, twist.w, twist.r
        X, Y, N = loads.wrench
        for wheelset, sine, cosine, F, T in zip(
            board.wheelsets, steered.sines, steered.cosines, loads.traction, loads.resistance, strict=True
        ):
            across = -F * cosine - T * sine
            X, Y, N = X + F * sine - T * cosine, Y + across, N + board.arm(wheelset) * across
        sine, cosine = sine_cosine(twist.theta)
        return (
            u * cosine - w * sine,
            u * sine + w * cosine,
            r,
            X / board.mass + r * w,
            Y / board.mass - r * u,
            (N - board.rotor_inertia * loads.rotor) / board.total_inertia,
        )

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        return None if board.wheelsets else "The board has no wheelsets."


class NonSlipping(AbstractConstraint):
    """No lateral slip: the constraints v_i = 0 hold exactly (paper eq. 3 without beta).

    State (x, y, theta, u) with w = W u, r = D u:

        (m (1 + W^2) + I D^2) udot = -(m W Wdot + I D Ddot) u + X + W Y + D N - D J_r psi'' - sum_i T_i / cos(phi_i)
    """

    slips: ClassVar[bool] = False
    tyre_acts: ClassVar[bool] = False

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        return (x, y, heading, jnp.zeros_like(x))

    def in_motion(self, start: State, board: AbstractVehicle, steered: WheelAngles) -> State:
        del board, steered
        return start[:4]

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def twist(self, state: State, board: AbstractVehicle, steered: WheelAngles) -> Velocities:
        x, y, theta, u = state
        no_slip = NoSlip.of(board, steered)
        rolling = tuple(u / c for c in steered.cosines)
        return Velocities(
            x, y, theta, theta, u, no_slip.W * u, no_slip.D * u, tuple(jnp.zeros_like(u) for _ in rolling), rolling
        )

    def corrected(self, state: State, pose: State, rate: State) -> State:
        del state
        x, y, heading = pose
        return (x, y, heading, rate[0] * jnp.cos(heading) + rate[1] * jnp.sin(heading))

    def rates(
        self, state: State, board: AbstractVehicle, steered: WheelAngles, twist: Velocities, loads: AppliedForces
    ) -> State:
        del state
        u, w = twist.u, twist.w
        W, D, W_rate, D_rate = NoSlip.of(board, steered)
        X, Y, N = loads.wrench
        drag = sum(T / c for c, T in zip(steered.cosines, loads.resistance, strict=True))
        m, I = board.mass, board.total_inertia  # noqa: E741
        push = X + W * Y + D * N - D * board.rotor_inertia * loads.rotor - drag
        u_rate = (push - (m * W * W_rate + I * D * D_rate) * u) / (m * (1 + W**2) + I * D**2)
        sine, cosine = sine_cosine(twist.theta)
        return (u * cosine - w * sine, u * sine + w * cosine, D * u, u_rate)
