"""A floor that is not plane: the weight on the wheels pushes them down the slopes on which they stand."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from snakejax.core.parameter import Scalar

from .contact import Motion, Wheel, Wrench, sine_cosine
from .vehicle import AbstractVehicle, Wheelset

Height = Callable[[Scalar, Scalar], Scalar]
"""The height [m] of a floor at a place (x, y) [m]."""


def place_of_wheel(board: AbstractVehicle, wheelset: Wheelset, motion: Motion) -> tuple[Scalar, Scalar]:
    """Where a wheelset of `board` stands on the floor, (x, y) [m]."""
    at = board.placement(wheelset, {name: joint.angle for name, joint in motion.inputs.items()})
    sine, cosine = sine_cosine(motion.theta)
    return motion.x + at.x * cosine - at.y * sine, motion.y + at.x * sine + at.y * cosine


def force_at_wheel(board: AbstractVehicle, wheelset: Wheelset, motion: Motion, east: Scalar, north: Scalar) -> Wrench:
    """The wrench on the body of a force (east, north) [N] along the axes of the world that acts on a wheelset."""
    at = board.placement(wheelset, {name: joint.angle for name, joint in motion.inputs.items()})
    X, Y = motion.into_body(east, north)
    return X, Y, at.x * Y - at.y * X


def weight_on_floor(height: Height, motion: Motion) -> Wrench:
    """The wrench (X, Y, N) [N, N, N m] of the weight on a floor of `height` h(x, y) [m].

    Each wheelset i, with the load P_i [N] at rest, is pushed with -P_i dh/dx along x and -P_i dh/dy along y of the
    world, where it stands. Slopes are small: the loads are those on a level floor.
    """

    def of(wheel: Wheel) -> Wrench:
        x, y = place_of_wheel(motion.board, wheel.wheelset, motion)
        steep_x = jax.jvp(lambda x: height(x, y), (x,), (jnp.ones_like(x),))[1]
        steep_y = jax.jvp(lambda y: height(x, y), (y,), (jnp.ones_like(y),))[1]
        load = motion.board.load(wheel.wheelset)
        return force_at_wheel(motion.board, wheel.wheelset, motion, -load * steep_x, -load * steep_y)

    X, Y, N = (sum(parts, jnp.zeros_like(motion.u)) for parts in zip(*map(of, motion.wheels), strict=True))
    return X, Y, N
