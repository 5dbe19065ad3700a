"""Levenberg-Marquardt least squares with optimistix; beside `simulation.rayleigh_match` the only user of optimistix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

MOST_STEPS = 60
"""Largest number of steps of one call."""
STALLED, STUCK = 8, 0.02
"""The accuracy of the simulations limits a fit after this many rejected steps in a row, or when a step that is damped
more than the first one lowers chi^2 by less than this fraction of `StoppingRule.enough`.
"""
_FAR, _RELATIVE = 1.5, 1e-5
"""Above the first misfit, far from the noise, a fit stops where the expected decrease is below the second, relative to
chi^2."""


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
        damping = 1 / (self.inverse_damping * jnp.sqrt(step_size))
        return -_solved(state.jacobian, state.residual, state.size, damping)[0], optx.RESULTS.successful


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


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """The Gauss-Newton solver of optimistix with `_Marquardt` steps.

    The trust region grows where a step brings 75 % of the expected decrease: these residuals are curved, and with the
    default cutoff of 99 % the damping would stay large.
    """

    ending: StoppingRule
    descent: optx.AbstractDescent
    rtol: float = 0.0
    atol: float = 1e-300
    norm: Callable = optx.two_norm
    search: optx.AbstractSearch = optx.ClassicalTrustRegion(high_cutoff=0.75, high_constant=30.0, low_constant=0.1)
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


def levenberg_marquardt(
    residuals: Callable, start: Float[Array, " N"], inverse_damping: Float[Array, ""], ending: StoppingRule
) -> tuple[Float[Array, " N"], Any, Int[Array, ""], Bool[Array, ""]]:
    """Minimise |r(z)|^2 from `start` (N,) by Levenberg-Marquardt (Moré 1978).

    `residuals` takes (z, None) and returns (r, auxiliary data). The first step minimises
    |J d + r|^2 + sum_k (|J_k| d_k / inverse_damping)^2. Returns z, the auxiliary data at z, the number of steps, and
    whether the stopping rule on the expected decrease is met.
    """
    solver = _LevenbergMarquardt(ending=ending, descent=_Marquardt(inverse_damping))
    solution = optx.least_squares(residuals, solver, start, has_aux=True, max_steps=MOST_STEPS, throw=False)
    return solution.value, solution.state.aux, solution.stats["num_steps"], solver.settled(solution.state)
