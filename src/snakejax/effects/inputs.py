"""Effects between command and wheel angle: lag, gain, backlash and offset."""

from typing import ClassVar

import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.ports import InputModifier, Linkage
from snakejax.dynamics.signals import Delayed, Joint, Scaled
from snakejax.dynamics.vehicle import Wheelset


class SteeringLag(InputModifier):
    """The steering answers its command late.

        phi(t) = phi_command(t - T), and 0 before t = T

    Positive T: late. A lag below zero has no physical cause; see `ClockOffset`.
    """

    description = "The steering answers its command late."
    T: Scalar = param("s", low=0.0, default=0.0)

    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        return gait.changed("phi", lambda signal: Delayed(signal, self.T))


class RotorLag(InputModifier):
    """The rotor answers its command late.

        psi(t) = psi_command(t - T), and 0 before t = T

    Positive T: late.
    """

    description = "The rotor answers its command late."
    T: Scalar = param("s", low=0.0, default=0.0)

    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        return gait.changed("psi", lambda signal: Delayed(signal, self.T))


class SteeringGain(InputModifier):
    """The steering turns further than commanded.

        phi = (1 + g) phi_command

    Positive g: further than commanded; negative g: less far.
    """

    description = "The steering turns further than commanded, or less far."
    g: Scalar = param("-", default=0.0)

    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        return gait.changed("phi", lambda signal: Scaled(signal, 1 + self.g))


class RotorGain(InputModifier):
    """The rotor turns further than commanded.

        psi = (1 + g) psi_command

    Positive g: further than commanded; negative g: less far. A relative error of the rotor inertia has the same effect.
    """

    description = "The rotor turns further than commanded, or less far."
    equivalent_constant: ClassVar[dict[str, str]] = {"g": "rotor_inertia"}

    g: Scalar = param("-", default=0.0)

    def gait(self, gait: AbstractInputs) -> AbstractInputs:
        return gait.changed("psi", lambda signal: Scaled(signal, 1 + self.g))


class SteeringBacklash(Linkage):
    """Play between steering joint and wheel, as a smooth dead zone.

        wheel angle = phi - b tanh(phi / b), and phi for b = 0

    Positive b: the wheel turns less than the joint, by at most b.
    """

    description = "The steering has play: small joint angles do not reach the wheels."
    order: ClassVar[int] = 0
    secant_step: ClassVar[dict[str, float]] = {"b": 0.02}
    b: Scalar = param("rad", low=0.0, default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        del wheelset
        has_play = self.b > 0
        b = jnp.where(has_play, self.b, 1.0)
        saturation = jnp.tanh(joint.angle / b)
        slope = saturation**2
        curvature = 2 * saturation * (1 - slope) / b
        changed = Joint(
            joint.angle - b * saturation,
            slope * joint.rate,
            slope * joint.acceleration + curvature * joint.rate**2,
        )
        return Joint(*(jnp.where(has_play, new, old) for new, old in zip(changed, joint, strict=True)))


class SteeringOffset(Linkage):
    """The steering is not centred: with the joint at zero the board drives a curve.

        phi_front += o        phi_back -= o

    Positive o: the front wheelset is turned counter-clockwise, and the board curves to the left as it rolls forward.
    """

    description = "The steering is not centred: straight ahead is a curve."
    o: Scalar = param("rad", default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        return joint._replace(angle=joint.angle + wheelset.steering * self.o)


class SteeringCrab(Linkage):
    """Both wheelsets are turned the same way: the board drives at an angle to its axis.

        phi_front += o        phi_back += o

    Positive o: both wheelsets are turned counter-clockwise, and the board drifts to the left as it rolls forward.
    """

    description = "Both wheelsets are turned the same way: the board crabs."
    o: Scalar = param("rad", default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        del wheelset
        return joint._replace(angle=joint.angle + self.o)
