"""What a tyre may do beyond its law: offsets, lag, uneven or uncertain grip."""

from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax.numpy as jnp

from .._effect import Floor, Grip, Memory, Motion, Wheel
from .._skid import Ideal
from .._tyre import AbstractTyre, Bakker, Pacejka, Rayleigh
from .._units import Scalar, param

if TYPE_CHECKING:
    from .._model import Model


def _needs_traction(model: "Model") -> str | None:
    if isinstance(model.skid, Ideal):
        return "the ideal board does not skid, so its tyres have no lateral force to change."
    return None


def _needs_slip_angle(model: "Model") -> str | None:
    if isinstance(model.tyre, Rayleigh):
        return "the Rayleigh force follows the slip speed and knows no slip angle."
    return _needs_traction(model)


class GripSplit(Grip):
    """Lateral force of wheelsets ahead of the middle x (1 + s), of those behind it x (1 - s)."""

    sentence = "The front wheelset grips better than the back one, or worse."
    silent = "under the coupled structure with opposite wheel angles both wheelsets share one slip."
    s: Scalar = param("-", low=-0.99, high=0.99, default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return force * (1 + self.s) if wheel.wheelset.place > 0 else force * (1 - self.s)

    def refusal(self, model: "Model") -> str | None:
        return _needs_traction(model)


class StribeckGrip(Grip):
    """Lateral force x (1 + s exp(-(v_i / 0.05 m/s)^2))."""

    sentence = "The tyre grips harder (or less) while it barely slips than when it slides."
    s: Scalar = param("-", low=-0.99, default=0.0)
    speed: ClassVar[float] = 0.05

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return force * (1 + self.s * jnp.exp(-((wheel.lateral / self.speed) ** 2)))

    def refusal(self, model: "Model") -> str | None:
        return _needs_traction(model)


class GripGradient(Floor):
    """D (or k_s) x (1 + g x) with x the world coordinate of the centre of mass [m]."""

    sentence = "The floor grips better at one side of the arena than at the other."
    g: Scalar = param("1/m", default=0.0)

    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        return tyre.scaled(1 + self.g * motion.x)

    def refusal(self, model: "Model") -> str | None:
        return _needs_traction(model)


class TyreOffset(Floor):
    """The offsets of the magic formula (paper eq. 5): dSh added to the slip angle, dSv to the force."""

    sentence = "The tyre pulls to one side: its force is not zero at zero slip (camber, ply steer)."
    dSh: Scalar = param("rad", default=0.0)
    dSv: Scalar = param("N", default=0.0)

    def tyre(self, tyre: AbstractTyre, motion: Motion) -> AbstractTyre:
        del motion
        if isinstance(tyre, Bakker):
            tyre = tyre.coefficients()
        if not isinstance(tyre, Pacejka):
            raise TypeError(f"TyreOffset needs a Pacejka tyre, but the tyre is {type(tyre).__name__}.")
        return eqx.tree_at(lambda p: (p.dSh, p.dSv), tyre, (tyre.dSh + self.dSh, tyre.dSv + self.dSv))

    def refusal(self, model: "Model") -> str | None:
        return _needs_slip_angle(model)


class TyreRelaxation(Memory):
    """The slip angle reaches the tyre with a lag: dm/dt = (|a_i| + 0.02 m/s) / sigma (delta - m); sigma = 0: no lag.

    A sigma between 0 and 1 mm acts as 1 mm: so short a lag cannot be told from none, and
    would only stiffen the equations.
    """

    sentence = "The tyre builds up its force only after rolling some distance (relaxation length)."
    probe: ClassVar[dict[str, float]] = {"sigma": 0.02}
    sigma: Scalar = param("m", low=0.0, default=0.0)

    def rate(self, memory: Scalar, slip: Scalar, wheel: Wheel) -> Scalar:
        lagging = self.sigma > 0
        length = jnp.where(lagging, jnp.maximum(self.sigma, 1e-3), 1.0)
        return jnp.where(lagging, (jnp.abs(wheel.rolling) + 0.02) / length * (slip - memory), 0.0)

    def slip(self, memory: Scalar, slip: Scalar) -> Scalar:
        return jnp.where(self.sigma > 0, memory, slip)

    def refusal(self, model: "Model") -> str | None:
        return _needs_slip_angle(model)
