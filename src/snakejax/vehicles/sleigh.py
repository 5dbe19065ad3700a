"""Chaplygin sleigh: a body on a blade behind its centre of mass."""

from typing import ClassVar

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.vehicle import Angles, Placement, RigidVehicle, Wheelset


class Sleigh(RigidVehicle):
    """A rigid body on one blade `arm` [m] behind its centre of mass, without inputs (Chaplygin 1911; Bloch 2003, 1.7).

    Without slip the speed of the blade v and the yaw rate r obey

        vdot = arm r^2        (I + m arm^2) rdot = -m arm v r

    The pose is that of the centre of mass. It moves only if its run begins in motion.
    """

    kind: ClassVar[str] = "sleigh"
    noun: ClassVar[str] = "sleigh"
    independent: ClassVar[tuple[str, ...]] = ("u", "r")
    structures: ClassVar[dict[str, type[AbstractConstraint]]] = {"free": Slipping, "ideal": NonSlipping}
    relaxed: ClassVar[dict[str, str]] = {"ideal": "free"}
    stated_sd: ClassVar[dict[str, float]] = {"mass": 0.03, "arm": 0.02, "inertia": 0.1}

    mass: Scalar = param("kg", positive=True, meaning="mass")
    inertia: Scalar = param("kg m^2", positive=True, meaning="yaw inertia about the centre of mass")
    arm: Scalar = param("m", low=0.0, meaning="distance of the blade behind the centre of mass")
    creep_speed: Scalar = param("m/s", positive=True, default=0.01, meaning="speed below which slip is smoothed")
    wheelsets: tuple[Wheelset, ...] = (Wheelset(-1.0, name="blade", axle="rear"),)

    @property
    def length(self) -> Scalar:
        """The radius of gyration [m]."""
        return (self.inertia / self.mass) ** 0.5

    def placement(self, wheelset: Wheelset, angles: Angles) -> Placement:
        """The blade, along the body."""
        del wheelset, angles
        return Placement(-self.arm)


ICE_SLEIGH = dict(mass=2.0, inertia=0.05, arm=0.1)
"""A small sleigh: m [kg], I [kg m^2], distance of the blade [m]."""
