"""Fast and differentiable scalar functions: sine, cosine, arctangent and a safe norm.

On a CPU, XLA vectorises exp, tanh and sqrt of double precision, but evaluates sin, cos and atan one by one by the C
library. The functions below are polynomials: ten times faster for many members, within 2 units in the last place.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata

from .parameter import Scalar

F = TypeVar("F", bound=Callable[..., Any])

# sin and cos on [-pi/4, pi/4]: minimax polynomials of Sun's fdlibm; pi/2 in three parts, the first two of 33 bits.
_SINE = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
_COSINE = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)
_QUARTERS = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
# atan on [-0.66, 0.66]: a rational function of Moshier's Cephes.
_ATAN_TOP = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ATAN_BOTTOM = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
_TAN_3PI8 = 2.41421356237309504880
"""tan(3 pi / 8), above which atan(x) = pi/2 - atan(1/x) is used (Cephes)."""
_LOST_QUARTER = 6.123233995736765886130e-17
"""pi / 2 minus its nearest double."""


SINE_COSINE, ARCTAN = "snakejax_sine_cosine", "snakejax_arctan"
"""Names in a trace of the two functions: a reader of the trace that has a sine and an arctangent takes its own."""


def named(name: str) -> Callable[[F], F]:
    """A function of scalars that a trace shows as one operation of this `name`."""

    def change(function: F) -> F:
        function.__name__ = name
        return jax.jit(function)  # type: ignore[return-value]

    return change


@jax.jit
def _held(values):
    return values


def hold(*values: Scalar) -> tuple[Scalar, ...]:
    """Keep XLA from recomputing `values` for every use, which would double the time of ensembles.

    XLA removes `jax.lax.optimization_barrier` on a CPU before it fuses operations. It does not fuse a call that must
    not be inlined; here this is a call of the identity.
    """
    with set_xla_metadata(inlineable="false"):
        return _held(values)


def _polynomial(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    value = jnp.full_like(x, coefficients[0])
    for c in coefficients[1:]:
        value = value * x + c
    return value


@jax.custom_jvp
@named(SINE_COSINE)
def sine_cosine(x: Scalar) -> tuple[Scalar, Scalar]:
    """(sin x, cos x) of x [rad]; the errors grow above |x| of about 1e5, far beyond any joint angle or heading."""
    x = jnp.asarray(x, jnp.float64)
    (x,) = hold(x)
    quarter_turns = jnp.round(x * (2 / jnp.pi))
    remainder = x
    for part in _QUARTERS:
        remainder = remainder - quarter_turns * part
    square = remainder * remainder
    sine = remainder + remainder * square * _polynomial(_SINE, square)
    cosine = 1 - 0.5 * square + square * square * _polynomial(_COSINE, square)
    sine, cosine = hold(sine, cosine)
    quarter = quarter_turns - 4 * jnp.floor(quarter_turns / 4)
    odd = (quarter == 1) | (quarter == 3)
    s, c = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(quarter >= 2, -s, s), jnp.where((quarter == 1) | (quarter == 2), -c, c)


@sine_cosine.defjvp
def _sine_cosine_jvp(primals, tangents):
    (s, c), (dx,) = sine_cosine(*primals), tangents
    return (s, c), (c * dx, -s * dx)


@jax.custom_jvp
@named(ARCTAN)
def arctan(x: Scalar) -> Scalar:
    """atan(x) [rad], within 2 units in the last place (Moshier's Cephes)."""
    x = jnp.asarray(x, jnp.float64)
    size = jnp.abs(x)
    steep, middle = size > _TAN_3PI8, size > 0.66
    # atan(x) = pi/2 - atan(1/x) = pi/4 + atan((x - 1) / (x + 1)), by one division.
    top = jnp.where(steep, -1.0, jnp.where(middle, size - 1, size))
    bottom = jnp.where(steep, size, jnp.where(middle, size + 1, 1.0))
    t, size = hold(top / bottom, size)
    square = t * t
    small = t + t * square * (_polynomial(_ATAN_TOP, square) / _polynomial(_ATAN_BOTTOM, square))
    base = jnp.where(steep, jnp.pi / 2, jnp.where(middle, jnp.pi / 4, 0.0))
    lost = jnp.where(steep, _LOST_QUARTER, jnp.where(middle, _LOST_QUARTER / 2, 0.0))
    value = base + (small + lost)
    return hold(jnp.where(x < 0, -value, value))[0]


@arctan.defjvp
def _arctan_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    return arctan(x), dx / (1 + x * x)


def safe_norm(x: Scalar, y: Scalar) -> Scalar:
    """sqrt(x^2 + y^2), with derivative zero in place of NaN at the origin."""
    square = x**2 + y**2
    moving = square > 0
    return jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)
