"""Twelve effects of forms that differ from those of `boards`, written without knowledge of the search for laws."""

import jax
import jax.numpy as jnp

import snakejax as sj
from snakejax import Force, LateralForce, Scalar

GRAVITY = 9.81


def _softplus(a, width):
    """The part of `a` above zero, with a corner that is round over `width`."""
    return width * jax.nn.softplus(a / width)


def _size(a, floor):
    """|a|, round below `floor`."""
    return jnp.sqrt(a**2 + floor**2)


# One variable, by an unusual curve.


class LopsidedDrag(Force):
    """A drag along the body that is nine times as steep forwards (1.8 c) as backwards (0.2 c)."""

    c: Scalar = sj.param("N s/m", default=0.0)

    def wrench(self, motion):
        X = -self.c * (motion.u + 0.8 * (_size(motion.u, 0.05) - 0.05))
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


class SlackCable(Force):
    """A yaw moment of a cable that goes taut beyond a steering of 0.25 rad, and twice as stiff below -0.45 rad."""

    k: Scalar = sj.param("N m/rad", default=0.0)

    def wrench(self, motion):
        angle = motion.steering.angle
        N = -self.k * (_softplus(angle - 0.25, 0.04) - 2 * _softplus(-angle - 0.45, 0.04))
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class Squeal(LateralForce):
    """A grip with a Lorentzian dip of the share g where a wheel slips to its left at 0.02 m/s."""

    g: Scalar = sj.param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        return force * (1 - self.g / (1 + ((wheel.lateral - 0.02) / 0.01) ** 2))


class RootPull(Force):
    """A force forwards with the square root of the size of the rotor rate, rounded below 0.2 rad/s."""

    a: Scalar = sj.param("N s^(1/2)/rad^(1/2)", default=0.0)

    def wrench(self, motion):
        X = self.a * (jnp.sqrt(_size(motion.rotor.rate, 0.2)) - 0.2**0.5)
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


# Two variables, not as a product.


class Belt(Force):
    """A friction along the body against a sliding speed u - 0.2 psi that the angle of the rotor shifts."""

    a: Scalar = sj.param("N", default=0.0)

    def wrench(self, motion):
        X = -self.a * jnp.arctan((motion.u - 0.2 * motion.rotor.angle) / 0.1)
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


class TwoHills(Force):
    """The slope force on a ground with a round hill of height h and a wider one of 0.7 h, on a board of 7 kg."""

    h: Scalar = sj.param("m", default=0.0)

    def wrench(self, motion):
        def slope(x0, y0, width, share):
            dx, dy = motion.x - x0, motion.y - y0
            steep = self.h * share / width**2 * jnp.exp(-(dx**2 + dy**2) / (2 * width**2))
            return steep * dx, steep * dy

        (a, b), (c, d) = slope(0.3, -0.1, 0.35, 1.0), slope(1.1, 0.3, 0.5, 0.7)
        X, Y = motion.into_body(7.0 * GRAVITY * (a + c), 7.0 * GRAVITY * (b + d))
        return X, Y, jnp.zeros_like(X)


class Softening(LateralForce):
    """A grip that gives way by the share g once the time and the size of the steering rate together pass a level."""

    g: Scalar = sj.param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        level = motion.time / 1.5 + _size(motion.steering.rate, 0.1) - 5
        return force * (1 - self.g * jax.nn.sigmoid(level))


# Text-book forms.


class EddyBrake(Force):
    """An eddy-current brake of the body: a drag c v / (1 + (v/v0)^2) with v0 = 0.12 m/s."""

    c: Scalar = sj.param("N s/m", default=0.0)

    def wrench(self, motion):
        drag = self.c / (1 + (motion.u**2 + motion.w**2) / 0.12**2)
        return -drag * motion.u, -drag * motion.w, jnp.zeros_like(motion.u)


class PivotStribeck(Force):
    """Friction against yaw: a Coulomb part a and a Stribeck part b that fades as exp(-|r| / 0.3 rad/s)."""

    a: Scalar = sj.param("N m", default=0.0)
    b: Scalar = sj.param("N m", default=0.0)

    def wrench(self, motion):
        fading = jnp.exp(-_size(motion.r, 0.02) / 0.3)
        N = -jnp.tanh(motion.r / 0.05) * (self.a + self.b * fading)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


# Periodic, but no sine.


class SawFloor(Force):
    """A force along x that is a rounded sawtooth of the position, with wave number 5 per metre."""

    a: Scalar = sj.param("N", default=0.0)

    def wrench(self, motion):
        phase = 5 * motion.x
        east = self.a * jnp.arctan(0.85 * jnp.sin(phase) / (1 - 0.85 * jnp.cos(phase)))
        X, Y = motion.into_body(east, jnp.zeros_like(east))
        return X, Y, jnp.zeros_like(X)


class Cogging(Force):
    """A yaw moment of the poles of the rotor's motor: six to a turn, with a second harmonic of half the size."""

    a: Scalar = sj.param("N m", default=0.0)

    def wrench(self, motion):
        angle = motion.rotor.angle
        N = -self.a * (jnp.sin(6 * angle) + 0.5 * jnp.sin(12 * angle + 0.7))
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class FourFans(Force):
    """A force forwards in narrow sectors of heading, a quarter turn apart, of which one is at 0.3 rad."""

    a: Scalar = sj.param("N", default=0.0)

    def wrench(self, motion):
        X = self.a * jnp.exp(4 * (jnp.cos(4 * (motion.heading - 0.3)) - 1))
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


UNUSUAL = {
    "lopsided_drag": (LopsidedDrag(0.8), "speed"),
    "slack_cable": (SlackCable(0.06), "steering_angle"),
    "squeal": (Squeal(0.6), "slip"),
    "root_pull": (RootPull(0.12), "rotor_rate"),
    "belt": (Belt(0.25), "rotor_angle"),
    "two_hills": (TwoHills(0.002), "world_position"),
    "softening": (Softening(0.4), "time"),
    "eddy_brake": (EddyBrake(3.0), "speed"),
    "pivot_stribeck": (PivotStribeck(0.015, 0.025), "yaw_rate"),
    "saw_floor": (SawFloor(0.2), "world_position"),
    "cogging": (Cogging(0.1), "rotor_angle"),
    "four_fans": (FourFans(0.3), "heading"),
}
"""Effects by name, and the variable on which each depends most."""
