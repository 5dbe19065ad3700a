"""Single-track car: two axles, the front one steered, driven by a force."""

from typing import ClassVar, Self

import equinox as eqx
import jax

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.contact import Motion
from snakejax.dynamics.signals import Joint
from snakejax.dynamics.vehicle import Angles, Joints, Placement, RigidVehicle, Stroke, Wheelset, wheels_across
from snakejax.dynamics.vehicle_input import Input

DEAD_BAND_WIDTH = 0.01
"""Width of the smooth edge of the dead band, in units of the command."""


class Car(RigidVehicle):
    """A car whose left and right wheels are one on each axle (single-track model; Riekert and Schunck 1940).

    The pose is that of its centre of mass, `front` [m] behind the front axle and `rear` [m] ahead of the rear one. With
    the inputs s (steer) and T (drive), u the forward speed and P(z) = w ln(1 + exp(z / w)), w = `DEAD_BAND_WIDTH`

        steering angle  delta = steering_ratio s
        driving force   F = force_gain (P(T - c) - P(-T - c)) - speed_loss u        c = dead_band

    of which the front wheels have the share `front_drive`. With the ratio and the gain 1 the inputs are rad and N.
    """

    kind: ClassVar[str] = "car"
    noun: ClassVar[str] = "car"
    inputs: ClassVar[tuple[Input, ...]] = (Input("steer", "angle", "steering"), Input("drive", "command", "drive"))
    gain_of: ClassVar[dict[str, str]] = {"steer": "steering_ratio", "drive": "force_gain"}
    friction: ClassVar[float] = 0.8
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {"free": Slipping, "ideal": NonSlipping}
    relaxed: ClassVar[dict[str, str]] = {"ideal": "free"}
    stated_sd: ClassVar[dict[str, float]] = {"mass": 0.03, "front": 0.02, "rear": 0.02, "inertia": 0.2}

    mass: Scalar = param("kg", positive=True, meaning="mass")
    inertia: Scalar = param("kg m^2", positive=True, meaning="yaw inertia about the centre of mass")
    front: Scalar = param("m", positive=True, meaning="distance of the front axle from the centre of mass")
    rear: Scalar = param("m", positive=True, meaning="distance of the rear axle from the centre of mass")
    creep_speed: Scalar = param("m/s", positive=True, default=0.05, meaning="speed below which slip is smoothed")
    steering_ratio: Scalar = param(
        "-", default=1.0, meaning="steering angle [rad] of the front wheels per unit of the command"
    )
    force_gain: Scalar = param(
        "N", positive=True, default=1.0, meaning="driving force per unit of the command above the dead band"
    )
    dead_band: Scalar = param("-", low=0.0, default=0.0, meaning="command up to which nothing drives")
    speed_loss: Scalar = param("N s/m", default=0.0, meaning="driving force lost per speed")
    front_drive: Scalar = param(
        "-", low=0.0, high=1.0, default=0.0, meaning="share of the driving force at the front wheels, 0 to 1"
    )
    wheelsets: tuple[Wheelset, ...] = (
        Wheelset(1.0, 1.0, name="front", axle="front", steer="steer"),
        Wheelset(-1.0, 0.0, name="rear", axle="rear"),
    )
    unknown: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def estimated(self) -> tuple[str, ...]:
        """The constants that case.toml leaves to be estimated."""
        return self.unknown

    @property
    def length(self) -> Scalar:
        """Half the wheelbase [m]."""
        return (self.front + self.rear) / 2

    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """On the axis of the car."""
        del angles
        return Placement(self.front if wheelset.axle == "front" else -self.rear)

    def steering(self, wheelset: Wheelset, joints: Joints) -> Joint:
        """delta for the front wheels, zero for the rear ones."""
        return Joint(*(wheelset.steering * self.steering_ratio * part for part in joints["steer"]))

    def load(self, wheelset: Wheelset) -> Scalar:
        """m g l_r / l in front, m g l_f / l behind [N]."""
        other = self.rear if wheelset.axle == "front" else self.front
        return self.mass * GRAVITY * other / (self.front + self.rear)

    def driving_force(self, u: Scalar, command: Scalar) -> Scalar:
        """F [N] by the equation of the class, at the forward speed `u` [m/s]."""
        w, c = DEAD_BAND_WIDTH, self.dead_band
        pulled = w * (jax.nn.softplus((command - c) / w) - jax.nn.softplus((-command - c) / w))
        return self.force_gain * pulled - self.speed_loss * u

    def drive(self, motion: Motion) -> tuple[Scalar, ...]:
        """F by the equation of the class, split between the axles [N]."""
        force = self.driving_force(motion.u, motion.inputs["drive"].angle)
        return force * self.front_drive, force * (1 - self.front_drive)

    def with_centre_moved(self, ahead: Scalar) -> Self:
        """The car with its axles `ahead` [m] further back."""
        return eqx.tree_at(lambda c: (c.front, c.rear), self, (self.front - ahead, self.rear + ahead))

    def outline(self) -> tuple[Stroke, ...]:
        """A rectangle as long as the wheelbase and a half more, with an arrow at its nose."""
        a, b, half = 1.5 * float(self.front), -1.5 * float(self.rear), 0.8 * float(self.length)
        nose = a + 0.4 * half
        return (Stroke(((a, half), (b, half), (b, -half), (a, -half), (nose, 0.0), (a, half), (a, -half))),)

    def wheel_outline(self, wheelset: Wheelset) -> tuple[Stroke, ...]:
        """The two wheels that the one of the model stands for."""
        del wheelset
        return wheels_across(float(self.length), 0.6 * float(self.length))


DART = dict(mass=1.58, inertia=0.008, front=0.0805, rear=0.0930, front_drive=0.536)
"""The 1:10 car of Lyons et al. 2024 (DART, TU Delft): m [kg], distances of the axles [m]; its inertia is a guess."""
