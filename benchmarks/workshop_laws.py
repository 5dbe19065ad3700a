"""Eight effects of cables, bearings, floors and rotors, written without knowledge of the search for laws."""

import jax.numpy as jnp
from law_parts import size, softplus, world, wrench_at

from snakejax import Force, LateralForce, RollingForce, Scalar, param


class TrailingCable(Force):
    """A cable from an outlet at (-0.6, 0.3) m lies on the floor and is dragged along by the tail of the board, 0.3 m
    behind the centre: a dry friction of a for each metre between the outlet and the tail, against the tail's motion."""

    a: Scalar = param("N/m", default=0.0)

    def wrench(self, motion):
        x, y = world(motion, -0.3)
        along, across = motion.u, motion.w - 0.3 * motion.r
        friction = -self.a * size(x + 0.6, y - 0.3, floor=0.05) / size(along, across, floor=0.02)
        return wrench_at(friction * along, friction * across, -0.3)


class LockedAxles(Force):
    """The two wheels of a wheelset are keyed to one axle and must roll alike: as the axle turns about the vertical,
    one slides forwards and one backwards, with a moment of up to a against the turn, half-way at a curvature of the
    path of some 1 per metre."""

    a: Scalar = param("N m", default=0.0)

    def wrench(self, motion):
        def of(wheel):
            curvature = (motion.r + wheel.joint.rate) / size(wheel.rolling, floor=0.05)
            return -self.a * jnp.tanh(curvature / 2.0)

        N = sum(of(wheel) for wheel in motion.wheels)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class ColdGrease(RollingForce):
    """The grease of the wheel bearings is stiff at first: each wheelset is held in its rolling with a, which dies away
    within some 4 s as the bearings work themselves warm."""

    a: Scalar = param("N", default=0.0)

    def resistance(self, wheel, motion):
        return self.a * jnp.exp(-motion.time / 4.0) * jnp.tanh(wheel.rolling / 0.03)


class WheelSeal(RollingForce):
    """A wheel that slides to the side is pushed along its shaft against the seal of its bearing, which holds its
    rolling with up to a, half of it at a slip speed of 0.015 m/s."""

    a: Scalar = param("N", default=0.0)

    def resistance(self, wheel, motion):
        rub = wheel.lateral**2 / (wheel.lateral**2 + 0.015**2)
        return self.a * rub * jnp.tanh(wheel.rolling / 0.03)


class UnbalancedRotor(Force):
    """The mass of the rotor is off its axis by some millimetres, towards 0.6 rad: the axis is pulled outwards as the
    rotor turns, and pushed back as it is sped up; a is the mass times its distance."""

    a: Scalar = param("kg m", default=0.0)

    def wrench(self, motion):
        angle, turn = motion.rotor.angle + 0.6, motion.rotor.rate + motion.r
        outwards, back = self.a * turn**2, self.a * motion.rotor.acceleration
        X = outwards * jnp.cos(angle) + back * jnp.sin(angle)
        Y = outwards * jnp.sin(angle) - back * jnp.cos(angle)
        return X, Y, jnp.zeros_like(X)


class Checkerboard(LateralForce):
    """The floor is laid with tiles of 0.5 m of two kinds, as a chessboard: a wheelset grips better by the share g on
    those of one kind, and worse on those of the other."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        x, y = world(motion, motion.board.arm(wheel.wheelset))
        tile = jnp.sin(jnp.pi * (x - 0.1) / 0.5) * jnp.sin(jnp.pi * (y + 0.35) / 0.5)
        return force * (1 + self.g * jnp.tanh(3 * tile))


class TwistedTether(Force):
    """A stiff cable from a trolley at the ceiling, which follows the board, is twisted as the board turns: beyond a
    play of 0.25 rad to either side of the heading 0.1 rad it turns the board back, with k for each rad."""

    k: Scalar = param("N m/rad", default=0.0)

    def wrench(self, motion):
        left, right = softplus(motion.theta - 0.35, 0.05), softplus(-0.15 - motion.theta, 0.05)
        N = -self.k * (left - right)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class RotorFan(Force):
    """The fan that cools the motor turns with the rotor and blows across the deck: a thrust of a through the axis of
    the rotor, in a direction that is 0.5 rad ahead of the rotor's angle."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        angle = motion.rotor.angle + 0.5
        X, Y = self.a * jnp.cos(angle), self.a * jnp.sin(angle)
        return X, Y, jnp.zeros_like(X)


WORKSHOP = {
    "trailing_cable": (TrailingCable(0.05), "world_position"),
    "unbalanced_rotor": (UnbalancedRotor(0.02), "rotor_rate"),
    "locked_axles": (LockedAxles(0.03), "yaw_rate"),
    "checkerboard": (Checkerboard(0.35), "world_position"),
    "cold_grease": (ColdGrease(0.06), "time"),
    "twisted_tether": (TwistedTether(0.15), "heading"),
    "wheel_seal": (WheelSeal(0.2), "slip"),
    "rotor_fan": (RotorFan(0.08), "rotor_angle"),
}
"""Effects by name, and the variable on which each depends most; by turns on a board that is free and coupled."""
