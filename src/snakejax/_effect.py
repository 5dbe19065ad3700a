"""The ports a physical effect plugs into.

An effect is a small module with `param` fields whose defaults are neutral: at them the model is unchanged. It is
written for one instant of time; batching is the package's business. To add one, subclass a port:

| port | what it contributes |
|---|---|
| `Force` | a wrench (X, Y, N) on the body, from the motion |
| `Rolling` | a force against the rolling of each wheelset |
| `Grip` | a change of the lateral force of each wheelset |
| `Floor` | a change of the tyre with where and how the board moves |
| `Memory` | a state for each wheelset that stands between its slip angle and its force |
| `Command` | gait -> gait, before the joints |
| `Linkage` | joint angle -> wheel angle |
| `Sensor` | pose -> reported pose |
| `Clock` | a delay of the reported pose |
| `Layout` | board -> board: where things sit |
"""

import abc
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from ._board import Board, Wheelset
from ._gait import Gait, Joint
from ._math import sine_cosine
from ._tyre import AbstractTyre
from ._units import Parametrised, Scalar

if TYPE_CHECKING:
    from ._model import Model


class Wheel(NamedTuple):
    """A wheelset at one instant: its steering and how it moves over the floor."""

    wheelset: Wheelset
    joint: Joint
    sine: Scalar
    cosine: Scalar
    lateral: Scalar
    """Lateral slip speed v_i [m/s]."""
    rolling: Scalar
    """Rolling speed a_i [m/s]."""


class Motion(NamedTuple):
    """The board at one instant. `theta` turns the world into the frame of the wrench and of (u, w)."""

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
    board: Board

    def into_body(self, east: Scalar, north: Scalar) -> tuple[Scalar, Scalar]:
        """A world-frame force (along x, along y) [N] as its components along and across the body."""
        sine, cosine = sine_cosine(self.theta)
        return east * cosine + north * sine, north * cosine - east * sine


Wrench = tuple[Scalar, Scalar, Scalar]


class Effect(Parametrised):
    """A physical effect a model may contain. `sentence` tells a user what it is."""

    sentence: ClassVar[str] = ""
    probe: ClassVar[dict[str, float]] = {}
    """Values from which to score parameters whose derivative at the neutral setting does not exist."""
    silent: ClassVar[str] = "it changes nothing in these runs that the fit and the starts do not change as well."
    """Why a set of runs may not show this effect at all."""

    def refusal(self, model: "Model") -> str | None:
        """Why this effect cannot act on `model`, or None where it can."""
        del model
        return None


class Force(Effect):
    """Adds a wrench on the body."""

    @abc.abstractmethod
    def wrench(self, motion: Motion) -> Wrench:
        """(X, Y, N): force along and across the body [N] and yaw moment [N m]."""


class Rolling(Effect):
    """Adds a force against the rolling of each wheelset."""

    @abc.abstractmethod
    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        """T_i [N], counted against forward rolling."""


class Grip(Effect):
    """Changes the lateral force of each wheelset."""

    @abc.abstractmethod
    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        """The changed F_i [N], counted against the slip."""


class Floor(Effect):
    """Changes the tyre with the motion."""

    @abc.abstractmethod
    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        """The tyre as it is at this place and time."""


class Memory(Effect):
    """Gives each wheelset a state m that stands between its slip angle and its force. It starts at `slip`."""

    @abc.abstractmethod
    def rate(self, memory: Scalar, slip: Scalar, wheel: Wheel) -> Scalar:
        """dm/dt [rad/s]."""

    @abc.abstractmethod
    def slip(self, memory: Scalar, slip: Scalar) -> Scalar:
        """The slip angle [rad] the tyre feels."""


class Command(Effect):
    """Changes what the joints are told."""

    @abc.abstractmethod
    def gait(self, gait: Gait) -> Gait:
        """The gait the joints receive."""


class Linkage(Effect):
    """Changes the way from a steering joint to its wheelset; those of lower `stage` stand nearer to the joint."""

    stage: ClassVar[int] = 1

    @abc.abstractmethod
    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        """The angle of the wheelset and its derivatives."""


class Sensor(Effect):
    """Changes the pose that is reported; those of lower `stage` stand nearer to the board."""

    stage: ClassVar[int] = 0

    @abc.abstractmethod
    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """The reported (x [m], y [m], heading [rad])."""


class Clock(Effect):
    """Delays the report."""

    @abc.abstractmethod
    def delay(self) -> Scalar:
        """T [s]: the pose reported at t is that of command time t - T."""


class Layout(Effect):
    """Changes where things sit on the board."""

    @abc.abstractmethod
    def board(self, board: Board) -> Board:
        """The changed board."""
