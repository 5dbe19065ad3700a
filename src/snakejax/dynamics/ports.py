"""Extension points (ports) of physical effects.

An effect is a module with `param` fields whose defaults are neutral: with them the model is unchanged. It is written
for one instant of time; the package does the batching. To add an effect, subclass one of these ports:

| port | contribution |
|---|---|
| `Force` | a wrench (X, Y, N) on the body, from the motion |
| `RollingForce` | a force against the rolling of each wheelset |
| `LateralForce` | a change of the lateral force of each wheelset |
| `TyreModifier` | a change of the tyre with position and motion |
| `TyreState` | a state for each wheelset between its slip angle and its force |
| `InputModifier` | gait -> gait, before the joints |
| `Linkage` | joint angle -> wheel angle |
| `Sensor` | pose -> reported pose |
| `Delay` | a delay of the reported pose |
| `Geometry` | board -> board: positions of parts |
"""

import abc
from typing import TYPE_CHECKING, ClassVar

from snakejax.core.parameter import Parametrised, Scalar

from .inputs import AbstractInputs
from .signals import Joint
from .tyres import AbstractTyre
from .vehicle import AbstractVehicle, Wheelset

if TYPE_CHECKING:
    from .model import Model
from .contact import Motion, Wheel, Wrench


class Effect(Parametrised):
    """A physical effect of a model; `description` explains it to the user."""

    description: ClassVar[str] = ""
    secant_step: ClassVar[dict[str, float]] = {}
    """Secant steps of parameters whose derivative at the neutral value does not exist, by name."""
    equivalent_constant: ClassVar[dict[str, str]] = {}
    """Parameters that act as a relative change of a constant of the vehicle does, with the name of that constant."""
    unobservable_because: ClassVar[str] = (
        "it changes nothing in these runs that the fit and the starts do not change as well."
    )
    """The reason to report when runs do not show this effect at all."""

    def inapplicable_because(self, model: "Model") -> str | None:
        """The reason why this effect does not apply to `model`, or None if it applies."""
        del model
        return None


def nothing_to_move(model: "Model") -> str | None:
    """The reason why no force can move the vehicle of `model`, or None."""
    if not model.constraint.slips and not model.board.independent:
        return "without slip the inputs alone prescribe the motion."
    return None


class _Load(Effect):
    """A force on the vehicle, which needs something that it can move."""

    def inapplicable_because(self, model: "Model") -> str | None:
        return nothing_to_move(model)


class _OfGrip(Effect):
    """A change of the lateral force of the wheels, which need to slip."""

    def inapplicable_because(self, model: "Model") -> str | None:
        if not model.constraint.slips:
            return f"the wheels of this {model.board.noun} do not slip, so its tyres have no lateral force to change."
        return None


class Force(_Load):
    """Adds a wrench on the body."""

    @abc.abstractmethod
    def wrench(self, motion: Motion) -> Wrench:
        """(X, Y, N): force along and across the body [N] and yaw moment [N m]."""


class RollingForce(_Load):
    """Adds a force against the rolling of each wheelset."""

    @abc.abstractmethod
    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        """T_i [N], positive against forward rolling."""


class LateralForce(_OfGrip):
    """Changes the lateral force of each wheelset."""

    @abc.abstractmethod
    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        """The changed F_i [N], positive against the slip."""


class TyreModifier(_OfGrip):
    """Changes the tyre with the motion."""

    @abc.abstractmethod
    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        """The tyre at this position, velocity and time."""


class TyreState(_OfGrip):
    """Gives each wheelset a state m [rad] between its slip angle and its force."""

    @abc.abstractmethod
    def rate(self, memory: Scalar, slip: Scalar, wheel: Wheel) -> Scalar:
        """dm/dt [rad/s]."""

    @abc.abstractmethod
    def slip(self, memory: Scalar, slip: Scalar) -> Scalar:
        """The slip angle [rad] that determines the force of the tyre."""


class InputModifier(Effect):
    """Changes the commands of the joints; effects are applied in the order of `order`."""

    order: ClassVar[int] = 0
    once: ClassVar[bool] = False
    """Whether the change is costly, so that a simulation makes it once and not at every instant."""

    @abc.abstractmethod
    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        """The gait that the joints receive."""


class Linkage(Effect):
    """Changes the transmission from a steering joint to its wheelset; effects are applied in the order of `order`."""

    order: ClassVar[int] = 1

    @abc.abstractmethod
    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        """The angle of the wheelset and its derivatives."""


class Sensor(Effect):
    """Changes the reported pose; effects are applied in the order of `order`."""

    order: ClassVar[int] = 0

    @abc.abstractmethod
    def observe(self, x: Scalar, y: Scalar, heading: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """The reported (x [m], y [m], heading [rad])."""


class Delay(Effect):
    """Delays the reported pose."""

    @abc.abstractmethod
    def delay(self) -> Scalar:
        """T [s]: the pose reported at t is that of command time t - T."""


class Geometry(Effect):
    """Changes positions of parts of the board."""

    @abc.abstractmethod
    def board(self, board: AbstractVehicle) -> AbstractVehicle:
        """The changed board."""
