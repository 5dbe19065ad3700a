"""Effects on the inputs of any vehicle: lag, gain, offset, curvature, asymmetry and fading of one input by name.

They act in this order: first the lag, then offset, gain and asymmetry of what it leaves, then the curvature.
"""

from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.ports import InputModifier
from snakejax.dynamics.sampled_signals import lagged, shaped
from snakejax.dynamics.signals import AbstractSignal, Joint

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model

SMOOTH_SIDE = 30.0
"""Steepness of the change between left and right, per unit of the input."""


class InputEffect(InputModifier):
    """A change of the signal of the input `input`."""

    input: ClassVar[str] = ""

    def shape(self, command: Scalar) -> Scalar:
        """The changed value of the input, where it depends on the value alone."""
        return command

    def acted(self, signal: AbstractSignal) -> AbstractSignal:
        """The changed signal."""
        return shaped(signal, self)

    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        return gait.changed(self.input, self.acted)

    def inapplicable_because(self, model: "Model") -> str | None:
        if self.input not in [given.name for given in model.board.inputs]:
            return f"a {model.board.noun} has no input `{self.input}`."
        return None


class InputLag(InputEffect):
    """tau y' = c - y: first-order lag of the input c; none for tau up to 1 ms."""

    description = "The input acts late, as through a first-order lag."
    once: ClassVar[bool] = True
    secant_step: ClassVar[dict[str, float]] = {"tau": 0.03}
    tau: Scalar = param("s", low=0.0, high=2.0, default=0.0)

    def acted(self, signal: AbstractSignal) -> AbstractSignal:
        return lagged(signal, jnp.asarray(self.tau))


class InputOffset(InputEffect):
    """y = c + o."""

    description = "The input has an offset: at zero it acts already."
    order: ClassVar[int] = 1
    o: Scalar = param("-", default=0.0)

    def shape(self, command: Scalar) -> Scalar:
        return command + self.o


class InputGain(InputEffect):
    """y = (1 + g) c."""

    description = "The input acts more strongly than commanded, or less."
    order: ClassVar[int] = 1
    g: Scalar = param("-", low=-0.99, default=0.0)

    def inapplicable_because(self, model: "Model") -> str | None:
        constant = model.board.gain_of.get(self.input, "")
        if constant in model.board.estimated:
            return f"`{constant}` is estimated, and does the same."
        return super().inapplicable_because(model)

    def shape(self, command: Scalar) -> Scalar:
        return (1 + self.g) * command


class InputAsymmetry(InputEffect):
    """y = (1 + a tanh(30 c)) c: for a > 0 the input acts more strongly to the left than to the right."""

    description = "The input acts more strongly to one side than to the other."
    order: ClassVar[int] = 2
    a: Scalar = param("-", low=-0.9, high=0.9, default=0.0)

    def shape(self, command: Scalar) -> Scalar:
        return (1 + self.a * jnp.tanh(SMOOTH_SIDE * command)) * command


class InputCurvature(InputEffect):
    """y = c / sqrt(1 + kappa c^2): large inputs act less than in proportion."""

    description = "Large inputs act less than in proportion, as a linkage near its end does."
    order: ClassVar[int] = 3
    secant_step: ClassVar[dict[str, float]] = {"kappa": 0.3}
    kappa: Scalar = param("-", low=0.0, high=20.0, default=0.0)

    def shape(self, command: Scalar) -> Scalar:
        return command / jnp.sqrt(1 + self.kappa * command**2)


class _Fading(AbstractSignal):
    signal: AbstractSignal
    rate: Scalar

    def at(self, t: Scalar) -> Joint:
        c, slope, bend = self.signal.at(t)
        left = 1 - self.rate * t
        return Joint(left * c, left * slope - self.rate * c, left * bend - 2 * self.rate * slope)


class InputFading(InputEffect):
    """y = (1 - b t) c: the input becomes weaker with the time t of the run, as with a discharging battery."""

    description = "The drive loses force in the course of a run: an emptying battery."
    order: ClassVar[int] = 4
    b: Scalar = param("1/s", default=0.0)

    def acted(self, signal: AbstractSignal) -> AbstractSignal:
        return _Fading(signal, jnp.asarray(self.b))
