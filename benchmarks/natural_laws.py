"""Twelve effects that may act on a board in a laboratory, written without knowledge of the search for laws."""

import jax
import jax.numpy as jnp
from law_parts import GRAVITY, size, softplus, total, world, wrench_at

from snakejax import Force, LateralForce, Scalar, param

# Places.


class WarpedFloor(Force):
    """The weight of a board of 7 kg, half on each wheelset, rolls down the slopes of a sheet of three humps and three
    dips, whose highest has height h."""

    h: Scalar = param("m", default=0.0)

    def wrench(self, motion):
        bumps = (
            (0.3, -0.2, 0.4, 1.0),
            (1.0, 0.45, 0.35, -0.8),
            (1.7, -0.3, 0.45, 0.9),
            (2.6, 0.2, 0.5, -1.0),
            (-0.9, -0.5, 0.5, -0.9),
            (-2.0, -0.2, 0.6, 0.8),
        )

        def of(wheel):
            ahead = motion.board.arm(wheel.wheelset)
            x, y = world(motion, ahead)
            east = north = jnp.zeros_like(x)
            for x0, y0, width, share in bumps:
                dx, dy = x - x0, y - y0
                steep = share * self.h / width**2 * jnp.exp(-(dx**2 + dy**2) / (2 * width**2))
                east, north = east + steep * dx, north + steep * dy
            return wrench_at(*motion.into_body(3.5 * GRAVITY * east, 3.5 * GRAVITY * north), ahead)

        return total(of(wheel) for wheel in motion.wheels)


class Umbilical(Force):
    """A cable from a hook 2 m over (-0.3, 0.8) m to the tail of the board, which pulls with k per metre beyond a slack
    length of 2.2 m."""

    k: Scalar = param("N/m", default=0.0)

    def wrench(self, motion):
        x, y = world(motion, -0.2)
        dx, dy = -0.3 - x, 0.8 - y
        length = size(dx, dy, floor=2.0)
        pull = self.k * softplus(length - 2.2, 0.05) / length
        return wrench_at(*motion.into_body(pull * dx, pull * dy), -0.2)


class Fan(Force):
    """The drag c of the air relative to the board, of which a jet of 1.5 m/s from a fan at (1.0, -1.3) m spreads and
    fades."""

    c: Scalar = param("N s^2/m^2", default=0.0)

    def wrench(self, motion):
        dx, dy = motion.x - 1.0, motion.y + 1.3
        along, across = 0.96 * dy - 0.28 * dx, 0.96 * dx + 0.28 * dy
        reach = softplus(along, 0.1)
        width = 0.15 + 0.15 * reach
        jet = 1.5 * (0.15 / width) ** 0.5 * jnp.exp(-((across / width) ** 2)) * jax.nn.sigmoid(along / 0.1)
        east, north = motion.into_body(-0.28 * jet, 0.96 * jet)
        ahead, left = east - motion.u, north - motion.w
        speed = size(ahead, left, floor=0.02)
        return self.c * speed * ahead, self.c * speed * left, jnp.zeros_like(speed)


class Spill(LateralForce):
    """A grip that is less by the share g for a wheelset that stands in an oblong puddle around (0.7, 0.1) m."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        x, y = world(motion, motion.board.arm(wheel.wheelset))
        dx, dy = x - 0.7, y - 0.1
        edge = size((0.9 * dx + 0.44 * dy) / 0.5, (0.9 * dy - 0.44 * dx) / 0.25, floor=0.05)
        return force * (1 - self.g * jax.nn.sigmoid((1 - edge) / 0.1))


# Contacts other than the wheels.


class DraggingTail(Force):
    """The dry friction a of a plug that drags on the floor 0.4 m behind and 0.1 m to the left of the centre."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        ahead, left = -0.4, 0.1
        along, across = motion.u - left * motion.r, motion.w + ahead * motion.r
        friction = -self.a / size(along, across, floor=0.02)
        return wrench_at(friction * along, friction * across, ahead, left)


class Planks(Force):
    """A dry friction a against motion across the joints of floor boards that lie along the direction 0.5 rad."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        along, across = motion.into_body(-jnp.sin(0.5), jnp.cos(0.5))
        friction = -self.a * jnp.tanh((motion.u * along + motion.w * across) / 0.03)
        return friction * along, friction * across, jnp.zeros_like(friction)


class RubbingFender(Force):
    """A wheel that is steered beyond 0.45 rad rubs on the deck, which holds its rolling with a per radian."""

    a: Scalar = param("N/rad", default=0.0)

    def wrench(self, motion):
        def of(wheel):
            rub = softplus(size(wheel.joint.angle, floor=0.03) - 0.45, 0.03)
            hold = -self.a * rub * jnp.tanh(wheel.rolling / 0.03)
            return wrench_at(hold * wheel.cosine, hold * wheel.sine, motion.board.arm(wheel.wheelset))

        return total(of(wheel) for wheel in motion.wheels)


# The rotor and what the board carries.


class Windage(Force):
    """The yaw moment of the air on a rotor with paddles, a times the square of its whole rate of turn, against it."""

    a: Scalar = param("N m s^2/rad^2", default=0.0)

    def wrench(self, motion):
        turn = motion.rotor.rate + motion.r
        N = -self.a * turn * (size(turn, floor=0.2) - 0.2)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class EccentricRotor(LateralForce):
    """The mass of the rotor is off its axis, towards 0.9 rad, and takes load from one wheelset to the other: the grip
    goes up and down by up to the share g."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        ahead = motion.board.arm(wheel.wheelset) / motion.board.half_length
        return force * (1 + self.g * ahead * jnp.cos(motion.rotor.angle + 0.9))


class SwingingLoad(Force):
    """A load on a long string, let go at the start, pulls the board to and fro along its axis with up to a, dies away
    and swings faster as it does."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        time = motion.time
        X = self.a * jnp.exp(-time / 9) * jnp.cos(0.8 * time + 0.03 * time**2)
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


# The tyres.


class WornShoulder(LateralForce):
    """Tyres that are worn on one side grip better by the share g as they slip to the left than to the right."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        return force * (1 + self.g * jnp.tanh(wheel.lateral / 0.01))


class Scrub(LateralForce):
    """A grip that falls by up to the share g as the contact of a wheel pivots on the floor, half of it at 1 rad/s."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        spin = motion.r + wheel.joint.rate
        return force * (1 - self.g * spin**2 / (1 + spin**2))


NATURAL = {
    "warped_floor": (WarpedFloor(0.0015), "world_position"),
    "dragging_tail": (DraggingTail(0.08), "speed"),
    "umbilical": (Umbilical(0.6), "world_position"),
    "planks": (Planks(0.4), "heading"),
    "windage": (Windage(0.01), "rotor_rate"),
    "fan": (Fan(0.15), "world_position"),
    "swinging_load": (SwingingLoad(0.4), "time"),
    "rubbing_fender": (RubbingFender(0.5), "steering_angle"),
    "eccentric_rotor": (EccentricRotor(0.12), "rotor_angle"),
    "spill": (Spill(0.5), "world_position"),
    "scrub": (Scrub(0.3), "steering_rate"),
    "worn_shoulder": (WornShoulder(0.2), "slip"),
}
"""Effects by name, and the variable on which each depends most."""
