"""Effects on driven wheels: drag, friction of the drive train, load transfer, the friction ellipse; and the inertia."""

from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.contact import Motion, Wheel
from snakejax.dynamics.ports import Geometry, LateralForce, RollingForce, nothing_to_move
from snakejax.dynamics.vehicle import AbstractVehicle

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model

SMOOTH_SPEED = 0.13
"""Speed [m/s] below which the friction of a drive train fades out."""
SMOOTH_ANGLE = 0.03
"""Steering angle [rad] below which its drag grows with the square."""


def _not_driven(model: "Model") -> str | None:
    if type(model.board).drive is AbstractVehicle.drive:
        return f"no force drives the wheels of a {model.board.noun}."
    return None


class SpeedResistance(RollingForce):
    """T_i = f_1 a_i + f_2 a_i |a_i|: resistance to rolling that grows with speed, half of it for each of two wheels."""

    description = "Resistance to rolling grows with speed."
    f_1: Scalar = param("N s/m", default=0.0)
    f_2: Scalar = param("N s^2/m^2", default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        total = self.f_1 * wheel.rolling + self.f_2 * wheel.rolling * jnp.abs(wheel.rolling)
        return total / len(motion.wheels)


class DriveFriction(RollingForce):
    """T_i = f tanh(a_i / 0.13 m/s) / wheels: Coulomb friction of the drive train, shared by the wheels."""

    description = "The drive train has a friction that does not depend on speed."
    f: Scalar = param("N", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        return self.f * jnp.tanh(wheel.rolling / SMOOTH_SPEED) / len(motion.wheels)

    def inapplicable_because(self, model: "Model") -> str | None:
        return _not_driven(model) or super().inapplicable_because(model)


class SteeringDrag(RollingForce):
    """T_i = k (sqrt(d_i^2 + d_0^2) - d_0) tanh(a_i / 0.15 m/s): drag of a wheel that is steered by d_i; d_0 = 0.03."""

    description = "Steered wheels drag beyond what their tyres explain."
    k: Scalar = param("N/rad", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        size = jnp.sqrt(wheel.joint.angle**2 + SMOOTH_ANGLE**2) - SMOOTH_ANGLE
        return self.k * size * jnp.tanh(wheel.rolling / 0.15)

    def inapplicable_because(self, model: "Model") -> str | None:
        if not any(wheelset.steer or wheelset.steering for wheelset in model.board.wheelsets):
            return f"no wheel of a {model.board.noun} is steered against the body that carries it."
        return super().inapplicable_because(model)


class LoadTransfer(LateralForce):
    """F_i (1 + dN_i / N_i), dN_i = -h F (x_i - x_m) / sum_j (x_j - x_m)^2: the driving force F tips the body.

    x_i [m] are the places of the wheels along the body, x_m their mean, N_i their loads at rest.
    """

    description = "Driving shifts load from the front to the rear wheels, and their grip with it."
    h: Scalar = param("m", low=-0.2, high=2.0, default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        assert motion.drive is not None
        angles = {name: joint.angle for name, joint in motion.inputs.items()}
        places = [motion.board.placement(one.wheelset, angles).x for one in motion.wheels]
        middle = sum(places) / len(places)
        spread = sum((x - middle) ** 2 for x in places)
        own = motion.board.placement(wheel.wheelset, angles).x - middle
        shift = -self.h * sum(motion.drive) * own / spread
        return force * (1 + shift / motion.board.load(wheel.wheelset))

    def inapplicable_because(self, model: "Model") -> str | None:
        return _not_driven(model) or super().inapplicable_because(model)


class CombinedSlip(LateralForce):
    """F_i sqrt(1 - (rho X_i / N_i)^2): a wheel that pulls with X_i under the load N_i has less grip to the side.

    The friction ellipse (Pacejka 2012, section 3.2; Gillespie 1992, section 10); what is left is at least 1%.
    """

    description = "A wheel that drives or brakes has less grip to the side."
    secant_step: ClassVar[dict[str, float]] = {"rho": 0.5}
    rho: Scalar = param("-", low=0.0, high=3.0, default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        assert motion.drive is not None
        pulled = sum(
            X for X, one in zip(motion.drive, motion.board.wheelsets, strict=True) if one.name == wheel.wheelset.name
        )
        used = (self.rho * pulled / motion.board.load(wheel.wheelset)) ** 2
        return force * jnp.sqrt(jnp.maximum(1 - used, 1e-4))

    def inapplicable_because(self, model: "Model") -> str | None:
        return _not_driven(model) or super().inapplicable_because(model)


class InertiaFactor(Geometry):
    """inertia (1 + g): the yaw inertia differs from the value in case.toml."""

    description = "The yaw inertia is larger than stated, or smaller."
    equivalent_constant: ClassVar[dict[str, str]] = {"g": "inertia"}
    g: Scalar = param("-", low=-0.9, default=0.0)

    def board(self, board: AbstractVehicle) -> AbstractVehicle:
        return eqx.tree_at(lambda b: b.inertia, board, board.inertia * (1 + self.g))  # type: ignore[attr-defined]

    def inapplicable_because(self, model: "Model") -> str | None:
        if getattr(model.board, "inertia", None) is None:
            return f"the inertia of this {model.board.noun} follows from its mass."
        return nothing_to_move(model)
