"""Twelve more effects that may act on a board in a laboratory, written without knowledge of the search for laws."""

import jax
import jax.numpy as jnp
from law_parts import GRAVITY, size, softplus, total, world, wrench_at

from snakejax import Force, LateralForce, Scalar, param

# Places.


class Trough(Force):
    """Two tilted sheets meet along a line through (0.6, 0.1) m in the direction 0.4 rad: the weight pulls with a down
    either of them, towards the line."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        across = 0.92 * (motion.y - 0.1) - 0.39 * (motion.x - 0.6)
        pull = -self.a * jnp.tanh(across / 0.1)
        X, Y = motion.into_body(-0.39 * pull, 0.92 * pull)
        return X, Y, jnp.zeros_like(X)


class Magnet(Force):
    """A magnet 0.35 m under the floor at (0.8, -0.1) m draws a steel plate 0.2 m ahead of the centre, with at most
    a."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        x, y = world(motion, 0.2)
        dx, dy = (0.8 - x) / 0.35, (-0.1 - y) / 0.35
        pull = 3.49 * self.a / (1 + dx**2 + dy**2) ** 2.5
        return wrench_at(*motion.into_body(pull * dx, pull * dy), 0.2)


class Ledge(Force):
    """The floor rises by h across a ramp that is some 0.3 m wide, along a line through (0.9, 0) m that is oblique to
    the axes; each wheelset bears half the weight of a board of 7 kg."""

    h: Scalar = param("m", default=0.0)

    def wrench(self, motion):
        def of(wheel):
            ahead = motion.board.arm(wheel.wheelset)
            x, y = world(motion, ahead)
            up = (0.96 * (x - 0.9) + 0.28 * y) / 0.15
            pull = -3.5 * GRAVITY * self.h / (2 * 0.15) / jnp.cosh(up) ** 2
            return wrench_at(*motion.into_body(0.96 * pull, 0.28 * pull), ahead)

        return total(of(wheel) for wheel in motion.wheels)


# The heading and the time.


class Sail(Force):
    """A steady wind towards 2.1 rad on a plate across the board: a force along the body as the square of the part of
    the wind that meets the plate."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        along = jnp.cos(motion.theta - 2.1)
        X = self.a * along * (size(along, floor=0.05) - 0.05)
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


class Ventilation(Force):
    """The air of a ventilation that switches on and off, on for half of every 5 s, pushes with a towards -0.6 rad."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        push = self.a * jax.nn.sigmoid(jnp.sin(2 * jnp.pi * motion.time / 5 - 0.8) / 0.15)
        X, Y = motion.into_body(0.825 * push, -0.565 * push)
        return X, Y, jnp.zeros_like(X)


# Speeds, rates and joints.


class Governor(Force):
    """A brake that weights throw out bites beyond 0.15 m/s, and holds the board with c for each m/s beyond."""

    c: Scalar = param("N s/m", default=0.0)

    def wrench(self, motion):
        speed = size(motion.u, motion.w, floor=0.01)
        hold = -self.c * softplus(speed - 0.15, 0.02) / speed
        return hold * motion.u, hold * motion.w, jnp.zeros_like(hold)


class ServoDrag(Force):
    """The pads of the steering press on the wheels while it moves: each wheelset is held in its rolling with c times
    the size of the rate of the steering."""

    c: Scalar = param("N s/rad", default=0.0)

    def wrench(self, motion):
        def of(wheel):
            press = self.c * (size(wheel.joint.rate, floor=0.1) - 0.1)
            hold = -press * jnp.tanh(wheel.rolling / 0.03)
            return wrench_at(hold * wheel.cosine, hold * wheel.sine, motion.board.arm(wheel.wheelset))

        return total(of(wheel) for wheel in motion.wheels)


class HeavyRotor(Force):
    """The mass of the rotor is off its axis, on a floor that slopes: the yaw moment of its weight, at most a, turns the
    heavy side of the rotor down the slope, towards 0.6 rad in the world."""

    a: Scalar = param("N m", default=0.0)

    def wrench(self, motion):
        N = -self.a * jnp.sin(motion.theta + motion.rotor.angle - 0.6)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


# Other contacts, at points of the body.


class FixedCastor(Force):
    """A small wheel 0.45 m ahead of the centre, which cannot steer, rolls freely along the board and slides across it
    with a dry friction a."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        Y = -self.a * jnp.tanh((motion.w + 0.45 * motion.r) / 0.04)
        return wrench_at(jnp.zeros_like(Y), Y, 0.45)


class RotorBrush(Force):
    """A brush at the end of the rotor, 0.2 m from its axis, sweeps the floor with a dry friction a against the motion
    of its tip."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        ahead, left = 0.2 * jnp.cos(motion.rotor.angle), 0.2 * jnp.sin(motion.rotor.angle)
        turn = motion.r + motion.rotor.rate
        along, across = motion.u - left * turn, motion.w + ahead * turn
        friction = -self.a / size(along, across, floor=0.03)
        return wrench_at(friction * along, friction * across, ahead, left)


# The tyres.


class Heating(LateralForce):
    """A grip that falls by up to the share g with the power that a wheelset turns into heat as it slides, half of it
    at 0.03 W."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        power = size(force * wheel.lateral, floor=0.002) - 0.002
        return force * (1 - self.g * power / (0.03 + power))


class RakedKingpin(LateralForce):
    """The kingpin of the front wheelset is raked, so that its tyres lean as they steer: they grip better by up to the
    share g to the left, and worse to the right."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        front = 1.0 if wheel.wheelset.place > 0 else 0.0
        return force * (1 + self.g * front * jnp.tanh(wheel.joint.angle / 0.4))


FURTHER = {
    "trough": (Trough(0.15), "world_position"),
    "magnet": (Magnet(0.4), "world_position"),
    "ledge": (Ledge(0.002), "world_position"),
    "sail": (Sail(0.25), "heading"),
    "ventilation": (Ventilation(0.2), "time"),
    "governor": (Governor(3.0), "speed"),
    "servo_drag": (ServoDrag(0.04), "steering_rate"),
    "heavy_rotor": (HeavyRotor(0.03), "rotor_angle"),
    "fixed_castor": (FixedCastor(0.1), "yaw_rate"),
    "rotor_brush": (RotorBrush(0.25), "rotor_rate"),
    "heating": (Heating(0.4), "slip"),
    "raked_kingpin": (RakedKingpin(0.3), "steering_angle"),
}
"""Effects by name, and the variable on which each depends most."""
