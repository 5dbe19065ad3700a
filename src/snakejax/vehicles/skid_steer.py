"""Robot with four fixed driven wheels, left and right pairs: it must skid to turn."""

from typing import ClassVar, Self

import equinox as eqx

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.multibody import Phase, Vector
from snakejax.dynamics.signals import Joint
from snakejax.dynamics.vehicle import AbstractVehicle, Angles, Joints, Placement, RigidVehicle, Stroke, Wheelset
from snakejax.dynamics.vehicle_input import Input


class DifferentialDrive(NonSlipping):
    """Wheels that roll without slip on two circles `effective_track` apart (Mandow et al. 2007, symmetric).

    u = (v_right + v_left) / 2    w = offset r    r = (v_right - v_left) / effective_track

    for the centre of mass, `offset` [m] ahead of the axis about which the robot turns.
    """

    def velocities(self, board: AbstractVehicle, free: Vector, phase: Phase, like: Scalar) -> Vector:
        del free, like
        left = next(rim for rim, wheel in zip(phase.rims, board.wheelsets, strict=True) if wheel.drive == "left")
        right = next(rim for rim, wheel in zip(phase.rims, board.wheelsets, strict=True) if wheel.drive == "right")
        width, ahead = getattr(board, "effective_track"), getattr(board, "offset")  # noqa: B009
        rate = (right - left) / width
        return (left + right) / 2, ahead * rate, rate


class SkidSteer(RigidVehicle):
    """Four wheels that cannot be steered, at (+-half_base, +-half_track) [m]; the pairs left and right are driven.

    The inputs `left` and `right` are the speeds of the rims [m/s] divided by `wheel_radius`, so with a radius in m they
    are spin rates [rad/s]. Each wheel pulls against the slip of its contact, along and across by one law
    (`combined_slip`). `effective_track` [m] belongs to the structure "ideal" alone, see `DifferentialDrive`. Of
    `creep_speed`, below which a contact is viscous, the ground decides: on loose ground only its order of magnitude is
    known, so that an explanation may move it by a factor of 20.
    """

    kind: ClassVar[str] = "skid_steer"
    noun: ClassVar[str] = "robot"
    inputs: ClassVar[tuple[Input, ...]] = (
        Input("left", "speed", "left_wheels"),
        Input("right", "speed", "right_wheels"),
    )
    independent: ClassVar[tuple[str, ...]] = ()
    friction: ClassVar[float] = 0.6
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {"free": Slipping, "ideal": DifferentialDrive}
    relaxed: ClassVar[dict[str, str]] = {"ideal": "free"}
    acts_under: ClassVar[dict[str, str]] = {"effective_track": "ideal"}
    stated_sd: ClassVar[dict[str, float]] = {
        "mass": 0.1,
        "half_base": 0.02,
        "half_track": 0.02,
        "inertia": 0.2,
        "creep_speed": 1.5,
    }

    mass: Scalar = param("kg", positive=True, meaning="mass")
    inertia: Scalar = param("kg m^2", positive=True, meaning="yaw inertia about the centre of mass")
    half_base: Scalar = param("m", positive=True, meaning="half the distance between front and rear axles")
    half_track: Scalar = param("m", positive=True, meaning="half the distance between left and right wheels")
    wheel_radius: Scalar = param(
        "m", positive=True, default=1.0, meaning="radius of the wheels; 1 if the inputs are rim speeds [m/s]"
    )
    effective_track: Scalar = param(
        "m", positive=True, default=1.0, meaning="distance of the wheels as a differential drive, for skid = ideal"
    )
    offset: Scalar = param("m", default=0.0, meaning="distance of the centre of mass ahead of the middle")
    creep_speed: Scalar = param("m/s", positive=True, default=0.05, meaning="speed below which slip is smoothed")
    wheelsets: tuple[Wheelset, ...] = (
        Wheelset(1.0, name="front_left", axle="front", drive="left"),
        Wheelset(1.0, name="front_right", axle="front", drive="right"),
        Wheelset(-1.0, name="rear_left", axle="rear", drive="left"),
        Wheelset(-1.0, name="rear_right", axle="rear", drive="right"),
    )
    unknown: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def estimated(self) -> tuple[str, ...]:
        """The constants that case.toml leaves to be estimated."""
        return self.unknown

    @property
    def length(self) -> Scalar:
        """Half the wheelbase [m]."""
        return self.half_base

    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """A corner of the rectangle of the wheels, whose middle is `offset` behind the centre of mass."""
        del angles
        side = 1.0 if wheelset.drive == "left" else -1.0
        ahead = 1.0 if wheelset.axle == "front" else -1.0
        return Placement(ahead * self.half_base - self.offset, side * self.half_track)

    def rim(self, wheelset: Wheelset, joints: Joints) -> Joint:
        """`wheel_radius` times the input of its side."""
        return Joint(*(self.wheel_radius * part for part in joints[wheelset.drive]))

    def with_centre_moved(self, ahead: Scalar) -> Self:
        """The robot with `offset` larger by `ahead` [m]."""
        return eqx.tree_at(lambda c: c.offset, self, self.offset + ahead)

    def outline(self) -> tuple[Stroke, ...]:
        """The rectangle of the wheels."""
        a, b = float(self.half_base), float(self.half_track)
        return (Stroke(((a, b), (-a, b), (-a, -b), (a, -b), (a, b))),)


HUSKY = dict(mass=50.0, inertia=4.0, half_base=0.255, half_track=0.275, wheel_radius=0.165, effective_track=1.15)
"""A Clearpath Husky: nominal m [kg] and lengths [m]; the effective track is one fitted to its motion."""
