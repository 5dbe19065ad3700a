"""Skid structures: how a board that may skid moves, given the forces on it.

Each structure is a state, the motion that follows from it, and Newton's law or its constrained counterpart.
With two wheelsets at l_f > 0 and l_b < 0 ahead of the centre of mass, steered phi_f and phi_b,

    D = (tan phi_f - tan phi_b) / (l_f - l_b)      W = tan phi_f - l_f D

so that a board that does not slip has lateral speed w = W u and yaw rate r = D u.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ._board import Board
from ._effect import Wheel, Wrench
from ._gait import Joint
from ._math import sine_cosine
from ._units import Scalar

State = tuple[Scalar, ...]


ACROSS = 0.01
"""Where |cos phi| of a wheelset is less, 0.6 degrees from 90, structures that do not let it slip are singular."""


class Steered(NamedTuple):
    """The wheel angles of one instant, with their sines and cosines."""

    joints: tuple[Joint, ...]
    sines: tuple[Scalar, ...]
    cosines: tuple[Scalar, ...]

    @staticmethod
    def of(joints: tuple[Joint, ...]) -> "Steered":
        """Evaluate sine and cosine once for each wheelset."""
        pairs = [sine_cosine(joint.angle) for joint in joints]
        sines, cosines = tuple(s for s, _ in pairs), tuple(c for _, c in pairs)
        return Steered(joints, sines, cosines)


class Twist(NamedTuple):
    """Where the board is and how it moves: frame angle, heading, body twist, and each wheelset over the floor."""

    x: Scalar
    y: Scalar
    theta: Scalar
    heading: Scalar
    u: Scalar
    w: Scalar
    r: Scalar
    lateral: tuple[Scalar, ...]
    rolling: tuple[Scalar, ...]


class Loads(NamedTuple):
    """What acts on the board: traction and rolling resistance of each wheelset, further wrench, rotor acceleration."""

    wheels: tuple[Wheel, ...]
    traction: tuple[Scalar, ...]
    resistance: tuple[Scalar, ...]
    wrench: Wrench
    rotor: Scalar


class NoSlip(NamedTuple):
    """W and D of a pair of wheelsets and their rates."""

    W: Scalar
    D: Scalar
    W_rate: Scalar
    D_rate: Scalar

    @staticmethod
    def of(board: Board, steered: Steered) -> "NoSlip":
        """From the wheel angles; see the head of this file. NaN where a wheelset stands across the board."""
        front, back = board.arm(board.wheelsets[0]), board.arm(board.wheelsets[1])
        # Across the board a wheelset lets it move sideways alone, and tan(phi) u says nothing of it. A solver may step
        # over the pole unharmed, so that what lies behind is barred too.
        cosines = [jnp.where(c > ACROSS, c, jnp.nan) for c in steered.cosines]
        tangents = [s / c for s, c in zip(steered.sines, cosines, strict=True)]
        rates = [j.rate / c**2 for j, c in zip(steered.joints, cosines, strict=True)]
        D = (tangents[0] - tangents[1]) / (front - back)
        D_rate = (rates[0] - rates[1]) / (front - back)
        return NoSlip(tangents[0] - front * D, D, rates[0] - front * D_rate, D_rate)


class AbstractSkid(eqx.Module):
    """A structure: the meaning of the state and its rates of change."""

    @abc.abstractmethod
    def at_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        """The state of a board that stands still."""

    @abc.abstractmethod
    def under_way(self, start: State, board: Board, steered: Steered) -> State:
        """The state from six numbers: (x, y, heading, u, w, r), or beta [rad] in the place of w under `Coupled`."""

    @abc.abstractmethod
    def twist(self, state: State, board: Board, steered: Steered) -> Twist:
        """The motion of this state."""

    @abc.abstractmethod
    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        """(x, y, heading) as motion capture sees them."""

    @abc.abstractmethod
    def rates(self, state: State, board: Board, steered: Steered, twist: Twist, loads: Loads) -> State:
        """The time derivative of the state."""

    def refusal(self, board: Board) -> str | None:
        """Why this structure cannot carry `board`, or None."""
        if len(board.wheelsets) != 2:
            return f"{type(self).__name__} needs two wheelsets, but the board has {len(board.wheelsets)}."
        return None


class Coupled(AbstractSkid):
    """Skid as one further coordinate beta, with the paper's constraints (3) kept (physics of Sidek and Sarkar 2008).

    State (x, y, theta, beta, u, s) with s = thetadot + betadot and D, W as above:

        xdot = u cos(theta) - w sin(theta)    ydot = u sin(theta) + w cos(theta)    w = W u
        thetadot = (s + D u)/2                betadot = (s - D u)/2
        v_i = L betadot cos(phi_i)            a_i = u / cos(phi_i)                  G = L sum_i cos(phi_i) F_i
        m (1 + W^2) udot = -m W Wdot u + X + W Y + (D/2) G - sum_i T_i / cos(phi_i)
        I sdot = -J_r psi'' - G/2 + N

    The heading is theta + beta. A wheel fixed to the visible body would slip twice v_i: this is the paper's structure,
    not Newton's; `Free` is Newton's.
    """

    def at_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero)

    def under_way(self, start: State, board: Board, steered: Steered) -> State:
        del board, steered
        x, y, heading, u, beta, s = start
        return (x, y, heading - beta, beta, u, s)

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        x, y, theta, beta, _, _ = state
        return x, y, theta + beta

    def twist(self, state: State, board: Board, steered: Steered) -> Twist:
        x, y, theta, beta, u, s = state
        no_slip = NoSlip.of(board, steered)
        beta_rate = (s - no_slip.D * u) / 2
        lateral = tuple(board.half_length * beta_rate * c for c in steered.cosines)
        rolling = tuple(u / c for c in steered.cosines)
        return Twist(x, y, theta, theta + beta, u, no_slip.W * u, s, lateral, rolling)

    def rates(self, state: State, board: Board, steered: Steered, twist: Twist, loads: Loads) -> State:
        del state
        u, w, s = twist.u, twist.w, twist.r
        W, D, W_rate, _ = NoSlip.of(board, steered)
        X, Y, N = loads.wrench
        cosines = steered.cosines
        G = board.half_length * sum(c * F for c, F in zip(cosines, loads.traction, strict=True))
        drag = sum(T / c for c, T in zip(cosines, loads.resistance, strict=True))
        m, I = board.mass, board.total_inertia  # noqa: E741
        u_rate = (-m * W * W_rate * u + X + W * Y + D / 2 * G - drag) / (m * (1 + W**2))
        s_rate = (-board.rotor_inertia * loads.rotor - G / 2 + N) / I
        sine, cosine = sine_cosine(twist.theta)
        return (
            u * cosine - w * sine,
            u * sine + w * cosine,
            (s + D * u) / 2,
            (s - D * u) / 2,
            u_rate,
            s_rate,
        )

    def refusal(self, board: Board) -> str | None:
        places = tuple(wheelset.place for wheelset in board.wheelsets)
        if places != (1.0, -1.0):
            return f"The coupled structure needs wheelsets at +L and -L, but they are at {places} half lengths."
        return None


class Free(AbstractSkid):
    """Each wheelset skids on its own; Newton's law with no lateral constraint (physics of a rigid body on two wheels).

    State (x, y, theta, u, w, r), wheelset i at l_i ahead of the centre of mass:

        v_i = -u sin(phi_i) + (w + l_i r) cos(phi_i)     a_i = u cos(phi_i) + (w + l_i r) sin(phi_i)
        X += F_i sin(phi_i) - T_i cos(phi_i)      Y -= F_i cos(phi_i) + T_i sin(phi_i)      N += l_i Y_i
        m (udot - r w) = X      m (wdot + r u) = Y      I rdot + J_r psi'' = N
    """

    def at_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero)

    def under_way(self, start: State, board: Board, steered: Steered) -> State:
        del board, steered
        return start

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def twist(self, state: State, board: Board, steered: Steered) -> Twist:
        x, y, theta, u, w, r = state
        across = [w + board.arm(wheelset) * r for wheelset in board.wheelsets]
        parts = list(zip(across, steered.sines, steered.cosines, strict=True))
        lateral = tuple(-u * s + v * c for v, s, c in parts)
        rolling = tuple(u * c + v * s for v, s, c in parts)
        return Twist(x, y, theta, theta, u, w, r, lateral, rolling)

    def rates(self, state: State, board: Board, steered: Steered, twist: Twist, loads: Loads) -> State:
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

    def refusal(self, board: Board) -> str | None:
        return None if board.wheelsets else "The board has no wheelsets."


class Ideal(AbstractSkid):
    """The board that does not skid: v_i = 0 held as constraints (paper eq. 3 without beta).

    State (x, y, theta, u) with w = W u, r = D u:

        (m (1 + W^2) + I D^2) udot = -(m W Wdot + I D Ddot) u + X + W Y + D N - D J_r psi'' - sum_i T_i / cos(phi_i)
    """

    def at_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        return (x, y, heading, jnp.zeros_like(x))

    def under_way(self, start: State, board: Board, steered: Steered) -> State:
        del board, steered
        return start[:4]

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def twist(self, state: State, board: Board, steered: Steered) -> Twist:
        x, y, theta, u = state
        no_slip = NoSlip.of(board, steered)
        rolling = tuple(u / c for c in steered.cosines)
        return Twist(
            x, y, theta, theta, u, no_slip.W * u, no_slip.D * u, tuple(jnp.zeros_like(u) for _ in rolling), rolling
        )

    def rates(self, state: State, board: Board, steered: Steered, twist: Twist, loads: Loads) -> State:
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


class Printed(AbstractSkid):
    """The paper's equations (2) to (4) as printed; they are inert, and this structure is here to show it.

    State (x, y, theta, beta, xdot, ydot, thetadot, betadot). With F_1 and F_2 along the constraint directions,

        M qddot = tau + A^T (lambda - F)        A qddot = -Adot qdot

    is solved for the four accelerations and the two multipliers. lambda absorbs F, so nothing depends on the tyre, and
    a board at rest never leaves its place.
    """

    def at_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero, zero, zero)

    def under_way(self, start: State, board: Board, steered: Steered) -> State:
        x, y, heading, u, beta, s = start
        theta = heading - beta
        W, D, _, _ = NoSlip.of(board, steered)
        cosine, sine = jnp.cos(theta), jnp.sin(theta)
        x_rate, y_rate = u * (cosine - W * sine), u * (sine + W * cosine)
        return (x, y, theta, beta, x_rate, y_rate, (s + D * u) / 2, (s - D * u) / 2)

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[0], state[1], state[2] + state[3]

    def twist(self, state: State, board: Board, steered: Steered) -> Twist:
        x, y, theta, beta, x_rate, y_rate, theta_rate, beta_rate = state
        cosine, sine = jnp.cos(theta), jnp.sin(theta)
        u, w = x_rate * cosine + y_rate * sine, y_rate * cosine - x_rate * sine
        across = [w + board.arm(wheelset) * (theta_rate - beta_rate) for wheelset in board.wheelsets]
        lateral = tuple(board.half_length * beta_rate * c for c in steered.cosines)
        rolling = tuple(u * c + v * s for v, s, c in zip(across, steered.sines, steered.cosines, strict=True))
        return Twist(x, y, theta, theta + beta, u, w, theta_rate + beta_rate, lateral, rolling)

    def rates(self, state: State, board: Board, steered: Steered, twist: Twist, loads: Loads) -> State:
        x_rate, y_rate, theta_rate, beta_rate = state[4:]
        m, I = board.mass, board.total_inertia  # noqa: E741
        rows, turning, drags = [], [], []
        for wheelset, joint, T in zip(board.wheelsets, steered.joints, loads.resistance, strict=True):
            total, rate = twist.theta + joint.angle, theta_rate + joint.rate
            reach = board.arm(wheelset)
            rows.append([-jnp.sin(total), jnp.cos(total), reach * jnp.cos(joint.angle), -reach * jnp.cos(joint.angle)])
            turning.append(
                -rate * (jnp.cos(total) * x_rate + jnp.sin(total) * y_rate)
                - reach * jnp.sin(joint.angle) * joint.rate * (theta_rate - beta_rate)
            )
            turn = reach * jnp.sin(joint.angle)
            drags.append([T * jnp.cos(total), T * jnp.sin(total), T * turn, -T * turn])
        A = jnp.array(rows)
        zero = jnp.zeros_like(m)
        M = jnp.array([[m, zero, zero, zero], [zero, m, zero, zero], [zero, zero, I, I], [zero, zero, I, I]])
        X, Y, N = loads.wrench
        cosine, sine = jnp.cos(twist.theta), jnp.sin(twist.theta)
        yaw = N - board.rotor_inertia * loads.rotor
        applied = jnp.array([X * cosine - Y * sine, X * sine + Y * cosine, yaw, yaw]) - jnp.sum(
            jnp.array(drags), axis=0
        )
        saddle = jnp.block([[M, -A.T], [A, jnp.zeros((2, 2))]])
        right = jnp.concatenate([applied - A.T @ jnp.array(loads.traction), -jnp.array(turning)])
        accelerations = jnp.linalg.solve(saddle, right)
        return (x_rate, y_rate, theta_rate, beta_rate, *(accelerations[k] for k in range(4)))


SKIDS: dict[str, type[AbstractSkid]] = {"coupled": Coupled, "free": Free, "ideal": Ideal, "printed": Printed}
