"""Scalar functions that stay finite, and differentiable, where the textbook form does not."""

import jax
import jax.numpy as jnp

from ._units import Scalar


def slip_angle(lateral: Scalar, rolling: Scalar, creep: Scalar) -> Scalar:
    """Slip angle of a rolling wheel, atan(v / sqrt(a^2 + eps^2)) [rad], odd in v and even in a.

    With q^2 = a^2 + eps^2 this is 2 atan(v / (q + sqrt(q^2 + v^2))), which needs no quadrant and is smooth at rest.

    **Arguments:** `lateral`: slip speed v [m/s]; `rolling`: rolling speed a [m/s]; `creep`: eps > 0 [m/s].
    """
    square = rolling**2 + creep**2
    return 2 * jnp.arctan(lateral / (jnp.sqrt(square) + jnp.sqrt(square + lateral**2)))


def safe_norm(x: Scalar, y: Scalar) -> Scalar:
    """sqrt(x^2 + y^2) with derivative zero, not NaN, at the origin."""
    square = x**2 + y**2
    moving = square > 0
    return jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)


def hold(*values: Scalar) -> tuple[Scalar, ...]:
    """Keep XLA from computing `values` again for every use: without it, the CPU spends 4 times as long."""
    return tuple(jax.lax.optimization_barrier(values))
