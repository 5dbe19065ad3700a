"""Vehicle: masses, inertias and positions of the wheelsets, as used by the equations of motion."""

import abc
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx

from snakejax.core.parameter import Parametrised, Scalar

if TYPE_CHECKING:
    from .constraints import AbstractConstraint


class Wheelset(eqx.Module):
    """Position of a wheelset on the body axis, in half lengths ahead of the middle, and factor of its steering angle.

    The front wheelset of the snakeboard is `Wheelset(1, 1)`, its back wheelset `Wheelset(-1, -1)`: phi_back = -phi.
    """

    place: float
    steering: float


class AbstractVehicle(Parametrised):
    """A planar vehicle: one rigid body on steered wheelsets, with a rotor.

    `mass` [kg]; `rotor_inertia`, `wheelset_inertia` [kg m^2]; `half_length` [m]; `creep_speed` [m/s]: regularises the
    slip angle at rest; `offset` [m] of the centre of mass; `kind`: its name in results; `structures`: possible
    constraints of its wheels, by name; `relaxed`: maps a structure that constrains the wheels to the one with
    independently slipping wheelsets.
    """

    mass: eqx.AbstractVar[Scalar]
    rotor_inertia: eqx.AbstractVar[Scalar]
    wheelset_inertia: eqx.AbstractVar[Scalar]
    half_length: eqx.AbstractVar[Scalar]
    creep_speed: eqx.AbstractVar[Scalar]
    offset: eqx.AbstractVar[Scalar]
    wheelsets: eqx.AbstractVar[tuple[Wheelset, ...]]
    kind: ClassVar[str]
    structures: ClassVar[dict[str, type["AbstractConstraint"]]]
    relaxed: ClassVar[dict[str, str]] = {}

    @property
    @abc.abstractmethod
    def total_inertia(self) -> Scalar:
        """Yaw inertia of the whole vehicle about its centre of mass [kg m^2]."""

    @abc.abstractmethod
    def arm(self, wheelset: Wheelset) -> Scalar:
        """Distance [m] of a wheelset ahead of the centre of mass."""

    @abc.abstractmethod
    def with_payload(self, mass: Scalar, inertia: Scalar) -> Self:
        """The vehicle with a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] at its centre of mass."""
