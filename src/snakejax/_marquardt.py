"""Levenberg and Marquardt's least squares: the one room that knows optimistix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

MOST_STEPS = 60
STALLED, STUCK = 8, 0.02
"""A fit has come as far as the accuracy of its simulations lets it after so many rejected steps in a row, or with one
that is shorter than the first and lowers chi^2 by less than this share of what is enough.
"""
_FAR, _RELATIVE = 1.5, 1e-5
"""A misfit above the first ends a fit early: where a step promises to lower chi^2 by less than the second share."""


class _Local(eqx.Module):
    """The linear problem of one step: Jacobian (M, N), residual (M,), the largest norm (N,) that each column of the
    Jacobian has had so far, what an undamped step promises, and by how much the last step lowered chi^2.
    """

    jacobian: Float[Array, "M N"]
    residual: Float[Array, " M"]
    size: Float[Array, " N"]
    promise: Float[Array, ""]
    gain: Float[Array, ""]


class _Marquardt(optx.AbstractDescent):
    """Damped Newton steps, min |J d + r|^2 + lambda |D d|^2, with lambda = 1 / step size.

    D is diagonal, the largest norm that each column of J has had, over `unit` (Moré 1978), so that with lambda = 1 the
    residuals change by about `unit`, and no unknown runs away where it has just lost its effect.
    """

    unit: Float[Array, ""]

    def init(self, y, f_info_struct) -> _Local:
        rows = sum(leaf.size for leaf in jax.tree.leaves(f_info_struct.residual))
        endless = jnp.asarray(jnp.inf)
        return _Local(jnp.zeros((rows, y.size)), jnp.zeros(rows), jnp.zeros(y.size), endless, endless)

    def query(self, y, f_info, state) -> _Local:
        del y
        J, r = f_info.jac.as_matrix(), jnp.concatenate([leaf.ravel() for leaf in jax.tree.leaves(f_info.residual)])
        now = jnp.sqrt(jnp.sum(J**2, axis=0))
        promise = jnp.sum(_solved(J, r, now, 1e-7)[1] ** 2)
        fell = jnp.sum(state.residual**2) - jnp.sum(r**2)
        return _Local(J, r, jnp.maximum(state.size, now), promise, jnp.where(jnp.any(state.size > 0), fell, jnp.inf))

    def step(self, step_size, state):
        damping = 1 / (self.unit * jnp.sqrt(step_size))
        return -_solved(state.jacobian, state.residual, state.size, damping)[0], optx.RESULTS.successful


def _solved(J, r, size, damping) -> tuple[Array, Array]:
    """argmin |J d - r|^2 + |damping size d|^2, and the part of (r, 0) in the span of (J, damping size)."""
    size = jnp.where(size > 0, size, 1.0)
    q, t = jnp.linalg.qr(jnp.concatenate([J / size[None, :], damping * jnp.eye(size.size)]))
    within = q.T @ jnp.concatenate([r, jnp.zeros_like(size)])
    return jax.scipy.linalg.solve_triangular(t, within) / size, within


class Ending(eqx.Module):
    """When a fit has come far enough: where an undamped step promises to lower chi^2 by less than `enough`, or, far
    from the noise of the `samples`, by a small share of it, or where the last step did lower it by no more than the
    share `crawl`; and after the `most` steps, `MOST_STEPS` of them at most.
    """

    enough: Float[Array, ""]
    crawl: Float[Array, ""]
    samples: Float[Array, ""]
    most: Int[Array, ""]


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """optimistix's Gauss-Newton with `_Marquardt` steps and a trust region that widens on a good step, not on a perfect
    one alone: these residuals bend, and with optimistix's own cutoff of 0.99 the damping stays large.
    """

    ending: Ending
    descent: _Marquardt
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
        """Whether nothing is left to gain."""
        ending, square = self.ending, jnp.sum(state.descent_state.residual**2)
        far = square > _FAR * ending.samples
        little = state.descent_state.promise < jnp.maximum(ending.enough, jnp.where(far, _RELATIVE * square, 0.0))
        return little | (far & (state.descent_state.gain < ending.crawl * square))


def levenberg_marquardt(
    residuals: Callable, start: Float[Array, " N"], unit: Float[Array, ""], ending: Ending
) -> tuple[Float[Array, " N"], Any, Int[Array, ""], Bool[Array, ""]]:
    """min |r(z)|^2 from `start`, where `residuals` takes (z, None) and gives (r, more); its first step changes the
    residuals by about `unit` at most. Returns z, what `more` is there, the number of steps, and whether nothing is
    left to gain.
    """
    solver = _LevenbergMarquardt(ending=ending, descent=_Marquardt(unit))
    solution = optx.least_squares(residuals, solver, start, has_aux=True, max_steps=MOST_STEPS, throw=False)
    return solution.value, solution.state.aux, solution.stats["num_steps"], solver.settled(solution.state)
