"""Snakeboard: masses, inertias, positions of the wheelsets, and possible constraints of the wheels."""

from typing import ClassVar, Self

import equinox as eqx

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.vehicle import AbstractVehicle, Wheelset

from .paper_constraints import Coupled, Printed


class Board(AbstractVehicle):
    """A board on two steered wheelsets, with a rotor (Salman et al., CDC 2016, section II, Table II).

    `inertia`: total yaw inertia with rotor and wheelsets, I = J + J_r + 2 J_w; if it is None the assumption of the
    paper, I = m L^2, is used. `offset`: distance of the centre of mass ahead of the middle. `creep_speed`: eps of the
    slip angle (`slip_angle`); the default 1 mm/s is far below any measured speed.
    """

    kind: ClassVar[str] = "snakeboard"
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {
        "coupled": Coupled,
        "free": Slipping,
        "ideal": NonSlipping,
        "printed": Printed,
    }
    relaxed: ClassVar[dict[str, str]] = {"coupled": "free"}

    mass: Scalar = param("kg", positive=True)
    rotor_inertia: Scalar = param("kg m^2", low=0.0)
    wheelset_inertia: Scalar = param("kg m^2", low=0.0)
    half_length: Scalar = param("m", positive=True)
    creep_speed: Scalar = param("m/s", positive=True, default=1e-3)
    inertia: Scalar | None = param("kg m^2", positive=True, default=None)
    offset: Scalar = param("m", default=0.0)
    wheelsets: tuple[Wheelset, ...] = (Wheelset(1.0, 1.0), Wheelset(-1.0, -1.0))

    @property
    def total_inertia(self) -> Scalar:
        """Yaw inertia I [kg m^2]: `inertia`, or m L^2 if that is None."""
        return self.mass * self.half_length**2 if self.inertia is None else self.inertia

    def arm(self, wheelset: Wheelset) -> Scalar:
        """Distance [m] of a wheelset ahead of the centre of mass."""
        return wheelset.place * self.half_length - self.offset

    def with_payload(self, mass: Scalar, inertia: Scalar) -> Self:
        """The board with a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] at its centre of mass."""
        return eqx.tree_at(
            lambda b: (b.mass, b.inertia),
            self,
            (self.mass + mass, self.total_inertia + inertia),
            is_leaf=lambda leaf: leaf is None,
        )


TABLE_II = dict(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25)
"""The robot of Salman et al. 2016, Table II: m [kg], J_r and J_w [kg m^2], L [m]."""
