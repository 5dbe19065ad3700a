"""Whole-run least squares: the residuals of many runs, their Jacobian, and the one room that knows optimistix."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from ._batch import Batch
from ._model import Model
from ._simulate import Accuracy, simulate
from ._units import parameter_vector, parameters, with_parameters


class Unknowns(eqx.Module):
    """A point in the space of parameters and starts, and the directions in which it may move.

    `values` (P,) are all parameters of the model in the order of `parameters(model)`; row k of `directions` (K, P) moves
    them by a step z_k: additively, or by a factor exp(z_k) where the parameter is multiplicative. A row of zeros is a
    direction not in use, so that one compiled program serves any choice of free parameters. `start` (R, S) and
    `free_start` (R, S) do the same for where each run starts.
    """

    values: Float[Array, " P"]
    directions: Float[Array, "K P"]
    start: Float[Array, "R S"]
    free_start: Float[Array, "R S"]


class Linearised(NamedTuple):
    """Whitened residuals (R, n, 3), measured minus modelled, and minus their derivative: (R, n, 3, K + S)."""

    residual: Float[Array, "R n 3"]
    jacobian: Float[Array, "R n 3 K+S"]


class Solved(NamedTuple):
    """Where Levenberg-Marquardt ended."""

    unknowns: Unknowns
    linearised: Linearised
    steps: int
    converged: bool


def bounds(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(low, high, multiplicative), each (P,), of all parameters of `model`."""
    domains = [parameter.domain for parameter in parameters(model).values()]
    return (
        np.array([d.low for d in domains]),
        np.array([d.high for d in domains]),
        np.array([d.multiplicative for d in domains]),
    )


def unknowns(model: Model, free: list[str], runs: Batch, width: int | None = None) -> Unknowns:
    """The unknowns at the values `model` has, with `free` parameters and the starts that `runs` leave open.

    `width` is the number of directions, at least as many as there are free parameters.
    """
    names = list(parameters(model))
    width = max(len(free), 1) if width is None else width
    directions = np.zeros((width, len(names)))
    for row, name in enumerate(free):
        directions[row, names.index(name)] = 1.0
    return Unknowns(parameter_vector(model), jnp.asarray(directions), runs.start, runs.free_start)


def moved(model: Model, at: Unknowns, steps: Float[Array, " K"]) -> Float[Array, " P"]:
    """The parameter values after `steps`, kept inside their domains; the derivative is one on the closed domain."""
    low, high, multiplicative = bounds(model)
    shift = jnp.einsum("k,kp->p", steps, at.directions)
    values = jnp.where(multiplicative, at.values * jnp.exp(shift), at.values + shift)
    inside = (values >= low) & (values <= high)
    return jnp.where(inside, values, jax.lax.stop_gradient(jnp.clip(values, low, high)))


def model_at(model: Model, values: Float[Array, " P"]) -> Model:
    """`model` with all its parameters replaced by `values`."""
    return with_parameters(model, dict(zip(parameters(model), values, strict=True)))


def _run_residual(model, values, start, batch: Batch, accuracy: Accuracy):
    """Residual (n, 3) of one run; `batch` without its leading axis."""
    loaded = eqx.tree_at(lambda m: m.board, model_at(model, values), replace_fn=lambda b: b.loaded(*batch.payload))
    pose = simulate(loaded, batch.gait, batch.times, start, accuracy=accuracy, throw=False).pose
    return jnp.where(batch.weight > 0, (batch.pose - pose) * batch.weight, 0.0)


def linearise(model, at: Unknowns, batch: Batch, order, count, steps, start_steps, accuracy) -> Linearised:
    """Residuals and Jacobian at `at` moved by `steps` (K,) and `start_steps` (R, S), for runs `order[:count]` alone."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    R, n = batch.times.shape

    def one(run: Int[Array, ""], out: Linearised) -> Linearised:
        k = order[run]
        mine = jax.tree.map(lambda leaf: leaf[k], (batch, at.start, at.free_start, start_steps))
        piece, start, free, shift = mine

        def residual(z):
            values = moved(model, at, steps + z[:width])
            return _run_residual(model, values, start + free * (shift + z[width:]), piece, accuracy)

        zero = jnp.zeros(width + depth)
        r, J = jax.vmap(lambda d: jax.jvp(residual, (zero,), (d,)), out_axes=(None, -1))(jnp.eye(width + depth))
        return Linearised(out.residual.at[k].set(r), out.jacobian.at[k].set(J))

    empty = Linearised(jnp.zeros((R, n, 3)), jnp.zeros((R, n, 3, width + depth)))
    return jax.lax.fori_loop(0, count, one, empty)


def _robust(r, J, threshold):
    """Residuals whose square is twice Huber's loss: quadratic below `threshold`, linear above; inf leaves them alone."""
    size = jnp.abs(r)
    far = size > threshold
    t = jnp.where(far, threshold, 1.0)
    bent = jnp.sqrt(jnp.where(far, 2 * t * size - t**2, 1.0))
    slope = jnp.where(far, t / bent, 1.0)
    return jnp.where(far, jnp.sign(r) * bent, r), J * slope[..., None]


@eqx.filter_jit
def _solve(model, at: Unknowns, batch: Batch, order, count, scale, start_scale, tolerance, threshold, accuracy):
    width, depth = at.directions.shape[0], at.start.shape[1]
    R = batch.times.shape[0]

    def residuals(z, _):
        fixed = jax.lax.stop_gradient(z)
        steps = fixed[:width] * scale
        start_steps = fixed[width:].reshape(R, depth) * start_scale
        out = linearise(model, at, batch, order, count, steps, start_steps, accuracy)
        r, J = _robust(*out, threshold)
        dz, dstart = (z - fixed)[:width] * scale, (z - fixed)[width:].reshape(R, depth) * start_scale
        # The value is r; the derivative is the Jacobian just computed, run by run.
        linear = r + jnp.einsum("rnck,k->rnc", J[..., :width], dz) + jnp.einsum("rncs,rs->rnc", J[..., width:], dstart)
        return linear, out

    solution = optx.least_squares(
        residuals,
        optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance, linear_solver=lx.QR()),
        jnp.zeros(width + R * depth),
        has_aux=True,
        max_steps=100,
        throw=False,
    )
    z = solution.value
    values = moved(model, at, z[:width] * scale)
    start = at.start + at.free_start * z[width:].reshape(R, depth) * start_scale
    ended = eqx.tree_at(lambda u: (u.values, u.start), at, (values, start))
    return ended, solution.aux, solution.stats["num_steps"], solution.result == optx.RESULTS.successful


def solve(
    model: Model,
    at: Unknowns,
    batch: Batch,
    runs: list[int],
    *,
    scale: np.ndarray | None = None,
    start_scale: np.ndarray | None = None,
    tolerance: float = 1e-3,
    threshold: float = np.inf,
    accuracy: Accuracy,
) -> Solved:
    """Levenberg-Marquardt from `at` over the runs numbered `runs`.

    Steps are counted in units of `scale` (K,) and `start_scale` (R, S), so that a step of one changes the residuals by
    about one standard deviation of the noise; it ends when steps and residuals change by less than `tolerance`. An
    infinite tolerance evaluates at `at` and moves nothing.
    """
    R, S = batch.start.shape
    order = np.zeros(R, np.int64)
    order[: len(runs)] = runs
    scale = np.ones(at.directions.shape[0]) if scale is None else scale
    start_scale = np.ones((R, S)) if start_scale is None else start_scale
    ended, linearised, steps, converged = _solve(
        model,
        at,
        batch,
        jnp.asarray(order),
        jnp.asarray(len(runs)),
        jnp.asarray(scale),
        jnp.asarray(start_scale),
        jnp.asarray(tolerance),
        jnp.asarray(threshold),
        accuracy,
    )
    return Solved(ended, Linearised(*(np.asarray(part) for part in linearised)), int(steps), bool(converged))


def evaluate(model: Model, at: Unknowns, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`, by the same compiled program as `solve`."""
    return solve(model, at, batch, runs, tolerance=np.inf, accuracy=accuracy).linearised
