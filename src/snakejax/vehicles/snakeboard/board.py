"""Snakeboard: masses, inertias, positions of the wheelsets, and possible constraints of the wheels."""

import math
from collections.abc import Mapping
from typing import ClassVar, Self

import equinox as eqx

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constraints import AbstractConstraint
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import AbstractSignal, Joint
from snakejax.dynamics.vehicle import AbstractVehicle, Angles, Body, Joints, Placement, Stroke, Wheelset, axle_outline
from snakejax.dynamics.vehicle_input import Input

from .closed_form import NonSlippingBoard, SlippingBoard
from .paper_constraints import Coupled, Printed


class Board(AbstractVehicle):
    """A board on two steered wheelsets, with a rotor (Salman et al., CDC 2016, section II, Table II).

    `inertia`: total yaw inertia with rotor and wheelsets, I = J + J_r + 2 J_w; if it is None the assumption of the
    paper, I = m L^2, is used. `offset`: distance of the centre of mass ahead of the middle. `creep_speed`: eps of the
    slip angle (`slip_angle`); the default 1 mm/s is far below any measured speed.
    """

    kind: ClassVar[str] = "snakeboard"
    noun: ClassVar[str] = "board"
    inputs: ClassVar[tuple[Input, ...]] = (
        Input("phi", "angle", "steering"),
        Input("psi", "angle", "rotor"),
        Input("phi_back", "angle", "back steering", follows="-phi"),
    )
    stated_sd: ClassVar[dict[str, float]] = {"mass": 0.03, "half_length": 0.005, "inertia": 0.07, "rotor_inertia": 0.07}
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {
        "coupled": Coupled,
        "free": SlippingBoard,
        "ideal": NonSlippingBoard,
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

    @property
    def length(self) -> Scalar:
        """L [m], `half_length`."""
        return self.half_length

    def bodies(self, angles: Angles) -> tuple[Body, ...]:
        """Everything that turns with the board, and beside it the rotor and the wheelsets about their pivots.

        The wheelsets turn in opposite directions, so that their reaction cancels and they count with the board.
        """
        return (
            Body(self.mass, self.total_inertia - self.rotor_inertia),
            Body(0.0, self.rotor_inertia, angle=angles["psi"]),
        )

    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """On the axis of the board, `arm` ahead of the centre of mass."""
        del angles
        return Placement(self.arm(wheelset))

    def steering(self, wheelset: Wheelset, joints: Joints) -> Joint:
        """phi for the front wheelset, -phi for the back one, or phi_back if that is given."""
        if "phi_back" in joints and wheelset.steering < 0:
            return joints["phi_back"]
        return Joint(*(wheelset.steering * part for part in joints["phi"]))

    def inputs_of(self, signals: Mapping[str, AbstractSignal]) -> Gait:
        """The gait of `signals` phi, psi and, if the back is steered by itself, phi_back."""
        return Gait(signals["phi"], signals["psi"], signals.get("phi_back"))

    def actuator_torques(self, joints: Joints, yaw_acceleration: Scalar) -> tuple[Scalar, Scalar]:
        """Torques of steering and rotor, 2 J_w phi'' and J_r (psi'' + rdot) (rows phi and psi of eq. 2)."""
        steering = 2 * self.wheelset_inertia * joints["phi"].acceleration
        return steering, self.rotor_inertia * (joints["psi"].acceleration + yaw_acceleration)

    def with_centre_moved(self, ahead: Scalar) -> Self:
        """The board with `offset` larger by `ahead` [m]."""
        return eqx.tree_at(lambda b: b.offset, self, self.offset + ahead)

    def outline(self) -> tuple[Stroke, ...]:
        """The deck with an arrow at its nose, and the rotor as a disc with a spoke."""
        L = float(self.half_length)
        angles = [2 * math.pi * k / 24 for k in range(25)]
        disc = tuple((0.25 * L * math.cos(angle), 0.25 * L * math.sin(angle)) for angle in angles)
        nose = ((-L, 0.0), (L, 0.0), (L, -0.12 * L), (1.25 * L, 0.0), (L, 0.12 * L), (L, 0.0))
        return Stroke(nose), Stroke(disc, "psi"), Stroke(((0.0, 0.0), (0.25 * L, 0.0)), "psi")

    def wheel_outline(self, wheelset: Wheelset) -> tuple[Stroke, ...]:
        """An axle with two wheels."""
        del wheelset
        return axle_outline(float(self.half_length), 0.3 * float(self.half_length))

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
