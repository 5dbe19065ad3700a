"""A free force and a free grip: piecewise linear in time between knots, without a word about their cause."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar
from snakejax.dynamics.contact import Motion, Wheel, Wrench
from snakejax.dynamics.ports import Force, LateralForce

SPACING = 0.1
"""Time between the knots of a free force [s]."""


class FreeForce(Force):
    """A wrench that is piecewise linear in time: `values` (K, 3) at `start` + k `spacing`, constant outside."""

    start: Scalar
    spacing: Scalar
    values: Float[Array, "K 3"]

    def wrench(self, motion: Motion) -> Wrench:
        now = _between(self.values, (motion.time - self.start) / self.spacing)
        return now[0], now[1], now[2]


class FreeGrip(LateralForce):
    """Lateral force x (1 + g), g piecewise linear in time: `values` (K, 2), ahead of the middle and behind it."""

    start: Scalar
    spacing: Scalar
    values: Float[Array, "K 2"]

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        now = _between(self.values, (motion.time - self.start) / self.spacing)
        return force * (1 + now[0 if wheel.wheelset.place > 0 else 1])


def _between(values: Float[Array, "K c"], place: Scalar) -> Float[Array, " c"]:
    """`values` at the fractional index `place`, held constant beyond the ends."""
    held = jnp.clip(place, 0.0, values.shape[0] - 1.0)
    k = jnp.clip(jnp.floor(held).astype(int), 0, values.shape[0] - 2)
    part = held - k.astype(float)
    return (1 - part) * values[k] + part * values[k + 1]
