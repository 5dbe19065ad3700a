"""Resistance to rolling, translation and yaw."""

import jax.numpy as jnp

from snakejax.core.fast_math import safe_norm
from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.contact import STICKING_SPEED, Motion, Wheel, Wrench
from snakejax.dynamics.ports import Force, RollingForce


class LongitudinalSlip(RollingForce):
    """Loss of drive in proportion to the rolling speed a_i (hypothesis of Salman et al. 2016 for the forward gait).

        T_i = k a_i

    T_i acts against the rolling of wheelset i. Positive k: it slows the wheelset, whichever way it rolls.
    """

    description = "The wheels lose drive by slipping along their rolling direction, in proportion to speed."
    k: Scalar = param("N s/m", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return self.k * wheel.rolling


class RollingResistance(RollingForce):
    """Coulomb friction of rolling, smoothed below `STICKING_SPEED` = 5 mm/s so that it can be integrated.

        T_i = f tanh(a_i / 5 mm/s)

    T_i acts against the rolling speed a_i of wheelset i. Positive f: it slows the wheelset, whichever way it rolls.
    """

    description = "Each wheelset resists rolling with a constant force."
    f: Scalar = param("N", low=0.0, default=0.0)

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return self.f * jnp.tanh(wheel.rolling / STICKING_SPEED)


class BodyDrag(Force):
    """Linear drag of the body.

        (X, Y) -= c (u, w)

    X and Y are the force along and across the body, u and w its velocities. Positive c: it slows the board.
    """

    description = "The body drags in proportion to speed: casters, a trailing cable."
    c: Scalar = param("N s/m", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        return -self.c * motion.u, -self.c * motion.w, jnp.zeros_like(motion.r)


class QuadraticDrag(Force):
    """Quadratic drag of the body.

        (X, Y) -= c |(u, w)| (u, w)

    X and Y are the force along and across the body, u and w its velocities. Positive c: it slows the board.
    """

    description = "The body drags with the square of speed, as in air."
    c: Scalar = param("N s^2/m^2", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        speed = safe_norm(motion.u, motion.w)
        return -self.c * speed * motion.u, -self.c * speed * motion.w, jnp.zeros_like(motion.r)


class YawDamping(Force):
    """Linear damping of the yaw rate r.

        N -= c r

    N is the yaw moment, positive counter-clockwise. Positive c: it slows the turning.
    """

    description = "Turning is damped in proportion to the yaw rate."
    c: Scalar = param("N m s", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, -self.c * motion.r


class YawFriction(Force):
    """Coulomb friction in yaw, smoothed below a yaw rate of 0.02 rad/s so that it can be integrated.

        N -= t tanh(r / 0.02 rad/s)

    N is the yaw moment, positive counter-clockwise. Positive t: it slows the turning.
    """

    description = "Turning is resisted by a constant moment: casters scrub."
    t: Scalar = param("N m", low=0.0, default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, -self.t * jnp.tanh(motion.r / 0.02)


class YawBias(Force):
    """Constant yaw moment.

        N += t

    Positive t: the moment turns the board counter-clockwise, seen from above.
    """

    description = "A constant moment turns the board: a twisted cable, a rotor drive that leans on the body."
    t: Scalar = param("N m", default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.r)
        return zero, zero, zero + self.t
