"""Kinematics at one instant: velocities of the body and of each wheel over the ground, and the slip angle."""

from typing import NamedTuple

import jax.numpy as jnp

from snakejax.core.fast_math import arctan, named, sine_cosine
from snakejax.core.parameter import Scalar

from .signals import Joint
from .vehicle import AbstractVehicle, Wheelset

SLIP_ANGLE = "snakejax_slip_angle"
"""Name of the slip angle in a trace."""
STICKING_SPEED = 0.005
"""Below this speed [m/s] dry friction falls to zero, so that it can be integrated."""


@named(SLIP_ANGLE)
def slip_angle(lateral: Scalar, rolling: Scalar, creep: Scalar) -> Scalar:
    """Slip angle of a rolling wheel, atan(v / sqrt(a^2 + eps^2)) [rad], odd in v and even in a.

    With q^2 = a^2 + eps^2 it is computed as 2 atan(v / (q + sqrt(q^2 + v^2))), which is smooth at rest.

    **Arguments:** `lateral`: slip speed v [m/s]; `rolling`: rolling speed a [m/s]; `creep`: eps > 0 [m/s].
    """
    square = rolling**2 + creep**2
    return 2 * arctan(lateral / (jnp.sqrt(square) + jnp.sqrt(square + lateral**2)))


def combined_slip(lateral: Scalar, sliding: Scalar, rim: Scalar, creep: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Slip of a wheel whose rim is driven: (slip angle [rad], share of the force across, share along the wheel).

    The slip is the speed of the contact over the ground against that of the rim, and the force opposes it: the
    similarity method for equal stiffness along and across (Pacejka 2012, section 4.3.1, theoretical slip).

    **Arguments:** `lateral`: slip speed across [m/s]; `sliding`: along, rolling speed less that of the rim [m/s]; `rim`
    [m/s]; `creep`: eps > 0 [m/s].
    """
    speed = jnp.sqrt(lateral**2 + sliding**2 + 1e-12)
    return slip_angle(speed, rim, creep), lateral / speed, sliding / speed


class Wheel(NamedTuple):
    """A wheelset at one instant: its steering angle, with sine and cosine, and its velocities over the ground."""

    wheelset: Wheelset
    joint: Joint
    sine: Scalar
    cosine: Scalar
    lateral: Scalar
    """Lateral slip speed v_i [m/s]."""
    rolling: Scalar
    """Rolling speed a_i [m/s]."""


class Motion(NamedTuple):
    """The vehicle at one instant.

    `time` [s]; `x`, `y` [m]; `theta` [rad]: angle of the frame of the wrench and of (u, w); `heading` [rad]; `u`, `w`
    [m/s]: forward and lateral velocity; `r` [rad/s]: yaw rate; `inputs`: inputs and free joints by name; `wheels`;
    `board`: the vehicle; `drive` [N]: the driving force along each wheel, None where nothing drives by a torque.
    """

    time: Scalar
    x: Scalar
    y: Scalar
    theta: Scalar
    heading: Scalar
    u: Scalar
    w: Scalar
    r: Scalar
    inputs: dict[str, Joint]
    wheels: tuple[Wheel, ...]
    board: AbstractVehicle
    drive: tuple[Scalar, ...] | None = None

    @property
    def steering(self) -> Joint:
        """The steering joint `phi` of a snakeboard."""
        return self.inputs["phi"]

    @property
    def rotor(self) -> Joint:
        """The rotor joint `psi` of a snakeboard."""
        return self.inputs["psi"]

    def into_body(self, east: Scalar, north: Scalar) -> tuple[Scalar, Scalar]:
        """Components along and across the body of a force (east, north) [N] in the world frame."""
        sine, cosine = sine_cosine(self.theta)
        return east * cosine + north * sine, north * cosine - east * sine


Wrench = tuple[Scalar, Scalar, Scalar]


class Configuration(NamedTuple):
    """Joints at one instant: the angle of every wheel against its body with sine and cosine, and `inputs` by name."""

    joints: tuple[Joint, ...]
    sines: tuple[Scalar, ...]
    cosines: tuple[Scalar, ...]
    inputs: dict[str, Joint]

    @staticmethod
    def of(joints: tuple[Joint, ...], inputs: dict[str, Joint]) -> "Configuration":
        """Evaluate sine and cosine once for each wheelset."""
        pairs = [sine_cosine(joint.angle) for joint in joints]
        sines, cosines = tuple(s for s, _ in pairs), tuple(c for _, c in pairs)
        return Configuration(joints, sines, cosines, inputs)


class Velocities(NamedTuple):
    """Position [m], frame angle and heading [rad], body velocities u, w [m/s] and r [rad/s], and lateral and rolling
    speed [m/s] of each wheelset."""

    x: Scalar
    y: Scalar
    theta: Scalar
    heading: Scalar
    u: Scalar
    w: Scalar
    r: Scalar
    lateral: tuple[Scalar, ...]
    rolling: tuple[Scalar, ...]


class AppliedForces(NamedTuple):
    """Forces on the vehicle: lateral force and resistance to rolling, less what drives, [N] of each wheelset; further
    wrench [N, N, N m]."""

    wheels: tuple[Wheel, ...]
    traction: tuple[Scalar, ...]
    resistance: tuple[Scalar, ...]
    wrench: Wrench
