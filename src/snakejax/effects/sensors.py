"""Systematic errors of motion capture: marker offset, heading offset and clock offset."""

from typing import TYPE_CHECKING, ClassVar

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.ports import Delay, Sensor

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model


class MarkerOffset(Sensor):
    """The tracked point is not the centre of mass.

        reported (x, y) = (x, y) + R(heading) (mx, my)

    R is the rotation by the heading. Positive mx: the tracked point is ahead of the centre of mass; positive my: to its
    left.
    """

    description = "Motion capture tracks a point beside the centre of mass."
    mx: Scalar = param("m", default=0.0)
    my: Scalar = param("m", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        sine, cosine = sine_cosine(heading)
        return x + cosine * self.mx - sine * self.my, y + sine * self.mx + cosine * self.my, heading


class HeadingOffset(Sensor):
    """The x axis of the tracked object is turned against that of the board; applied after `MarkerOffset`.

        reported heading = heading + h

    Positive h: the axis of the object is turned counter-clockwise, seen from above.
    """

    description = "Motion capture's body axis is turned against the board's."
    order: ClassVar[int] = 1
    h: Scalar = param("rad", default=0.0)

    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return x, y, heading + self.h


class ClockOffset(Delay):
    """The clocks of cameras and commands do not agree; the board is at rest before command time 0.

        reported pose(t) = pose(t - T)

    Positive T: the cameras report a pose T too late, or they were started T before the commands.
    """

    description = "The clocks of motion capture and of the commands do not agree."
    T: Scalar = param("s", default=0.0)

    def delay(self) -> Scalar:
        return self.T

    def inapplicable_because(self, model: "Model") -> str | None:
        if not model.board.inputs:
            return f"a {model.board.noun} has no commands with which the cameras could disagree."
        return None
