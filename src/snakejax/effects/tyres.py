"""Deviations from the tyre law: offsets, relaxation, and variation of the friction."""

from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.contact import Motion, Wheel
from snakejax.dynamics.ports import LateralForce, TyreModifier, TyreState
from snakejax.dynamics.tyres import AbstractTyre, Bakker, Pacejka, Rayleigh

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model


def _no_slip_angle(model: "Model") -> str | None:
    if isinstance(model.tyre.of_axle("front"), Rayleigh):
        return "the Rayleigh force depends on the slip speed, not on the slip angle."
    return None


class GripSplit(LateralForce):
    """The wheelsets differ in grip.

        F_i (1 + s) for wheelsets ahead of the middle        F_i (1 - s) for wheelsets behind it

    Positive s: the front wheelset grips more than the back one.
    """

    description = "The front wheelset grips better than the back one, or worse."
    unobservable_because = "under the coupled structure with opposite wheel angles both wheelsets share one slip."
    s: Scalar = param("-", low=-0.99, high=0.99, default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return force * jnp.where(wheel.wheelset.place > 0, 1 + self.s, 1 - self.s)

    def inapplicable_because(self, model: "Model") -> str | None:
        if isinstance(model.tyre, FrontRear):
            return "each axle has a tyre of its own, whose parameters say the same."
        if len({wheelset.place > 0 for wheelset in model.board.wheelsets}) < 2:
            return f"all wheels of a {model.board.noun} are on one side of its middle, so the tyre says the same."
        return super().inapplicable_because(model)


class StribeckGrip(LateralForce):
    """The lateral force F_i differs from the tyre law at small slip speed.

        F_i (1 + s exp(-(v_i / v_s)^2))

    v_s = `speed` = 0.05 m/s is the Stribeck speed, v_i the lateral slip speed. Positive s: more grip at small slip
    speed.
    """

    description = "The tyre grips harder (or less) while it barely slips than when it slides."
    s: Scalar = param("-", low=-0.99, default=0.0)
    speed: ClassVar[float] = 0.05

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return force * (1 + self.s * jnp.exp(-((wheel.lateral / self.speed) ** 2)))


class GripGradient(TyreModifier):
    """The friction of the ground changes along the x axis of the cameras; B is unchanged.

        D (1 + g x), or k_s (1 + g x)

    x [m] is the position of the centre of mass. Positive g: more grip at larger x.
    """

    description = "The ground grips better at one side of the arena than at the other."
    g: Scalar = param("1/m", default=0.0)

    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        return tyre.scaled(1 + self.g * motion.x)


class TyreOffset(TyreModifier):
    """Offsets of the magic formula (paper eq. 5): the lateral force is not zero at zero slip.

        F = D sin(C atan(B eta)) + dSv        eta = (1 - E)(delta + dSh) + (E / B) atan(B (delta + dSh))

    A positive F acts to the right of the wheel, against a positive slip to its left. Positive dSv: added to F at every
    slip. Positive dSh: added to the slip angle delta.
    """

    description = "The tyre pulls to one side: its force is not zero at zero slip (camber, ply steer)."
    dSh: Scalar = param("rad", default=0.0)
    dSv: Scalar = param("N", default=0.0)

    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        del motion
        if isinstance(tyre, Bakker):
            tyre = tyre.coefficients()
        if not isinstance(tyre, Pacejka):
            raise TypeError(f"TyreOffset needs a Pacejka tyre, but the tyre is {type(tyre).__name__}.")
        return eqx.tree_at(lambda p: (p.dSh, p.dSv), tyre, (tyre.dSh + self.dSh, tyre.dSv + self.dSv))

    def inapplicable_because(self, model: "Model") -> str | None:
        return _no_slip_angle(model) or super().inapplicable_because(model)


class TyreRelaxation(TyreState):
    """The tyre builds up its force only over a rolled distance: m takes the place of the slip angle delta.

        dm/dt = (|a_i| + 0.02 m/s) / sigma (delta - m), m = 0 at the start; m = delta for sigma = 0

    Positive sigma: the force follows the slip after a rolled distance of about sigma. The speed 0.02 m/s keeps the
    relaxation finite at rest. A sigma between 0 and 1 mm acts as 1 mm: recordings do not distinguish a shorter one from
    zero, and the equations would be stiff.
    """

    description = "The tyre builds up its force only after rolling some distance (relaxation length)."
    secant_step: ClassVar[dict[str, float]] = {"sigma": 0.02}
    sigma: Scalar = param("m", low=0.0, default=0.0)

    def rate(self, memory: Scalar, slip: Scalar, wheel: Wheel) -> Scalar:
        lagging = self.sigma > 0
        length = jnp.where(lagging, jnp.maximum(self.sigma, 1e-3), 1.0)
        return jnp.where(lagging, (jnp.abs(wheel.rolling) + 0.02) / length * (slip - memory), 0.0)

    def slip(self, memory: Scalar, slip: Scalar) -> Scalar:
        return jnp.where(self.sigma > 0, memory, slip)

    def inapplicable_because(self, model: "Model") -> str | None:
        return _no_slip_angle(model) or super().inapplicable_because(model)
