"""Constraints of Salman et al., CDC 2016: slip as one further coordinate beta, and the equations as printed."""

from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar
from snakejax.dynamics.constraints import AbstractConstraint, State
from snakejax.dynamics.contact import AppliedForces, Configuration, Velocities
from snakejax.dynamics.inputs import AbstractInputs, as_gait
from snakejax.dynamics.vehicle import AbstractVehicle

from .closed_form import NoSlip, as_board, needs_two_wheelsets


def integrated_angle(
    times: np.ndarray, pose: np.ndarray, rate: np.ndarray, board: AbstractVehicle, gait: AbstractInputs
) -> np.ndarray:
    """First guess of (x, y, heading, u, beta, s) (n, 6) by Euler integration of thetadot = (s + D u)/2.

    s is the measured yaw rate, u = xdot cos(theta) + ydot sin(theta), and theta = heading at the start.
    """
    joints = as_gait(gait)
    heading = pose[:, 2]
    phi = np.asarray(jax.vmap(lambda s: joints.phi.at(s).angle)(jnp.asarray(times)))
    back_signal = joints.phi_back
    back = -phi if back_signal is None else np.asarray(jax.vmap(lambda s: back_signal.at(s).angle)(jnp.asarray(times)))
    D = (np.tan(phi) - np.tan(back)) / (2 * float(as_board(board).half_length))
    theta = np.empty_like(heading)
    theta[0] = heading[0]
    for k in range(len(times)):
        u = rate[k, 0] * np.cos(theta[k]) + rate[k, 1] * np.sin(theta[k])
        if k + 1 < len(times):
            theta[k + 1] = theta[k] + (times[k + 1] - times[k]) * (rate[k, 2] + D[k] * u) / 2
    u = rate[:, 0] * np.cos(theta) + rate[:, 1] * np.sin(theta)
    return np.stack([pose[:, 0], pose[:, 1], heading, u, heading - theta, rate[:, 2]], axis=1)


class SlipAsCoordinate(AbstractConstraint):
    """A structure of the paper: slip is the angle beta between the visible board and the frame of the constraints."""

    def observed(
        self,
        times: np.ndarray,
        pose: np.ndarray,
        rate: np.ndarray,
        board: AbstractVehicle,
        inputs: Callable[[], AbstractInputs],
    ) -> np.ndarray:
        return integrated_angle(times, pose, rate, board, inputs())


class Coupled(SlipAsCoordinate):
    """Slip as one further coordinate beta, with the constraints (3) of the paper kept (after Sidek and Sarkar 2008).

    State (x, y, theta, beta, u, s) with s = thetadot + betadot and D, W as in `dynamics.constraints`:

        xdot = u cos(theta) - w sin(theta)    ydot = u sin(theta) + w cos(theta)    w = W u
        thetadot = (s + D u)/2                betadot = (s - D u)/2
        v_i = L betadot cos(phi_i)            a_i = u / cos(phi_i)                  G = L sum_i cos(phi_i) F_i
        m (1 + W^2) udot = -m W Wdot u + X + W Y + (D/2) G - sum_i T_i / cos(phi_i)
        I sdot = -J_r psi'' - G/2 + N

    The heading is theta + beta. A wheel fixed to the visible body would slip by 2 v_i: this constraint follows the
    paper, not Newton's law of the visible body, which is `Slipping`.
    """

    allows_offset: ClassVar[bool] = False

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero)

    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        del board, steered
        x, y, heading, u, beta, s = start
        return (x, y, heading - beta, beta, u, s)

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        x, y, theta, beta, _, _ = state
        return x, y, theta + beta

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
        x, y, theta, beta, u, s = state
        no_slip = NoSlip.of(board, steered)
        beta_rate = (s - no_slip.D * u) / 2
        lateral = tuple(as_board(board).half_length * beta_rate * c for c in steered.cosines)
        rolling = tuple(u / c for c in steered.cosines)
        return Velocities(x, y, theta, theta + beta, u, no_slip.W * u, s, lateral, rolling)

    def corrected(self, state: State, pose: State, rate: State) -> State:
        x, y, heading = pose
        east, north, yaw_rate = rate
        beta = state[3]
        theta = heading - beta
        return (x, y, theta, beta, east * jnp.cos(theta) + north * jnp.sin(theta), yaw_rate)

    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        del state
        board = as_board(board)
        u, w, s = twist.u, twist.w, twist.r
        W, D, W_rate, _ = NoSlip.of(board, steered)
        X, Y, N = loads.wrench
        cosines = steered.cosines
        G = board.half_length * sum(c * F for c, F in zip(cosines, loads.traction, strict=True))
        drag = sum(T / c for c, T in zip(cosines, loads.resistance, strict=True))
        m, I = board.mass, board.total_inertia  # noqa: E741
        u_rate = (-m * W * W_rate * u + X + W * Y + D / 2 * G - drag) / (m * (1 + W**2))
        s_rate = (-board.rotor_inertia * steered.inputs["psi"].acceleration - G / 2 + N) / I
        sine, cosine = sine_cosine(twist.theta)
        return (
            u * cosine - w * sine,
            u * sine + w * cosine,
            (s + D * u) / 2,
            (s - D * u) / 2,
            u_rate,
            s_rate,
        )

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        places = tuple(wheelset.place for wheelset in board.wheelsets)
        if places != (1.0, -1.0):
            return f"The coupled structure needs wheelsets at +L and -L, but they are at {places} half lengths."
        return None


class Printed(SlipAsCoordinate):
    """Equations (2) to (4) of the paper as printed, to show that a board at rest does not move under them.

    State (x, y, theta, beta, xdot, ydot, thetadot, betadot). With F_1 and F_2 along the constraint directions,

        M qddot = tau + A^T (lambda - F)        A qddot = -Adot qdot

    is solved for the four accelerations and the two multipliers. lambda compensates F, so the motion does not depend on
    the tyre, and a board at rest stays at rest.
    """

    tyre_acts: ClassVar[bool] = False
    allows_offset: ClassVar[bool] = False

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero, zero, zero)

    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        x, y, heading, u, beta, s = start
        theta = heading - beta
        W, D, _, _ = NoSlip.of(board, steered)
        cosine, sine = jnp.cos(theta), jnp.sin(theta)
        x_rate, y_rate = u * (cosine - W * sine), u * (sine + W * cosine)
        return (x, y, theta, beta, x_rate, y_rate, (s + D * u) / 2, (s - D * u) / 2)

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[0], state[1], state[2] + state[3]

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
        x, y, theta, beta, x_rate, y_rate, theta_rate, beta_rate = state
        cosine, sine = jnp.cos(theta), jnp.sin(theta)
        u, w = x_rate * cosine + y_rate * sine, y_rate * cosine - x_rate * sine
        across = [w + as_board(board).arm(wheelset) * (theta_rate - beta_rate) for wheelset in board.wheelsets]
        lateral = tuple(as_board(board).half_length * beta_rate * c for c in steered.cosines)
        rolling = tuple(u * c + v * s for v, s, c in zip(across, steered.sines, steered.cosines, strict=True))
        return Velocities(x, y, theta, theta + beta, u, w, theta_rate + beta_rate, lateral, rolling)

    def corrected(self, state: State, pose: State, rate: State) -> State:
        beta, beta_rate = state[3], state[7]
        return (pose[0], pose[1], pose[2] - beta, beta, rate[0], rate[1], rate[2] - beta_rate, beta_rate)

    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        x_rate, y_rate, theta_rate, beta_rate = state[4:]
        board = as_board(board)
        m, I = board.mass, board.total_inertia  # noqa: E741
        rows, coupling, drags = [], [], []
        for wheelset, joint, T in zip(board.wheelsets, steered.joints, loads.resistance, strict=True):
            total, rate = twist.theta + joint.angle, theta_rate + joint.rate
            arm = board.arm(wheelset)
            rows.append([-jnp.sin(total), jnp.cos(total), arm * jnp.cos(joint.angle), -arm * jnp.cos(joint.angle)])
            coupling.append(
                -rate * (jnp.cos(total) * x_rate + jnp.sin(total) * y_rate)
                - arm * jnp.sin(joint.angle) * joint.rate * (theta_rate - beta_rate)
            )
            turn = arm * jnp.sin(joint.angle)
            drags.append([T * jnp.cos(total), T * jnp.sin(total), T * turn, -T * turn])
        A = jnp.array(rows)
        zero = jnp.zeros_like(m)
        M = jnp.array([[m, zero, zero, zero], [zero, m, zero, zero], [zero, zero, I, I], [zero, zero, I, I]])
        X, Y, N = loads.wrench
        cosine, sine = jnp.cos(twist.theta), jnp.sin(twist.theta)
        yaw = N - board.rotor_inertia * steered.inputs["psi"].acceleration
        applied = jnp.array([X * cosine - Y * sine, X * sine + Y * cosine, yaw, yaw]) - jnp.sum(
            jnp.array(drags), axis=0
        )
        saddle = jnp.block([[M, -A.T], [A, jnp.zeros((2, 2))]])
        right = jnp.concatenate([applied - A.T @ jnp.array(loads.traction), -jnp.array(coupling)])
        accelerations = jnp.linalg.solve(saddle, right)
        return (x_rate, y_rate, theta_rate, beta_rate, *(accelerations[k] for k in range(4)))

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        return needs_two_wheelsets(self, board)
