"""Roller racer: two bodies on wheels, joined by a handlebar that propels them."""

from typing import ClassVar, Self

import equinox as eqx

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.vehicle import AbstractVehicle, Angles, Body, Placement, Stroke, Wheelset, axle_outline
from snakejax.dynamics.vehicle_input import Input


class RollerRacer(AbstractVehicle):
    """Two bodies in a joint, each with one axle of free wheels (Krishnaprasad and Tsakiris 2001).

    The seat, whose centre of mass is the measured point, has its axle `rear` [m] behind it and the joint `pivot` [m]
    ahead. The handlebar, turned by the input `handle` [rad], has its centre of mass on its own axle, `front` [m] from
    the joint. Swinging it from side to side drives the racer: without slip its motion follows from the angle alone.
    """

    kind: ClassVar[str] = "roller_racer"
    noun: ClassVar[str] = "racer"
    inputs: ClassVar[tuple[Input, ...]] = (Input("handle", "angle", "handlebar"),)
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {"free": Slipping, "ideal": NonSlipping}
    relaxed: ClassVar[dict[str, str]] = {"ideal": "free"}
    stated_sd: ClassVar[dict[str, float]] = {
        "seat_mass": 0.03,
        "pivot": 0.01,
        "front": 0.01,
        "inertia": 0.07,
        "handle_inertia": 0.07,
    }

    seat_mass: Scalar = param("kg", positive=True, meaning="mass of the seat")
    inertia: Scalar = param("kg m^2", positive=True, meaning="yaw inertia of the seat about its centre of mass")
    handle_mass: Scalar = param("kg", low=0.0, meaning="mass of the handlebar")
    handle_inertia: Scalar = param("kg m^2", positive=True, meaning="yaw inertia of the handlebar about its axle")
    pivot: Scalar = param("m", positive=True, meaning="distance of the joint ahead of the seat's centre of mass")
    front: Scalar = param("m", positive=True, meaning="distance of the handlebar's axle from the joint")
    rear: Scalar = param("m", low=0.0, default=0.0, meaning="distance of the seat's axle behind its centre of mass")
    creep_speed: Scalar = param("m/s", positive=True, default=0.01, meaning="speed below which slip is smoothed")
    wheelsets: tuple[Wheelset, ...] = (
        Wheelset(1.0, name="front", axle="front"),
        Wheelset(-1.0, name="rear", axle="rear"),
    )

    @property
    def mass(self) -> Scalar:  # type: ignore[override]
        """Mass of seat and handlebar [kg]."""
        return self.seat_mass + self.handle_mass

    @property
    def total_inertia(self) -> Scalar:
        """Yaw inertia of both about the seat's centre of mass, the handlebar straight [kg m^2]."""
        return self.inertia + self.handle_inertia + self.handle_mass * (self.pivot + self.front) ** 2

    @property
    def length(self) -> Scalar:
        """Half the distance between the axles [m]."""
        return (self.pivot + self.front + self.rear) / 2

    def _front(self, angles: Angles) -> tuple[Scalar, Scalar]:
        sine, cosine = sine_cosine(angles["handle"])
        return self.pivot + self.front * cosine, self.front * sine

    def bodies(self, angles: Angles) -> tuple[Body, ...]:
        """Seat and handlebar."""
        x, y = self._front(angles)
        return Body(self.seat_mass, self.inertia), Body(self.handle_mass, self.handle_inertia, x, y, angles["handle"])

    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """The axle of the seat, or that of the handlebar."""
        if wheelset.axle == "rear":
            return Placement(-self.rear)
        return Placement(*self._front(angles), angles["handle"])

    def with_payload(self, mass: Scalar, inertia: Scalar) -> Self:
        """The racer with a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] on its seat."""
        return eqx.tree_at(lambda c: (c.seat_mass, c.inertia), self, (self.seat_mass + mass, self.inertia + inertia))

    def outline(self) -> tuple[Stroke, ...]:
        """Seat and handlebar as bars."""
        pivot = float(self.pivot)
        seat = Stroke(((-float(self.rear), 0.0), (pivot, 0.0)))
        return seat, Stroke(((0.0, 0.0), (float(self.front), 0.0)), "handle", (pivot, 0.0))

    def wheel_outline(self, wheelset: Wheelset) -> tuple[Stroke, ...]:
        """An axle with two wheels."""
        del wheelset
        return axle_outline(float(self.length), 0.3 * float(self.length))


ROLLER_RACER = dict(seat_mass=1.0, inertia=1.0, handle_mass=0.0, handle_inertia=1.0, pivot=1.0, front=0.5)
"""A racer of unit mass and inertia with a light handlebar, as in Krishnaprasad and Tsakiris 2001."""
