"""Constraints of the snakeboard in closed form: those of `dynamics.constraints` for two wheelsets and a rotor.

With two wheelsets at l_f > 0 and l_b < 0 ahead of the centre of mass [m], at the angles phi_f and phi_b [rad],

    D = (tan phi_f - tan phi_b) / (l_f - l_b)      W = tan phi_f - l_f D

so that without slip the lateral speed is w = W u and the yaw rate r = D u. The general equations, which follow from the
declaration of the board, give the same rates; these cost less.
"""

from typing import TYPE_CHECKING, NamedTuple, cast

import jax.numpy as jnp

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping, State
from snakejax.dynamics.contact import AppliedForces, Configuration, Velocities
from snakejax.dynamics.vehicle import AbstractVehicle

if TYPE_CHECKING:
    from .board import Board


ACROSS = 0.01
"""Least cos(phi) of a wheelset without slip, at 0.6 degrees from 90: the no-slip equations are singular at 90."""


def as_board(vehicle: AbstractVehicle) -> "Board":
    """`vehicle`, which is a snakeboard, for the type checker."""
    return cast("Board", vehicle)


def needs_two_wheelsets(constraint: AbstractConstraint, board: AbstractVehicle) -> str | None:
    """The reason why a constraint of two wheelsets does not apply to `board`, or None."""
    if len(board.wheelsets) != 2:
        return f"{type(constraint).__name__} needs two wheelsets, but the board has {len(board.wheelsets)}."
    return None


class NoSlip(NamedTuple):
    """W [-] and D [1/m] of a pair of wheelsets without slip, and their rates [1/s], [1/(m s)]."""

    W: Scalar
    D: Scalar
    W_rate: Scalar
    D_rate: Scalar

    @staticmethod
    def of(vehicle: AbstractVehicle, steered: Configuration) -> "NoSlip":
        """W and D from the wheel angles by the equations of the module; NaN if cos(phi) <= `ACROSS` for a wheelset."""
        board = as_board(vehicle)
        front, back = board.arm(board.wheelsets[0]), board.arm(board.wheelsets[1])
        # At 90 degrees the wheelset allows only sideways motion, which tan(phi) u cannot express. A solver could step
        # over the pole, so angles beyond it are excluded too.
        cosines = [jnp.where(c > ACROSS, c, jnp.nan) for c in steered.cosines]
        tangents = [s / c for s, c in zip(steered.sines, cosines, strict=True)]
        rates = [j.rate / c**2 for j, c in zip(steered.joints, cosines, strict=True)]
        D = (tangents[0] - tangents[1]) / (front - back)
        D_rate = (rates[0] - rates[1]) / (front - back)
        return NoSlip(tangents[0] - front * D, D, rates[0] - front * D_rate, D_rate)


class SlippingBoard(Slipping):
    """Every wheelset slips independently: Newton's law of a planar rigid body, without lateral constraint.

    State (x, y, theta, u, w, r), wheelset i at l_i ahead of the centre of mass:

        v_i = -u sin(phi_i) + (w + l_i r) cos(phi_i)     a_i = u cos(phi_i) + (w + l_i r) sin(phi_i)
        X += F_i sin(phi_i) - T_i cos(phi_i)      Y -= F_i cos(phi_i) + T_i sin(phi_i)      N += l_i Y_i
        m (udot - r w) = X      m (wdot + r u) = Y      I rdot + J_r psi'' = N
    """

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
        x, y, theta, u, w, r = state
        board = as_board(board)
        across = [w + board.arm(wheelset) * r for wheelset in board.wheelsets]
        parts = list(zip(across, steered.sines, steered.cosines, strict=True))
        lateral = tuple(-u * s + v * c for v, s, c in parts)
        rolling = tuple(u * c + v * s for v, s, c in parts)
        return Velocities(x, y, theta, theta, u, w, r, lateral, rolling)

    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        del state
        board = as_board(board)
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
            (N - board.rotor_inertia * steered.inputs["psi"].acceleration) / board.total_inertia,
        )


class NonSlippingBoard(NonSlipping):
    """No lateral slip: the constraints v_i = 0 hold exactly (paper eq. 3 without beta).

    State (x, y, theta, u) with w = W u, r = D u:

        (m (1 + W^2) + I D^2) udot = -(m W Wdot + I D Ddot) u + X + W Y + D N - D J_r psi'' - sum_i T_i / cos(phi_i)
    """

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        return (x, y, heading, jnp.zeros_like(x))

    def completed(self, state: State, board: AbstractVehicle) -> State:
        del board
        return state

    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        del board, steered
        return start[:4]

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
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
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        del state
        board = as_board(board)
        u, w = twist.u, twist.w
        W, D, W_rate, D_rate = NoSlip.of(board, steered)
        X, Y, N = loads.wrench
        drag = sum(T / c for c, T in zip(steered.cosines, loads.resistance, strict=True))
        m, I = board.mass, board.total_inertia  # noqa: E741
        push = X + W * Y + D * N - D * board.rotor_inertia * steered.inputs["psi"].acceleration - drag
        u_rate = (push - (m * W * W_rate + I * D * D_rate) * u) / (m * (1 + W**2) + I * D**2)
        sine, cosine = sine_cosine(twist.theta)
        return (u * cosine - w * sine, u * sine + w * cosine, D * u, u_rate)

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        return needs_two_wheelsets(self, board)
