"""Declaration of a vehicle: bodies, wheels, joints, inputs; the equations of motion follow from it."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp

from snakejax.core.parameter import Parametrised, Scalar

from .constants import GRAVITY
from .inputs import AbstractInputs, Inputs
from .signals import AbstractSignal, Joint
from .vehicle_input import Input

if TYPE_CHECKING:
    from .constraints import AbstractConstraint
    from .contact import Motion

Number = Scalar | float
Angles = Mapping[str, Scalar]
"""Angles [rad] of joints by name."""
Joints = Mapping[str, Joint]
"""Joints and inputs by name, with rate and acceleration."""


class Wheelset(eqx.Module):
    """One wheel, or two on one axle: its place along the body, and how it is steered, driven and held.

    `place`: ahead (above 0) or behind, for the snakeboard in half lengths from the middle; `steering`: factor of the
    angle of the input `steer`; `name` and `axle`: words for it and for the tyre it shares; `drive`: the input of kind
    "speed" that is the speed of its rim; `holds`: what a wheel without slip holds, "lateral", "both" or "rolling".
    The front wheelset of the snakeboard is `Wheelset(1, 1)`, its back wheelset `Wheelset(-1, -1)`: phi_back = -phi.
    """

    place: float
    steering: float = 0.0
    name: str = eqx.field(static=True, default="")
    axle: str = eqx.field(static=True, default="")
    steer: str = eqx.field(static=True, default="")
    drive: str = eqx.field(static=True, default="")
    holds: str = eqx.field(static=True, default="lateral")


class Body(NamedTuple):
    """A rigid body: `mass` [kg], yaw `inertia` about its own centre of mass [kg m^2], and its place in the base frame:
    `x` ahead, `y` to the left [m], turned by `angle` [rad] against the base."""

    mass: Number
    inertia: Number
    x: Number = 0.0
    y: Number = 0.0
    angle: Number = 0.0


class Placement(NamedTuple):
    """Where a wheel touches the ground in the base frame, `x` ahead, `y` to the left [m], and the angle [rad] of the
    body that carries it; its steering angle comes on top."""

    x: Number
    y: Number = 0.0
    angle: Number = 0.0


class Stroke(NamedTuple):
    """A line of the picture of a vehicle through `points` (x, y) [m].

    The line turns with `part`, the base or a joint, about the `pivot` (x, y) [m] in the base frame; points count from
    there.
    """

    points: tuple[tuple[float, float], ...]
    part: str = "base"
    pivot: tuple[float, float] = (0.0, 0.0)


WHEEL = 0.18
"""Half the length of a wheel in pictures, in lengths of the vehicle."""


def wheels_across(length: float, half_track: float) -> tuple[Stroke, ...]:
    """The picture of two wheels `half_track` [m] to both sides of their axle; of one wheel where that is zero."""
    half = WHEEL * length
    return tuple(Stroke(((-half, y), (half, y))) for y in sorted({-half_track, half_track}))


def axle_outline(length: float, half_track: float) -> tuple[Stroke, ...]:
    """The picture of an axle with the two wheels of `wheels_across`."""
    return Stroke(((0.0, -half_track), (0.0, half_track))), *wheels_across(length, half_track)


class AbstractVehicle(Parametrised):
    """A planar vehicle on wheels: rigid bodies, joints, wheels and inputs.

    `mass` [kg]; `creep_speed` [m/s]: regularises the slip angle at rest; `wheelsets`; `inputs`; `free_joints`: joints
    that no input prescribes, integrated with the motion; `independent`: the velocities u, w, r and rates of free joints
    that remain free where no wheel slips; `structures`: possible constraints of its wheels, by name; `relaxed`: maps a
    structure that constrains the wheels to the one whose wheels slip; `noun`: the word for it in messages; `kind`: its
    name in case.toml and in results, empty for one of your own.
    """

    kind: ClassVar[str] = ""
    noun: ClassVar[str] = "vehicle"
    inputs: ClassVar[tuple[Input, ...]] = ()
    free_joints: ClassVar[tuple[str, ...]] = ()
    independent: ClassVar[tuple[str, ...]] = ("u",)
    structures: ClassVar[dict[str, type["AbstractConstraint"]]]
    relaxed: ClassVar[dict[str, str]] = {}
    friction: ClassVar[float] = 0.2
    """Coefficient of friction with which a fit of its tyres starts."""
    gain_of: ClassVar[dict[str, str]] = {}
    """The constant that multiplies an input, by the name of the input."""
    acts_under: ClassVar[dict[str, str]] = {}
    """Constants that act under one structure alone, with its name."""
    stated_sd: ClassVar[dict[str, float]] = {"mass": 0.03, "inertia": 0.07}
    """Relative standard deviations of its constants where case.toml states none: a mass weighed without its battery, a
    length by a tape, an inertia by the pendulum or from a drawing."""

    mass: eqx.AbstractVar[Scalar]
    creep_speed: eqx.AbstractVar[Scalar]
    wheelsets: eqx.AbstractVar[tuple[Wheelset, ...]]

    @property
    def estimated(self) -> tuple[str, ...]:
        """The names of its constants that are not known and that a fit estimates by default."""
        return ()

    @abc.abstractmethod
    def bodies(self, angles: Angles) -> tuple[Body, ...]:
        """The bodies at the joint `angles` [rad]; the base frame is that of the measured pose."""

    @abc.abstractmethod
    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """Where `wheelset` touches the ground at the joint `angles` [rad]."""

    @property
    @abc.abstractmethod
    def total_inertia(self) -> Scalar:
        """Yaw inertia of the whole vehicle about its centre of mass [kg m^2], joints at zero."""

    @property
    @abc.abstractmethod
    def length(self) -> Scalar:
        """A length [m] to scale pictures and weak priors: half of that between its outermost wheels."""

    @abc.abstractmethod
    def with_payload(self, mass: Scalar, inertia: Scalar) -> Self:
        """The vehicle with a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] at its centre of mass."""

    def steering(self, wheelset: Wheelset, joints: Joints) -> Joint:
        """Steering angle of `wheelset` against the body that carries it: `Wheelset.steering` times its input."""
        if not wheelset.steer:
            zero = jnp.zeros_like(next(iter(joints.values())).angle) if joints else jnp.zeros(())
            return Joint(zero, zero, zero)
        return Joint(*(wheelset.steering * part for part in joints[wheelset.steer]))

    def load(self, wheelset: Wheelset) -> Scalar:
        """Vertical load [N] on `wheelset` at rest; by default the weight shared evenly."""
        del wheelset
        return self.mass * GRAVITY / len(self.wheelsets)

    def rim(self, wheelset: Wheelset, joints: Joints) -> Joint | None:
        """Speed of the rim of `wheelset` [m/s], with its rate; None where it rolls freely."""
        return joints[wheelset.drive] if wheelset.drive else None

    def drive(self, motion: "Motion") -> tuple[Scalar, ...] | None:
        """Driving force [N] along each wheel, None where nothing drives by a torque."""
        del motion
        return None

    def joint_torques(self, joints: Joints) -> dict[str, Scalar]:
        """Torque [N m] on each free joint beside those of the wheels: springs, dampers, motors."""
        del joints
        return {}

    def inputs_of(self, signals: Mapping[str, AbstractSignal]) -> AbstractInputs:
        """The inputs of a run from the signals by name."""
        return Inputs((given.name, signals[given.name]) for given in self.inputs)

    def actuator_torques(self, joints: Joints, yaw_acceleration: Scalar) -> tuple[Scalar, ...]:
        """Torques [N m] of the prescribed joints at a yaw acceleration [rad/s^2] of the base.

        **Raises:** `NotImplementedError` for a vehicle that does not say.
        """
        raise NotImplementedError(f"The torques of the joints of a {self.noun} are not known.")

    @property
    def knows_actuator_torques(self) -> bool:
        """Whether the vehicle says its `actuator_torques`."""
        return type(self).actuator_torques is not AbstractVehicle.actuator_torques

    def with_centre_moved(self, ahead: Scalar) -> Self:
        """The vehicle with its centre of mass, the measured point, `ahead` [m] of where it was between the wheels.

        **Raises:** `NotImplementedError` for a vehicle that does not say.
        """
        raise NotImplementedError(f"The centre of mass of a {self.noun} cannot be moved.")

    def variables(self, joints: Joints) -> dict[str, Scalar]:
        """What a force may depend on beside motion and time: angle and rate of joints, the value of other inputs."""
        named: dict[str, Scalar] = {}
        for given in self.inputs:
            joint = joints.get(given.name)
            if joint is None or given.follows is not None:
                continue
            if given.kind == "angle":
                named |= {f"{given.label}_angle": joint.angle, f"{given.label}_rate": joint.rate}
            else:
                named[given.label] = joint.angle
        return named

    def accelerations(self, joints: Joints) -> dict[str, Scalar]:
        """The accelerations [rad/s^2] of prescribed joints, which push the body: `rotor_acceleration`."""
        own = [given for given in self.inputs if given.kind == "angle" and given.follows is None]
        prescribed = {given.label: joints.get(given.name) for given in own}
        return {f"{label}_acceleration": joint.acceleration for label, joint in prescribed.items() if joint is not None}

    def outline(self) -> tuple[Stroke, ...]:
        """The picture of the vehicle without its wheels: by default a bar as long as it is."""
        half = float(self.length)
        return (Stroke(((-half, 0.0), (half, 0.0))),)

    def wheel_outline(self, wheelset: Wheelset) -> tuple[Stroke, ...]:
        """The picture of `wheelset` in its own frame: by default one wheel."""
        del wheelset
        return wheels_across(float(self.length), 0.0)


class RigidVehicle(AbstractVehicle):
    """A vehicle that is one rigid body, whose pose is that of its centre of mass.

    `mass` [kg]; `inertia` [kg m^2]: yaw inertia about the centre of mass.
    """

    inertia: eqx.AbstractVar[Scalar]

    @property
    def total_inertia(self) -> Scalar:
        """Yaw inertia about the centre of mass [kg m^2]."""
        return self.inertia

    def bodies(self, angles: Angles) -> tuple[Body, ...]:
        """One body."""
        del angles
        return (Body(self.mass, self.inertia),)

    def with_payload(self, mass: Scalar, inertia: Scalar) -> Self:
        """The vehicle with a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] at its centre of mass."""
        return eqx.tree_at(lambda v: (v.mass, v.inertia), self, (self.mass + mass, self.inertia + inertia))
