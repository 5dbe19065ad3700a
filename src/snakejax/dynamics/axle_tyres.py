"""Tyres that depend on the load, and different tyres on two axles."""

import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param

from .tyres import AbstractTyre, Pacejka


class FrontRear(AbstractTyre):
    """One tyre for the wheels whose axle is "front", another for all others; parameters are tyre.front.B and so on."""

    front: AbstractTyre
    rear: AbstractTyre

    def of_axle(self, axle: str) -> AbstractTyre:
        """`front` on the axle "front", else `rear`."""
        return self.front if axle == "front" else self.rear

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        """Not defined without an axle. **Raises:** `TypeError`."""
        raise TypeError("Tyres by axle have a force on an axle only: `of_axle` comes first.")

    def scaled(self, grip: Scalar) -> "FrontRear":
        """Both tyres with the friction of the ground multiplied by `grip`."""
        return FrontRear(self.front.scaled(grip), self.rear.scaled(grip))


class Linear(AbstractTyre):
    """A force in proportion to the slip angle and the load, F = mu C_S F_z slip (CommonRoad vehicle models, 2020).

    `load` [N] is that of the wheel; `under` sets it.
    """

    C_S: Scalar = param("1/rad", positive=True)
    mu: Scalar = param("-", positive=True, default=1.0)
    load: Scalar = param("N", positive=True, default=1.0)

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        """mu C_S F_z slip [N]."""
        del lateral
        return self.mu * self.C_S * self.load * slip

    def scaled(self, grip: Scalar) -> "Linear":
        """The same tyre with mu multiplied by `grip`."""
        return Linear(self.C_S, self.mu * grip, self.load)

    def under(self, load: Scalar) -> "Linear":
        """The same tyre under `load` [N]."""
        return Linear(self.C_S, self.mu, load)


class LoadedPacejka(AbstractTyre):
    """The magic formula with its peak and its stiffness from the load F_z (Pacejka 2012, eqs. 4.E22, 4.E23 and 4.E25).

        df = (F_z - F_0) / F_0    D = (mu + mu_load df) F_z    B C D = stiffness F_0 sin(2 atan(F_z / (peak F_0)))

    `nominal` F_0 [N]; `stiffness` pKy1 [1/rad]; `peak` pKy2: the load of greatest stiffness over F_0; `mu`, `mu_load`
    pDy1, pDy2. Camber and shifts are left out.
    """

    stiffness: Scalar = param("1/rad", positive=True)
    mu: Scalar = param("-", positive=True)
    nominal: Scalar = param("N", positive=True)
    C: Scalar = param("-", high=2.0, positive=True, default=1.4)
    E: Scalar = param("-", high=1.0, default=0.0)
    peak: Scalar = param("-", positive=True, default=1.5)
    mu_load: Scalar = param("-", default=0.0)
    load: Scalar | None = param("N", positive=True, default=None)

    def at_load(self) -> Pacejka:
        """The coefficients at the load, by default the nominal one."""
        load = self.nominal if self.load is None else self.load
        D = (self.mu + self.mu_load * (load - self.nominal) / self.nominal) * load
        K = self.stiffness * self.nominal * jnp.sin(2 * jnp.arctan(load / (self.peak * self.nominal)))
        return Pacejka(K / (self.C * D), self.C, D, self.E)

    def force(self, slip: Scalar, lateral: Scalar) -> Scalar:
        """The magic formula at the load [N]."""
        return self.at_load().force(slip, lateral)

    def scaled(self, grip: Scalar) -> Pacejka:
        """The coefficients at the load with D multiplied by `grip`."""
        return self.at_load().scaled(grip)

    def under(self, load: Scalar) -> "LoadedPacejka":
        """The same tyre under `load` [N]."""
        parts = (self.stiffness, self.mu, self.nominal, self.C, self.E, self.peak, self.mu_load)
        return LoadedPacejka(*parts, load=load)
