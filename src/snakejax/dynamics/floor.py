"""A floor that is not plane: the weight on the wheels pushes them down the slopes on which they stand."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from snakejax.core.parameter import Scalar

from .contact import Motion, Wheel, Wrench, sine_cosine
from .vehicle import AbstractVehicle, Placement, Wheelset

Height = Callable[[Scalar, Scalar], Scalar]
"""The height [m] of a floor at a place (x, y) [m]."""


def placement_of(board: AbstractVehicle, wheelset: Wheelset, motion: Motion) -> Placement:
    """Where a wheelset of `board` touches the ground in the base frame."""
    return board.placement(wheelset, {name: joint.angle for name, joint in motion.inputs.items()})


def place_on_floor(at: Placement, motion: Motion) -> tuple[Scalar, Scalar]:
    """The place (x, y) [m] in the world of what is `at` a place of the base frame."""
    sine, cosine = sine_cosine(motion.theta)
    return motion.x + at.x * cosine - at.y * sine, motion.y + at.x * sine + at.y * cosine


def wrench_at(at: Placement, X: Scalar, Y: Scalar) -> Wrench:
    """The wrench of a force along and across the body [N] that acts `at` a place of the base frame."""
    return X, Y, at.x * Y - at.y * X


def wrench_of_wheel(at: Placement, steered: Scalar, along: Scalar, across: Scalar) -> Wrench:
    """The wrench of a force [N] on a wheel `at` a place, `steered` by an angle [rad]: `along` the wheel, and `across`
    it to its left."""
    sine, cosine = sine_cosine(at.angle + steered)
    return wrench_at(at, along * cosine - across * sine, along * sine + across * cosine)


def weight_on_floor(height: Height, motion: Motion) -> Wrench:
    """The wrench (X, Y, N) [N, N, N m] of the weight on a floor of `height` h(x, y) [m].

    Each wheelset i, with the load P_i [N] at rest, is pushed with -P_i dh/dx along x and -P_i dh/dy along y of the
    world, where it stands. Slopes are small: the loads are those on a level floor.
    """

    def of(wheel: Wheel) -> Wrench:
        at, load = placement_of(motion.board, wheel.wheelset, motion), motion.board.load(wheel.wheelset)
        x, y = place_on_floor(at, motion)
        steep_x = jax.jvp(lambda x: height(x, y), (x,), (jnp.ones_like(x),))[1]
        steep_y = jax.jvp(lambda y: height(x, y), (y,), (jnp.ones_like(y),))[1]
        return wrench_at(at, *motion.into_body(-load * steep_x, -load * steep_y))

    X, Y, N = (sum(parts, jnp.zeros_like(motion.u)) for parts in zip(*map(of, motion.wheels), strict=True))
    return X, Y, N
