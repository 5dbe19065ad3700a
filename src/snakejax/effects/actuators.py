"""What lies between the command and the wheel angle."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from .._board import Wheelset
from .._effect import Command, Linkage
from .._gait import Delayed, Gait, Joint, Scaled
from .._units import Scalar, param


def _on_steering(gait: Gait, change) -> Gait:
    back = None if gait.phi_back is None else change(gait.phi_back)
    return Gait(change(gait.phi), gait.psi, back)


class SteeringLag(Command):
    """The steering command is that of T seconds ago, and zero before time 0."""

    sentence = "The steering answers its command late."
    T: Scalar = param("s", low=0.0, default=0.0)

    def gait(self, gait: Gait) -> Gait:
        return _on_steering(gait, lambda signal: Delayed(signal, self.T))


class RotorLag(Command):
    """The rotor command is that of T seconds ago, and zero before time 0."""

    sentence = "The rotor answers its command late."
    T: Scalar = param("s", low=0.0, default=0.0)

    def gait(self, gait: Gait) -> Gait:
        return eqx.tree_at(lambda g: g.psi, gait, Delayed(gait.psi, self.T))


class SteeringGain(Command):
    """The steering command is (1 + g) times the command."""

    sentence = "The steering turns further than commanded, or less far."
    g: Scalar = param("-", default=0.0)

    def gait(self, gait: Gait) -> Gait:
        return _on_steering(gait, lambda signal: Scaled(signal, 1 + self.g))


class RotorGain(Command):
    """The rotor command is (1 + g) times the command."""

    sentence = "The rotor turns further than commanded, or less far."
    g: Scalar = param("-", default=0.0)

    def gait(self, gait: Gait) -> Gait:
        return eqx.tree_at(lambda g: g.psi, gait, Scaled(gait.psi, 1 + self.g))


class SteeringBacklash(Linkage):
    """Smooth dead zone: wheel angle = phi - b tanh(phi / b); b = 0 bypasses it."""

    sentence = "The steering has play: small joint angles do not reach the wheels."
    stage: ClassVar[int] = 0
    probe: ClassVar[dict[str, float]] = {"b": 0.02}
    b: Scalar = param("rad", low=0.0, default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        del wheelset
        loose = self.b > 0
        b = jnp.where(loose, self.b, 1.0)
        bend = jnp.tanh(joint.angle / b)
        slope = bend**2
        curve = 2 * bend * (1 - slope) / b
        changed = Joint(
            joint.angle - b * bend,
            slope * joint.rate,
            slope * joint.acceleration + curve * joint.rate**2,
        )
        return Joint(*(jnp.where(loose, new, old) for new, old in zip(changed, joint, strict=True)))


class SteeringOffset(Linkage):
    """phi_front += o, phi_back -= o: the steering is out of true, the board curves."""

    sentence = "The steering is not centred: straight ahead is a curve."
    o: Scalar = param("rad", default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        return joint._replace(angle=joint.angle + wheelset.steering * self.o)


class SteeringCrab(Linkage):
    """Both wheelsets += o: the board drives at an angle to its axis."""

    sentence = "Both wheelsets are turned the same way: the board crabs."
    o: Scalar = param("rad", default=0.0)

    def steer(self, joint: Joint, wheelset: Wheelset) -> Joint:
        del wheelset
        return joint._replace(angle=joint.angle + self.o)
