"""Tyre laws: the lateral force of one wheelset against its slip."""

import abc

import equinox as eqx
import jax.numpy as jnp

from snakejax.core.fast_math import arctan, sine_cosine
from snakejax.core.parameter import Parametrised, Scalar, param


class AbstractTyre(Parametrised):
    """The lateral force of one wheelset as a function of its slip."""

    @abc.abstractmethod
    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        """Lateral force [N], positive against positive slip.

        **Arguments:** `slip`: slip angle [rad]; `lateral`: lateral slip speed [m/s].
        """

    @abc.abstractmethod
    def scaled(self, grip: Scalar) -> "AbstractTyre":
        """The same tyre with the friction of the ground multiplied by `grip`: scales D (or k_s), not B."""

    def of_axle(self, axle: str) -> "AbstractTyre":
        """The tyre of the wheels on `axle`: by default the same on all."""
        del axle
        return self

    def under(self, load: Scalar) -> "AbstractTyre":
        """The tyre under a vertical `load` [N]: by default its force does not depend on it."""
        del load
        return self


class Pacejka(AbstractTyre):
    """The magic formula (paper eq. 5; Bakker, Nyborg, Pacejka 1987), angles in radians.

        F = D sin(C atan(B eta)) + dSv,   eta = (1 - E)(delta + dSh) + (E / B) atan(B (delta + dSh))

    Domains: B > 0, 0 < C <= 2, D >= 0, E <= 1; outside them the force can reverse against the slip.
    """

    B: Scalar = param("1/rad", positive=True)
    C: Scalar = param("-", high=2.0, positive=True, typical=(1.4, 0.3))
    D: Scalar = param("N", low=0.0, multiplicative=True)
    E: Scalar = param("-", high=1.0, typical=(0.0, 0.7))
    dSh: Scalar = param("rad", default=0.0)
    dSv: Scalar = param("N", default=0.0)

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        del lateral
        delta = slip + self.dSh
        eta = (1 - self.E) * delta + self.E / self.B * arctan(self.B * delta)
        return self.D * sine_cosine(self.C * arctan(self.B * eta))[0] + self.dSv

    def scaled(self, grip: Scalar) -> "Pacejka":
        return Pacejka(self.B, self.C, self.D * grip, self.E, self.dSh, self.dSv)


class Rayleigh(AbstractTyre):
    """Viscous lateral friction, F = k_s v (paper eq. 1, from the dissipation function R = k_s v^2 / 2)."""

    k_s: Scalar = param("N s/m", low=0.0, multiplicative=True)

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        del slip
        return self.k_s * lateral

    def scaled(self, grip: Scalar) -> "Rayleigh":
        return Rayleigh(self.k_s * grip)


_A = (-22.1, 1011.0, 1078.0, 1.82, 0.208, 0.0, -0.354, 0.707, 0.028, 0.0, 14.8, 0.022)
"""Coefficients a1 to a12 (Bakker, Nyborg and Pacejka 1987), with loads in kN and angles in degrees."""
_DEGREES = 180 / jnp.pi
"""Degrees in a radian."""


class Bakker(AbstractTyre):
    """A car tyre with six coefficients from load and camber (Bakker, Nyborg and Pacejka 1987, SAE 870421).

    With Fz the load in kN, gamma the camber and delta the slip angle in degrees, forces in N:

        C = 1.30    D = a1 Fz^2 + a2 Fz    BCD = a3 sin(a4 atan(a5 Fz))    E = a6 Fz^2 + a7 Fz + a8
        B = BCD / (C D) (1 - a12 |gamma|)    dSh = a9 gamma    dSv = (a10 Fz^2 + a11 Fz) gamma

    **Arguments:** `load` [N] on the wheelset; `camber` [rad]; `offsets`: False leaves dSh and dSv out.
    """

    load: Scalar = param("N", positive=True)
    camber: Scalar = param("rad", default=0.0)
    offsets: bool = eqx.field(static=True, default=True)

    def coefficients(self) -> Pacejka:
        """The six coefficients, converted to radians: B [1/rad], C, D [N], E, dSh [rad], dSv [N]."""
        kilo, gamma = self.load / 1000.0, self.camber * _DEGREES
        peak = _A[0] * kilo**2 + _A[1] * kilo
        stiffness = _A[2] * jnp.sin(_A[3] * jnp.arctan(_A[4] * kilo))
        B = stiffness / (1.30 * peak) * (1 - _A[11] * jnp.abs(gamma))
        E = _A[5] * kilo**2 + _A[6] * kilo + _A[7]
        dSh = _A[8] * gamma / _DEGREES
        dSv = (_A[9] * kilo**2 + _A[10] * kilo) * gamma
        if not self.offsets:
            dSh, dSv = jnp.zeros_like(dSh), jnp.zeros_like(dSv)
        return Pacejka(B * _DEGREES, 1.30, peak, E, dSh, dSv)

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        return self.coefficients().force(slip, lateral)

    def scaled(self, grip: Scalar) -> Pacejka:
        return self.coefficients().scaled(grip)
