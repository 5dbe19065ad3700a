"""Systematic errors of motion capture: marker offset, heading offset and clock offset."""

from typing import ClassVar

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.ports import Delay, Sensor


class MarkerOffset(Sensor):
    """Reported position = (x, y) + R(heading) (mx, my), with R the rotation by the heading."""

    description = "Motion capture tracks a point beside the centre of mass."
    mx: Scalar = param("m", default=0.0)
    my: Scalar = param("m", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        sine, cosine = sine_cosine(heading)
        return x + cosine * self.mx - sine * self.my, y + sine * self.mx + cosine * self.my, heading


class HeadingOffset(Sensor):
    """Reported heading = heading + h, applied after the marker offset."""

    description = "Motion capture's body axis is turned against the board's."
    order: ClassVar[int] = 1
    h: Scalar = param("rad", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return x, y, heading + self.h


class ClockOffset(Delay):
    """The pose reported at t is that of command time t - T; the board is at rest before 0."""

    description = "The clocks of motion capture and of the commands do not agree."
    T: Scalar = param("s", default=0.0)

    def delay(self) -> Scalar:
        return self.T
