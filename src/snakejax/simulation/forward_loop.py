"""Tsit5 in a loop of our own, for derivatives that are taken forward: the steps of `diffrax.diffeqsolve`.

Most of the time to compile a fit goes into the rates and their derivatives. `diffeqsolve` needs them twice, before its
loop and inside, where the last slope of a step is the first of the next. Here the first slope is one more pass of the
loop over the stages, at the start and after a jump, so that the program holds the rates once. Method, coefficients,
interpolation and step size control are those of diffrax, and so are the numbers.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from snakejax.core.parameter import Scalar

Rates = Callable[[Scalar, list[Scalar]], list[Scalar]]

_METHOD = diffrax.Tsit5()
_TABLEAU = _METHOD.tableau
_STAGES = 7
_ROWS = np.zeros((_STAGES, _STAGES))
"""Row i: the weights of the slopes before it in the state of stage i; the state of the last is the solution."""
for _i, _row in enumerate(_TABLEAU.a_lower, 1):
    _ROWS[_i, : len(_row)] = _row
_NODES = np.array([0.0, *_TABLEAU.c])
ROUNDING = 100 * np.finfo(float).eps
"""A step that would end within this share of the last time before it ends there, as in diffrax: the rest would be too
short to interpolate in."""


class _Point(NamedTuple):
    """Where the loop stands: the step from `begin` to `end` [s] is next, from the `state`, where the slope is `slope`
    unless it is `unknown`; `control` is the state of the controller; the first `saved` rows of `samples` are there;
    `taken` steps so far, and whether all of them were `sound`."""

    begin: Scalar
    end: Scalar
    state: list[Scalar]
    slope: list[Scalar]
    unknown: Bool[Array, ""]
    control: Any
    saved: Int[Array, ""]
    samples: list[Float[Array, " n"]]
    taken: Int[Array, ""]
    sound: Bool[Array, ""]


def _weighted(weights: Float[Array, " 7"], slopes: Float[Array, " 7"]) -> Scalar:
    return jnp.sum(weights * slopes)


def _step(rates: Rates, at: _Point) -> tuple[list[Scalar], list[Scalar], list[Float[Array, " 7"]]]:
    """The state after a step, the slope there, and the slopes of all stages times the step, (7,) by component."""
    h = at.end - at.begin
    rows, nodes = jnp.asarray(_ROWS), jnp.asarray(_NODES)

    def stage(carry):
        i, moves, _, _ = carry
        state = [y + _weighted(rows[i], move) for y, move in zip(at.state, moves, strict=True)]
        slope = rates(at.begin + nodes[i] * h, state)
        return i + 1, [move.at[i].set(h * s) for move, s in zip(moves, slope, strict=True)], state, slope

    moves = [jnp.zeros(_STAGES).at[0].set(h * s) for s in at.slope]
    first = (jnp.where(eqxi.unvmap_any(at.unknown), 0, 1), moves, at.state, at.slope)
    _, moves, state, slope = jax.lax.while_loop(lambda carry: carry[0] < _STAGES, stage, first)
    return state, slope, moves


def integrate_forward(
    rates: Rates,
    state: list[Scalar],
    begin: Scalar,
    times: Float[Array, " n"],
    controller: diffrax.AbstractStepSizeController,
    first_step: Scalar | float,
    most_steps: int,
) -> tuple[list[Float[Array, " n"]], Bool[Array, ""]]:
    """The components of the state (n,) at `times` [s] from `state` at `begin`, and whether the end was reached.

    A component that was not reached is infinite. `jax.jvp` and `jax.vmap` apply, and not `jax.vjp`.
    """
    begin, state = jnp.asarray(begin, jnp.float64), [jnp.asarray(y, jnp.float64) for y in state]
    last, count = jnp.maximum(times[-1], begin + 1e-9), times.shape[0]
    weights = jnp.asarray(_TABLEAU.b_error)
    term = diffrax.ODETerm(lambda t, y, _: rates(t, y))
    order = _METHOD.error_order(term)

    def advance(at: _Point) -> _Point:
        then, slope, moves = _step(rates, at)
        errors = [_weighted(weights, move) for move in moves]
        errors = [jnp.where(jnp.isnan(error), jnp.inf, error) for error in errors]
        kept, next_begin, next_end, jumped, control, result = controller.adapt_step_size(
            at.begin, at.end, at.state, then, None, errors, order, at.control
        )
        next_begin = jnp.minimum(next_begin, last)
        clipped = jnp.where(kept, last, next_begin + 0.5 * (last - next_begin))
        next_end = jnp.where(next_end > last - ROUNDING * jnp.abs(last), clipped, next_end)
        inside = _METHOD.interpolation_cls(t0=at.begin, t1=at.end, y0=at.state, y1=then, k=moves)

        def due(carry):
            return kept & (carry[0] < count) & (times[jnp.minimum(carry[0], count - 1)] <= at.end)

        def save(carry):
            k, samples = carry
            reached = inside.evaluate(times[k])
            return k + 1, [rows.at[k].set(y) for rows, y in zip(samples, reached, strict=True)]

        saved, samples = eqxi.while_loop(due, save, (at.saved, at.samples), kind="lax", buffers=lambda c: c[1])
        return _Point(
            next_begin,
            next_end,
            [jnp.where(kept, b, a) for a, b in zip(at.state, then, strict=True)],
            [jnp.where(kept, b, a) for a, b in zip(at.slope, slope, strict=True)],
            jnp.where(kept, jumped, at.unknown),
            control,
            saved,
            samples,
            at.taken + 1,
            at.sound & (result == diffrax.RESULTS.successful),
        )

    def unfinished(at: _Point) -> Bool[Array, ""]:
        return (at.begin < last) & (at.taken < most_steps) & at.sound

    end, control = controller.init(term, begin, last, state, first_step, None, _METHOD.func, order)
    point = _Point(
        begin,
        jnp.minimum(end, last),
        state,
        [jnp.zeros(()) for _ in state],
        jnp.asarray(True),
        control,
        jnp.asarray(0),
        [jnp.full(count, jnp.inf) for _ in state],
        jnp.asarray(0),
        jnp.asarray(True),
    )
    point = eqxi.while_loop(unfinished, advance, point, kind="lax", buffers=lambda at: at.samples)
    return point.samples, (point.begin >= last) & point.sound
