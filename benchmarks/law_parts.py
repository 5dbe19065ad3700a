"""What the made-up effects of the benchmarks are built of."""

import jax
import jax.numpy as jnp

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""


def softplus(a, width):
    """The part of `a` above zero, with a corner that is round over `width`."""
    return width * jax.nn.softplus(a / width)


def size(*parts, floor):
    """The length of a vector, round below `floor`."""
    return jnp.sqrt(sum(part**2 for part in parts) + floor**2)


def world(motion, ahead, left=0.0):
    """Where a point of the body is, `ahead` and to the `left` of its centre [m]."""
    cosine, sine = jnp.cos(motion.theta), jnp.sin(motion.theta)
    return motion.x + ahead * cosine - left * sine, motion.y + ahead * sine + left * cosine


def wrench_at(X, Y, ahead, left=0.0):
    """The wrench of a force (X, Y) that acts `ahead` and to the `left` of the centre [m]."""
    return X, Y, ahead * Y - left * X


def total(wrenches):
    """The sum of wrenches."""
    return tuple(sum(parts) for parts in zip(*wrenches, strict=True))
