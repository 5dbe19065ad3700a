"""Constraints of the wheels: state, velocities and equations of motion of a vehicle with slipping or fixed wheels.

Each constraint defines a state, the velocities that follow from it, and Newton's law or its constrained counterpart;
the equations follow from the declaration of the vehicle, see `multibody`.
"""

import abc
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar

from .contact import AppliedForces, Configuration, Velocities
from .inputs import AbstractInputs
from .multibody import Phase, Vector, accelerations, balance, held_velocities, phase_of, solved, wheel_velocities
from .signals import Joint
from .vehicle import AbstractVehicle

State = tuple[Scalar, ...]


LATERAL_SLIP_SWITCH = "lateral_skid"
"""Name in a diagnosis of the change from constrained wheels to independently slipping wheelsets."""


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
    off the middle of a snakeboard.
    """

    slips: ClassVar[bool] = True
    tyre_acts: ClassVar[bool] = True
    frees_wheels: ClassVar[bool] = False
    allows_offset: ClassVar[bool] = True

    @abc.abstractmethod
    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        """The state at rest at (x [m], y [m], heading [rad])."""

    def completed(self, state: State, board: AbstractVehicle) -> State:
        """`state` at rest as `from_rest` gives it, with the further numbers that `board` needs."""
        del board
        return state

    @abc.abstractmethod
    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        """The state from six numbers: (x, y, heading, u, w, r), or (x, y, heading, u, beta, s) under `Coupled`."""

    @abc.abstractmethod
    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
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
        inputs: Callable[[], AbstractInputs],
    ) -> Float[np.ndarray, "n 6"]:
        """First guess of the six numbers of `in_motion` at `times` [s], from measured pose [m, m, rad] and its rate.

        By default (x, y, heading, u, w, r), which need no `inputs`: these take time to make where commands lag.
        """
        del times, board, inputs
        return body_velocities(pose, rate)

    @abc.abstractmethod
    def corrected(self, state: State, pose: State, rate: State) -> State:
        """`state` with the given (x, y, heading) and their rates; components that these do not determine stay."""

    @abc.abstractmethod
    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        """The time derivative of the state under the forces `loads`."""

    def free_joints(self, state: State, board: AbstractVehicle) -> dict[str, Joint]:
        """Angle and rate of the free joints by name; their acceleration is not known before the forces, and zero."""
        del state, board
        return {}

    def inapplicable_because(self, board: AbstractVehicle) -> str | None:
        """The reason why this constraint does not apply to `board`, or None if it applies."""
        return None if board.wheelsets else "The vehicle has no wheels."


class Slipping(AbstractConstraint):
    """Every wheel slips independently: Newton's law of planar bodies, without lateral constraint.

    State (x, y, theta, u, w, r, rates of free joints, angles of free joints), with M V' = right as in `multibody`.
    """

    frees_wheels: ClassVar[bool] = True

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        zero = jnp.zeros_like(x)
        return (x, y, heading, zero, zero, zero)

    def completed(self, state: State, board: AbstractVehicle) -> State:
        return (*state, *(jnp.zeros_like(state[0]) for _ in range(2 * len(board.free_joints))))

    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        del steered
        return self.completed(start, board)

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def free_joints(self, state: State, board: AbstractVehicle) -> dict[str, Joint]:
        count = len(board.free_joints)
        rates, angles = state[6 : 6 + count], state[6 + count :]
        return {
            name: Joint(angle, rate, jnp.zeros_like(angle))
            for name, angle, rate in zip(board.free_joints, angles, rates, strict=True)
        }

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
        x, y, theta, u, w, r = state[:6]
        V = state[3 : 6 + len(board.free_joints)]
        lateral, rolling = wheel_velocities(board, V, phase_of(board, steered)[0])
        return Velocities(x, y, theta, theta, u, w, r, lateral, rolling)

    def corrected(self, state: State, pose: State, rate: State) -> State:
        x, y, heading = pose
        east, north, yaw_rate = rate
        u = east * jnp.cos(heading) + north * jnp.sin(heading)
        w = north * jnp.cos(heading) - east * jnp.sin(heading)
        return (x, y, heading, u, w, yaw_rate, *state[6:])

    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        V = state[3 : 6 + len(board.free_joints)]
        sine, cosine = sine_cosine(twist.theta)
        u, w, r = V[:3]
        moved = accelerations(balance(board, V, steered, loads))
        return (u * cosine - w * sine, u * sine + w * cosine, r, *moved, *V[3:])


class NonSlipping(AbstractConstraint):
    """No slip: every wheel's held velocity is zero (`Wheelset.holds`), so V = S s + c with s the `independent` ones.

    State (x, y, theta, s, angles of free joints), and with M and the right side of `multibody`

        S^T M S s' = S^T (right - M (S' s + c'))
    """

    slips: ClassVar[bool] = False
    tyre_acts: ClassVar[bool] = False

    def from_rest(self, x: Scalar, y: Scalar, heading: Scalar) -> State:
        return (x, y, heading)

    def completed(self, state: State, board: AbstractVehicle) -> State:
        return (*state, *(jnp.zeros_like(state[0]) for _ in (*board.independent, *board.free_joints)))

    def in_motion(self, start: State, board: AbstractVehicle, steered: Configuration) -> State:
        del steered
        known: dict[str, Scalar] = dict(zip(("u", "w", "r"), start[3:], strict=True))
        zero = jnp.zeros_like(start[0])
        free = (known.get(name, zero) for name in board.independent)
        return (*start[:3], *free, *(zero for _ in board.free_joints))

    def pose(self, state: State) -> tuple[Scalar, Scalar, Scalar]:
        return state[:3]  # type: ignore[return-value]

    def free_joints(self, state: State, board: AbstractVehicle) -> dict[str, Joint]:
        angles = state[3 + len(board.independent) :]
        independent: dict[str, Scalar] = dict(zip(board.independent, state[3:], strict=False))
        zero = jnp.zeros_like(state[0])
        return {
            name: Joint(angle, independent.get(name, zero), zero)
            for name, angle in zip(board.free_joints, angles, strict=True)
        }

    def velocities(self, board: AbstractVehicle, free: Vector, phase: Phase, like: Scalar) -> Vector:
        """All velocities (u, w, r, rates of free joints) where the independent ones are `free`."""
        return held_velocities(board, free, phase, like)

    def twist(self, state: State, board: AbstractVehicle, steered: Configuration) -> Velocities:
        x, y, theta = state[:3]
        phase, _ = phase_of(board, steered)
        V = self.velocities(board, self._free(state, board), phase, x)
        lateral, rolling = wheel_velocities(board, V, phase)
        return Velocities(x, y, theta, theta, V[0], V[1], V[2], lateral, rolling)

    def corrected(self, state: State, pose: State, rate: State) -> State:
        del rate
        return (*pose, *state[3:])

    def rates(
        self, state: State, board: AbstractVehicle, steered: Configuration, twist: Velocities, loads: AppliedForces
    ) -> State:
        phase, change = phase_of(board, steered)
        s = self._free(state, board)

        def velocities(s: Vector, phase: Phase) -> Vector:
            return self.velocities(board, s, phase, twist.x)

        V = velocities(s, phase)
        zeros = tuple(jnp.zeros_like(part) for part in s)
        drift = jax.jvp(velocities, (s, phase), (zeros, change))[1]
        columns = [jax.jvp(velocities, (s, phase), (e, _still(phase)))[1] for e in _unit(s)]
        balanced = balance(board, V, steered, loads)
        pushed = [
            right - sum((m * a for m, a in zip(row, drift, strict=True)), jnp.zeros(()))
            for row, right in zip(balanced.mass, balanced.right, strict=True)
        ]
        projected = [[_product(i, balanced.mass, j) for j in columns] for i in columns]
        work = [[sum((a * q for a, q in zip(i, pushed, strict=True)), jnp.zeros(()))] for i in columns]
        moved = solved(projected, work)[0] if s else ()
        sine, cosine = sine_cosine(twist.theta)
        u, w, r = V[:3]
        return (u * cosine - w * sine, u * sine + w * cosine, r, *moved, *V[3:])

    @staticmethod
    def _free(state: State, board: AbstractVehicle) -> Vector:
        return state[3 : 3 + len(board.independent)]


def _product(left: Vector, matrix: tuple[Vector, ...], right: Vector) -> Scalar:
    rows = [sum((m * b for m, b in zip(row, right, strict=True)), jnp.zeros(())) for row in matrix]
    return sum((a * row for a, row in zip(left, rows, strict=True)), jnp.zeros(()))


def _unit(s: Vector) -> list[Vector]:
    return [
        tuple(jnp.ones_like(part) if j == k else jnp.zeros_like(part) for j, part in enumerate(s))
        for k in range(len(s))
    ]


def _still(phase: Phase) -> Phase:
    return jax.tree.map(jnp.zeros_like, phase)
