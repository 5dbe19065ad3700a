"""Resistance to rolling, translation and yaw."""

import jax.numpy as jnp

from snakejax.core.fast_math import safe_norm
from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.contact import Motion, Wheel, Wrench
from snakejax.dynamics.ports import Force, RollingForce


class LongitudinalSlip(RollingForce):
    """T_i = k a_i: the wheels slip along their rolling direction (hypothesis of Salman et al. 2016, forward gait)."""

    description = "The wheels lose drive by slipping along their rolling direction, in proportion to speed."
    k: Scalar = param("N s/m", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return self.k * wheel.rolling


class RollingResistance(RollingForce):
    """T_i = f tanh(a_i / 5 mm/s): Coulomb friction, smoothed below 5 mm/s so that it can be integrated."""

    description = "Each wheelset resists rolling with a constant force."
    f: Scalar = param("N", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return self.f * jnp.tanh(wheel.rolling / 0.005)


class BodyDrag(Force):
    """(X, Y) -= c (u, w): linear drag of the body."""

    description = "The body drags in proportion to speed: casters, a trailing cable."
    c: Scalar = param("N s/m", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        return -self.c * motion.u, -self.c * motion.w, jnp.zeros_like(motion.r)


class QuadraticDrag(Force):
    """(X, Y) -= c |(u, w)| (u, w): quadratic drag of the body."""

    description = "The body drags with the square of speed, as in air."
    c: Scalar = param("N s^2/m^2", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        speed = safe_norm(motion.u, motion.w)
        return -self.c * speed * motion.u, -self.c * speed * motion.w, jnp.zeros_like(motion.r)


class YawDamping(Force):
    """N -= c r: linear damping of the yaw rate."""

    description = "Turning is damped in proportion to the yaw rate."
    c: Scalar = param("N m s", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, -self.c * motion.r


class YawFriction(Force):
    """N -= t tanh(r / 0.02 rad/s): Coulomb friction in yaw, smoothed below 0.02 rad/s so that it can be integrated."""

    description = "Turning is resisted by a constant moment: casters scrub."
    t: Scalar = param("N m", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, -self.t * jnp.tanh(motion.r / 0.02)


class YawBias(Force):
    """N += t: constant yaw moment."""

    description = "A constant moment turns the board: a twisted cable, a rotor drive that leans on the body."
    t: Scalar = param("N m", default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, zero + self.t
