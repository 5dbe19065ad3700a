"""Ten further effects that may act on a board in a laboratory, written without knowledge of the search for laws."""

import jax
import jax.numpy as jnp
from law_parts import size, softplus, world, wrench_at

from snakejax import Force, LateralForce, RollingForce, Scalar, param

# Places.


class Cordon(Force):
    """An elastic band that is stretched between posts along a line through (0.5, 0.15) m in the direction 0.2 rad
    pushes the board back, with k for each metre that its centre goes beyond the line to the left."""

    k: Scalar = param("N/m", default=0.0)

    def wrench(self, motion):
        beyond = 0.98 * (motion.y - 0.15) - 0.199 * (motion.x - 0.5)
        push = -self.k * softplus(beyond, 0.03)
        X, Y = motion.into_body(-0.199 * push, 0.98 * push)
        return X, Y, jnp.zeros_like(X)


class DoorMat(RollingForce):
    """A wheelset that stands on a mat, a rectangle of 0.8 by 0.6 m around (0.6, 0) m, is held in its rolling with a."""

    a: Scalar = param("N", default=0.0)

    def resistance(self, wheel, motion):
        x, y = world(motion, motion.board.arm(wheel.wheelset))
        wide = jax.nn.sigmoid((0.4 - size(x - 0.6, floor=0.02)) / 0.03)
        deep = jax.nn.sigmoid((0.3 - size(y, floor=0.02)) / 0.03)
        return self.a * wide * deep * jnp.tanh(wheel.rolling / 0.03)


class CeilingFan(Force):
    """The air under a fan at the ceiling turns to the left around (0.4, 0.3) m, and pushes the board along with it: at
    most a, 0.5 m from the axis."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        dx, dy = (motion.x - 0.4) / 0.5, (motion.y - 0.3) / 0.5
        push = 2 * self.a / (1 + dx**2 + dy**2)
        X, Y = motion.into_body(-push * dy, push * dx)
        return X, Y, jnp.zeros_like(X)


# The heading and the time.


class SteelDeck(Force):
    """A long deck of soft iron in the field of the magnets of a neighbour: a yaw moment of at most a, which turns
    either end of the deck towards 1.1 rad."""

    a: Scalar = param("N m", default=0.0)

    def wrench(self, motion):
        N = -self.a * jnp.sin(2 * (motion.theta - 1.1))
        return jnp.zeros_like(N), jnp.zeros_like(N), N


class Balloon(Force):
    """A balloon whose nozzle points back, 0.06 m to the left of the axis, pushes forwards with a until it is empty,
    after some 5 s."""

    a: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        X = self.a * jax.nn.sigmoid((5.0 - motion.time) / 0.3)
        return wrench_at(X, jnp.zeros_like(X), 0.0, 0.06)


# Speeds, rates and joints.


class HalfShroud(Force):
    """A rotor with paddles of which a shroud covers the rear half: the paddles in front beat the air, and push the
    board across, against their motion, with a times the square of the rate of the rotor."""

    a: Scalar = param("N s^2/rad^2", default=0.0)

    def wrench(self, motion):
        rate = motion.rotor.rate
        Y = -self.a * rate * (size(rate, floor=0.2) - 0.2)
        return wrench_at(jnp.zeros_like(Y), Y, 0.1)


class OneWayVanes(Force):
    """Hinged vanes that open as the board turns to the left, and fold as it turns to the right: a yaw moment against
    turns to the left, of c for each rad/s."""

    c: Scalar = param("N m s/rad", default=0.0)

    def wrench(self, motion):
        N = -self.c * softplus(motion.r, 0.05)
        return jnp.zeros_like(N), jnp.zeros_like(N), N


# Another contact, at a point of the body.


class Outrigger(Force):
    """A ball in a greasy socket, on a boom 0.1 m ahead and 0.3 m to the left of the centre, holds that point of the
    board with c times its velocity over the floor."""

    c: Scalar = param("N s/m", default=0.0)

    def wrench(self, motion):
        ahead, left = 0.1, 0.3
        along, across = motion.u - left * motion.r, motion.w + ahead * motion.r
        return wrench_at(-self.c * along, -self.c * across, ahead, left)


# The tyres.


class CamberThrust(LateralForce):
    """Wheels that lean as they steer push to the side to which they lean, whether they slip or not, with up to a."""

    a: Scalar = param("N", default=0.0)

    def lateral(self, force, wheel, motion):
        return force - self.a * jnp.tanh(wheel.joint.angle / 0.5)


class SoftRubber(LateralForce):
    """A soft rubber that grips better the faster it slides: by the share g for each e-fold of the slip speed beyond
    0.01 m/s."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        return force * (1 + self.g * jnp.log1p((wheel.lateral / 0.01) ** 2) / 2)


ARENA = {
    "cordon": (Cordon(1.2), "world_position"),
    "half_shroud": (HalfShroud(0.015), "rotor_rate"),
    "steel_deck": (SteelDeck(0.05), "heading"),
    "door_mat": (DoorMat(0.15), "world_position"),
    "camber_thrust": (CamberThrust(0.5), "steering_angle"),
    "balloon": (Balloon(0.15), "time"),
    "outrigger": (Outrigger(0.4), "speed"),
    "ceiling_fan": (CeilingFan(0.12), "world_position"),
    "one_way_vanes": (OneWayVanes(0.05), "yaw_rate"),
    "soft_rubber": (SoftRubber(0.2), "slip"),
}
"""Effects by name, and the variable on which each depends most."""
