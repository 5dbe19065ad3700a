"""Kinematics at one instant: velocities of the body and of each wheel over the ground, and the slip angle."""

from typing import NamedTuple

import jax.numpy as jnp

from snakejax.core.fast_math import arctan, sine_cosine
from snakejax.core.parameter import Scalar

from .signals import Joint
from .vehicle import AbstractVehicle, Wheelset


def slip_angle(lateral: Scalar, rolling: Scalar, creep: Scalar) -> Scalar:
    """Slip angle of a rolling wheel, atan(v / sqrt(a^2 + eps^2)) [rad], odd in v and even in a.

    With q^2 = a^2 + eps^2 it is computed as 2 atan(v / (q + sqrt(q^2 + v^2))), which is smooth at rest.

    **Arguments:** `lateral`: slip speed v [m/s]; `rolling`: rolling speed a [m/s]; `creep`: eps > 0 [m/s].
    """
    square = rolling**2 + creep**2
    return 2 * arctan(lateral / (jnp.sqrt(square) + jnp.sqrt(square + lateral**2)))


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
    [m/s]: forward and lateral velocity; `r` [rad/s]: yaw rate; `steering`, `rotor`: joints; `wheels`; `board`.
    """

    time: Scalar
    x: Scalar
    y: Scalar
    theta: Scalar
    heading: Scalar
    u: Scalar
    w: Scalar
    r: Scalar
    steering: Joint
    rotor: Joint
    wheels: tuple[Wheel, ...]
    board: AbstractVehicle

    def into_body(self, east: Scalar, north: Scalar) -> tuple[Scalar, Scalar]:
        """Components along and across the body of a force (east, north) [N] in the world frame."""
        sine, cosine = sine_cosine(self.theta)
        return east * cosine + north * sine, north * cosine - east * sine


Wrench = tuple[Scalar, Scalar, Scalar]


class WheelAngles(NamedTuple):
    """Angles of all wheelsets at one instant, with their sines and cosines."""

    joints: tuple[Joint, ...]
    sines: tuple[Scalar, ...]
    cosines: tuple[Scalar, ...]

    @staticmethod
    def of(joints: tuple[Joint, ...]) -> "WheelAngles":
        """Evaluate sine and cosine once for each wheelset."""
        pairs = [sine_cosine(joint.angle) for joint in joints]
        sines, cosines = tuple(s for s, _ in pairs), tuple(c for _, c in pairs)
        return WheelAngles(joints, sines, cosines)


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
    """Forces on the vehicle: lateral force and rolling resistance [N] of each wheelset, further wrench [N, N, N m], and
    rotor acceleration [rad/s^2]."""

    wheels: tuple[Wheel, ...]
    traction: tuple[Scalar, ...]
    resistance: tuple[Scalar, ...]
    wrench: Wrench
    rotor: Scalar
