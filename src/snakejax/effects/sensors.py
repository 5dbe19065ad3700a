"""What motion capture may report wrongly."""

from typing import ClassVar

from .._effect import Clock, Sensor
from .._math import sine_cosine
from .._units import Scalar, param


class MarkerOffset(Sensor):
    """The tracked point is (x, y) + R(heading) (mx, my)."""

    sentence = "Motion capture tracks a point beside the centre of mass."
    mx: Scalar = param("m", default=0.0)
    my: Scalar = param("m", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        sine, cosine = sine_cosine(heading)
        return x + cosine * self.mx - sine * self.my, y + sine * self.mx + cosine * self.my, heading


class HeadingOffset(Sensor):
    """h is added to the reported heading, after the marker's rotation."""

    sentence = "Motion capture's body axis is turned against the board's."
    stage: ClassVar[int] = 1
    h: Scalar = param("rad", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return x, y, heading + self.h


class ClockOffset(Clock):
    """The pose reported at t is that of command time t - T; the board rests before 0."""

    sentence = "The clocks of motion capture and of the commands do not agree."
    T: Scalar = param("s", default=0.0)

    def delay(self) -> Scalar:
        return self.T
