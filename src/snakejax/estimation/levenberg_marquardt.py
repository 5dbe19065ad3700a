"""Levenberg-Marquardt least squares with optimistix; beside `simulation.rayleigh_match` the only user of optimistix."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from .linear_residuals import LinearResiduals

MOST_STEPS = 60
"""Largest number of steps of one call."""
STALLED, STUCK = 8, 0.02
"""The accuracy of the simulations limits a fit after this many rejected steps in a row, or when a step that is damped
more than the first one lowers chi^2 by less than this fraction of `StoppingRule.enough`.
"""
_FAR, _RELATIVE = 1.5, 1e-5
"""Above the first misfit, far from the noise, a fit stops where the expected decrease is below the second, relative to
chi^2."""


ALIGNED, SMALL = 0.9, 0.375
"""A step is bent where the one before had its direction, but for an angle with this cosine, and where it bends by at
most this share of its length (Transtrum and Sethna 2012 have 0.75 for twice that)."""
_OPTIONS = {"jac": "bwd"}
"""The Jacobian of the linear residuals is a matrix, and not a program."""


class _Local(eqx.Module):
    """The linear problem of one step.

    `jacobian` (M, N); `residual` (M,); `size` (N,): largest norm of each column of the Jacobian so far; `promise`:
    decrease of chi^2 that an undamped step would bring by the linear model; `gain`: decrease by the last step.
    """

    jacobian: Float[Array, "M N"]
    residual: Float[Array, " M"]
    size: Float[Array, " N"]
    promise: Float[Array, ""]
    gain: Float[Array, ""]


class _Marquardt(optx.AbstractDescent):
    """Damped Newton steps, min |J d + r|^2 + lambda |D d|^2, with lambda = 1 / step size.

    D is diagonal: the largest norm of each column of J so far, over `inverse_damping` c (Moré 1978). The first step has
    lambda = 1. For a single variable it is 1 / (1 + 1 / c^2) of the Gauss-Newton step, and so is each component of a
    step where the columns of J are orthogonal. A variable that has just lost its influence keeps a bounded step.
    """

    inverse_damping: Float[Array, ""]

    def init(self, y, f_info_struct) -> _Local:
        rows = sum(leaf.size for leaf in jax.tree.leaves(f_info_struct.residual))
        endless = jnp.asarray(jnp.inf)
        return _Local(jnp.zeros((rows, y.size)), jnp.zeros(rows), jnp.zeros(y.size), endless, endless)

    def query(self, y, f_info, state) -> _Local:
        del y
        J, r = f_info.jac.as_matrix(), jnp.concatenate([leaf.ravel() for leaf in jax.tree.leaves(f_info.residual)])
        norms = jnp.sqrt(jnp.sum(J**2, axis=0))
        promise = jnp.sum(_solved(J, r, norms, 1e-7)[1] ** 2)
        decrease = jnp.sum(state.residual**2) - jnp.sum(r**2)
        return _Local(
            J, r, jnp.maximum(state.size, norms), promise, jnp.where(jnp.any(state.size > 0), decrease, jnp.inf)
        )

    def step(self, step_size, state):
        step = _solved(state.jacobian, state.residual, state.size, self.damping(step_size))[0]
        return -step, optx.RESULTS.successful

    def damping(self, step_size):
        """sqrt(lambda) over c."""
        return 1 / (self.inverse_damping * jnp.sqrt(step_size))


def _solved(J, r, size, damping) -> tuple[Array, Array]:
    """argmin |J d - r|^2 + |damping size d|^2, and the part of (r, 0) in the span of (J, damping size)."""
    size = jnp.where(size > 0, size, 1.0)
    q, t = jnp.linalg.qr(jnp.concatenate([J / size[None, :], damping * jnp.eye(size.size)]))
    within = q.T @ jnp.concatenate([r, jnp.zeros_like(size)])
    return jax.scipy.linalg.solve_triangular(t, within) / size, within


class StoppingRule(eqx.Module):
    """When a fit stops.

    It stops where an undamped step is expected to lower chi^2 by less than `enough`; if chi^2 is far above the number
    of `samples` also where that decrease is below a small fraction of chi^2, or where the last step lowered chi^2 by
    less than the fraction `crawl`; and after `most` steps (at most `MOST_STEPS`).
    """

    enough: Float[Array, ""]
    crawl: Float[Array, ""]
    samples: Float[Array, ""]
    most: Int[Array, ""]


class _TrustRegion(optx.ClassicalTrustRegion):
    """The trust region of optimistix: a step that is bent is judged by what the linear model expects of the `straight`
    one."""

    straight: Float[Array, " N"] | None = None

    def predict_reduction(self, y_diff, f_info):
        return super().predict_reduction(y_diff if self.straight is None else self.straight, f_info)


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """The Gauss-Newton solver of optimistix with `_Marquardt` steps.

    The trust region grows tenfold where a step brings 75 % of the expected decrease: these residuals are curved, and
    with the default cutoff of 99 % the damping would stay large. It shrinks fivefold after a step in vain.
    """

    ending: StoppingRule
    descent: optx.AbstractDescent
    rtol: float = 0.0
    atol: float = 1e-300
    norm: Callable = optx.two_norm
    search: optx.AbstractSearch = _TrustRegion(high_cutoff=0.75, high_constant=10.0, low_constant=0.2)
    verbose: Callable = lambda **_: None

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        stalled = (state.num_steps >= self.ending.most) | (state.num_steps_since_acceptance >= STALLED)
        short = state.search_state.step_size < 1
        stalled |= short & (state.descent_state.gain < STUCK * self.ending.enough)
        return (state.num_steps > 0) & (self.settled(state) | stalled), state.result

    def settled(self, state):
        """Whether the expected decrease of chi^2 is below the stopping rule."""
        ending, square = self.ending, jnp.sum(state.descent_state.residual**2)
        far = square > _FAR * ending.samples
        little = state.descent_state.promise < jnp.maximum(ending.enough, jnp.where(far, _RELATIVE * square, 0.0))
        return little | (far & (state.descent_state.gain < ending.crawl * square))


class Minimum(NamedTuple):
    """Where Levenberg-Marquardt ended: `z` (N,), the residuals there, the number of `steps`, and whether the stopping
    rule on the expected decrease is met (`settled`)."""

    z: Float[np.ndarray, " N"]
    residuals: LinearResiduals
    steps: int
    settled: bool


class Curvature(NamedTuple):
    """The second derivative (R, m) of the residuals along a `step` (N,) that was tried."""

    step: Float[np.ndarray, " N"]
    second: Float[np.ndarray, "R m"]

    def acceleration(
        self, here: LinearResiduals, step: Float[np.ndarray, " N"], damping_rows: Float[np.ndarray, " N"]
    ) -> Float[np.ndarray, " N"]:
        """The geodesic acceleration a / 2 of a damped `step` d (Transtrum and Sethna 2012).

        a minimises |J a + r_dd|^2 + |damping_rows a|^2, with r_dd from the step that was tried, scaled by the square of
        the length. It is zero where d has another direction, or where a / 2 is no small part of d.
        """
        tried, wanted = damping_rows * self.step, damping_rows * step
        lengths = np.linalg.norm(tried), np.linalg.norm(wanted)
        if not (min(lengths) > 0 and abs(tried @ wanted) > ALIGNED * lengths[0] * lengths[1]):
            return np.zeros_like(step)
        second = here.in_rows(self.second) * (lengths[1] / lengths[0]) ** 2
        if not np.isfinite(second).all():
            return np.zeros_like(step)
        matrix = np.concatenate([here.rows[1] / damping_rows, np.eye(len(step))])
        scaled = np.linalg.lstsq(matrix, -np.concatenate([second, np.zeros(len(step))]), rcond=None)[0] / 2
        return scaled / damping_rows if np.linalg.norm(scaled) <= SMALL * lengths[1] else np.zeros_like(step)


def levenberg_marquardt(
    linearise: Callable[[Float[np.ndarray, " N"]], LinearResiduals],
    start: Float[np.ndarray, " N"],
    inverse_damping: Float[Array, ""],
    ending: StoppingRule,
) -> Minimum:
    """Minimise |r(z)|^2 from `start` (N,) by Levenberg-Marquardt (Moré 1978), a step of optimistix at a time.

    The first step minimises |J d + r|^2 + sum_k (|J_k| d_k / inverse_damping)^2. Along a curved valley a straight step
    has to be short: each step is bent by what the one before missed, without a further simulation.
    """
    solver = _LevenbergMarquardt(ending=ending, descent=_Marquardt(inverse_damping))
    z = at = np.asarray(start, float)
    here = trial = linearise(at)
    state, curvature = _started(solver, z, *here.rows), None
    steps, straight = 0, np.zeros_like(z)
    while True:
        if trial is not here and trial.is_finite and here.is_finite:
            curvature = Curvature(at - z, here.beyond(at - z, trial))
        z, state, accepted, terminate, settled, damping_rows = _stepped(solver, z, state, straight, *trial.rows)
        z, at, steps = np.asarray(z), np.asarray(state.y_eval), steps + 1
        here = trial if accepted else here
        if terminate or steps == MOST_STEPS:
            return Minimum(z, here, steps, bool(settled))
        straight = at - z
        if curvature is not None:
            at = at + curvature.acceleration(here, straight, np.asarray(damping_rows))
            state = eqx.tree_at(lambda s: s.y_eval, state, at)
        trial = linearise(at)


def _linear(z, args):
    residual, jacobian, at = args
    return residual + jacobian @ (z - at), None


@eqx.filter_jit
def _started(solver: _LevenbergMarquardt, z, residual, jacobian):
    struct = jax.eval_shape(lambda: residual)
    return solver.init(_linear, z, (residual, jacobian, z), _OPTIONS, struct, None, frozenset())


@eqx.filter_jit
def _stepped(solver: _LevenbergMarquardt, z, state, straight, residual, jacobian):
    solver = eqx.tree_at(lambda s: s.search.straight, solver, straight, is_leaf=lambda leaf: leaf is None)
    args = (residual, jacobian, state.y_eval)
    z, state, _ = solver.step(_linear, z, args, _OPTIONS, state, frozenset())
    terminate, _ = solver.terminate(_linear, z, args, _OPTIONS, state, frozenset())
    size, damping = state.descent_state.size, solver.descent.damping(state.search_state.step_size)  # type: ignore
    damping_rows = damping * jnp.where(size > 0, size, 1.0)
    return z, state, state.num_steps_since_acceptance == 0, terminate, solver.settled(state), damping_rows
