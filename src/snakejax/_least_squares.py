"""Whole-run least squares: the residuals of many runs, their Jacobian, and the one room that knows optimistix."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

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
from ._units import Domain, Scalar, parameters, with_parameters

REACH = 3.0
MOST_STEPS = 60


def _on_residuals(change: Any) -> Scalar:
    """Two-norm of a change of the residuals (a tuple), zero for one of the unknowns.

    So a fit ends when a step no longer changes what is seen: |J dz| is the step in units of standard errors.
    """
    return optx.two_norm(change) if isinstance(change, tuple) else jnp.zeros(())


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """optimistix's damped Newton descent, with a trust region that widens on a fair step, not on a perfect one alone.

    These residuals bend: with optimistix's own cutoff of 0.99 the damping stays large and a fit takes thrice the steps.
    """

    rtol: float
    atol: Float[Array, ""]
    most: Int[Array, ""]
    norm: Callable = _on_residuals
    descent: optx.AbstractDescent = optx.DampedNewtonDescent(linear_solver=lx.QR())
    search: optx.AbstractSearch = optx.ClassicalTrustRegion(high_cutoff=0.5, high_constant=8.0)
    verbose: Callable = lambda **_: None

    def terminate(self, fn, y, args, options, state, tags):
        done, result = super().terminate(fn, y, args, options, state, tags)
        return done | (state.num_steps >= self.most), result


class Unknowns(eqx.Module):
    """A point in the space of parameters and starts, and the directions in which it may move.

    `values` (P,) belong to the parameters `names`, which one compiled program can move; row k of `directions` (K, P)
    moves them by a step z_k: additively, or by a factor exp(z_k) where the parameter is multiplicative. A row of zeros
    is a direction not in use, so that the program serves any choice of free ones among `names`. `start` (R, S) and
    `free_start` (R, S) do the same for where each run starts.
    """

    names: tuple[str, ...] = eqx.field(static=True)
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


def unknowns(model: Model, names: Sequence[str], free: Sequence[str], runs: Batch, width: int) -> Unknowns:
    """The unknowns at the values `model` has, with `free` among the movable `names`, in `width` directions.

    An empty name leaves its direction unused.
    """
    known = parameters(model)
    directions = np.zeros((width, len(names)))
    for row, name in enumerate(free):
        if name:
            directions[row, list(names).index(name)] = 1.0
    values = jnp.asarray([float(known[name].value) for name in names])
    return Unknowns(tuple(names), values, jnp.asarray(directions), runs.start, runs.free_start)


def moved(domains: list[Domain], at: Unknowns, steps: Float[Array, " K"]) -> Float[Array, " P"]:
    """The parameter values after `steps`; a step across a bound of the domain is reflected back inside.

    Where a parameter has a natural scale the steps saturate at `REACH` of it, so that one wild step of a fit does not
    end where a simulation takes for ever; a fit that wants further gets there by being taken up again.
    """
    low, high = (np.array([getattr(domain, end) for domain in domains]) for end in ("low", "high"))
    multiplicative = np.array([domain.multiplicative for domain in domains])
    scaled = np.array([domain.multiplicative or domain.typical is not None for domain in domains])
    shift = jnp.einsum("k,kp->p", steps, at.directions)
    shift = jnp.where(scaled, REACH * jnp.tanh(shift / REACH), shift)
    values = jnp.where(multiplicative, at.values * jnp.exp(shift), at.values + shift)
    above, below = values > high, values < low
    values = jnp.where(above, 2 * np.where(np.isfinite(high), high, 0.0) - values, values)
    values = jnp.where(below, 2 * np.where(np.isfinite(low), low, 0.0) - values, values)
    # Only a wild step is still outside after one reflection.
    inside = (values >= low) & (values <= high)
    return jnp.where(inside, values, jnp.clip(values, low, high))


def domains_of(model: Model, names: Sequence[str]) -> list[Domain]:
    """The domains of the parameters `names`."""
    known = parameters(model)
    return [known[name].domain for name in names]


def _run_residual(model, names, values, start, batch: Batch, accuracy: Accuracy):
    """Residual (n, 3) of one run; `batch` without its leading axis."""
    set_ = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
    loaded = eqx.tree_at(lambda m: m.board, set_, replace_fn=lambda b: b.loaded(*batch.payload))
    pose = simulate(loaded, batch.gait, batch.times, start, accuracy=accuracy, throw=False).pose
    return jnp.where(batch.weight > 0, (batch.pose - pose) * batch.weight, 0.0)


def linearise(model, at: Unknowns, batch: Batch, order, count, steps, start_steps, accuracy) -> Linearised:
    """Residuals and Jacobian at `at` moved by `steps` (K,) and `start_steps` (R, S), for runs `order[:count]` alone."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    R, n = batch.times.shape
    domains = domains_of(model, at.names)

    def one(run: Int[Array, ""], out: Linearised) -> Linearised:
        k = order[run]
        mine = jax.tree.map(lambda leaf: leaf[k], (batch, at.start, at.free_start, start_steps))
        piece, start, free, shift = mine

        def residual(z):
            values = moved(domains, at, steps + z[:width])
            return _run_residual(model, at.names, values, start + free * (shift + z[width:]), piece, accuracy)

        zero = jnp.zeros(width + depth)
        r, J = jax.vmap(lambda d: jax.jvp(residual, (zero,), (d,)), out_axes=(None, -1))(jnp.eye(width + depth))
        return Linearised(out.residual.at[k].set(r), out.jacobian.at[k].set(J))

    empty = Linearised(jnp.zeros((R, n, 3)), jnp.zeros((R, n, 3, width + depth)))
    return jax.lax.fori_loop(0, count, one, empty)


def _robust(r, J, threshold):
    """Residuals whose square is twice Huber's loss: quadratic below `threshold`, linear above."""
    size = jnp.abs(r)
    far = size > threshold
    t = jnp.where(far, threshold, 1.0)
    bent = jnp.sqrt(jnp.where(far, 2 * t * size - t**2, 1.0))
    slope = jnp.where(far, t / bent, 1.0)
    return jnp.where(far, jnp.sign(r) * bent, r), J * slope[..., None]


@eqx.filter_jit
def _solve(
    model, at: Unknowns, batch: Batch, order, count, scale, start_scale, prior, tolerance, threshold, most, accuracy
):
    width, depth = at.directions.shape[0], at.start.shape[1]
    R = batch.times.shape[0]
    pull, strength = prior

    def residuals(z, _):
        fixed = jax.lax.stop_gradient(z)
        steps = fixed[:width] * scale
        start_steps = fixed[width:].reshape(R, depth) * start_scale
        out = linearise(model, at, batch, order, count, steps, start_steps, accuracy)
        r, J = _robust(*out, threshold)
        dz, dstart = (z - fixed)[:width] * scale, (z - fixed)[width:].reshape(R, depth) * start_scale
        # The value is r; the derivative is the Jacobian just computed, run by run.
        linear = r + jnp.einsum("rnck,k->rnc", J[..., :width], dz) + jnp.einsum("rncs,rs->rnc", J[..., width:], dstart)
        return (linear, strength * (z[:width] * scale - pull)), out

    solution = optx.least_squares(
        residuals,
        _LevenbergMarquardt(rtol=0.0, atol=tolerance, most=most),
        jnp.zeros(width + R * depth),
        has_aux=True,
        max_steps=MOST_STEPS,
        throw=False,
    )
    z = solution.value
    values = moved(domains_of(model, at.names), at, z[:width] * scale)
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
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    tolerance: float = 0.05,
    threshold: float = np.inf,
    most: int = MOST_STEPS,
    accuracy: Accuracy,
) -> Solved:
    """Levenberg-Marquardt from `at` over the runs numbered `runs`.

    Steps are counted in units of `scale` (K,) and `start_scale` (R, S), so that a step of one changes the residuals by
    about one standard deviation of the noise; it ends when the residuals, as one vector, change by less than
    `tolerance`. An infinite tolerance evaluates at `at` and moves nothing. `prior` (mean, 1 / spread) of the steps,
    each (K,), if any. `most` bounds the number of steps.
    """
    R, S = batch.start.shape
    order = np.zeros(R, np.int64)
    order[: len(runs)] = runs
    scale = np.ones(at.directions.shape[0]) if scale is None else scale
    start_scale = np.ones((R, S)) if start_scale is None else start_scale
    prior = (np.zeros_like(scale), np.zeros_like(scale)) if prior is None else prior
    ended, linearised, steps, converged = _solve(
        model,
        at,
        batch,
        jnp.asarray(order),
        jnp.asarray(len(runs)),
        jnp.asarray(scale),
        jnp.asarray(start_scale),
        (jnp.asarray(prior[0]), jnp.asarray(prior[1])),
        jnp.asarray(tolerance, jnp.float64),
        jnp.asarray(threshold, jnp.float64),
        jnp.asarray(most),
        accuracy,
    )
    return Solved(
        ended, Linearised(*(np.asarray(part) for part in linearised)), int(steps), bool(converged) and int(steps) < most
    )


def starts_removed(
    found: Linearised, run: int, width: int, free_start: np.ndarray
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
    """Residual and parameter columns of one run, with what its free start components explain projected out."""
    r = np.asarray(found.residual[run]).reshape(-1)
    J = np.asarray(found.jacobian[run]).reshape(r.size, -1)
    q, _ = np.linalg.qr(J[:, width:][:, free_start[run] > 0])
    return r - q @ (q.T @ r), J[:, :width] - q @ (q.T @ J[:, :width])


def basis(columns: Float[np.ndarray, "N K"], smallest: float) -> Float[np.ndarray, "N k"]:
    """An orthonormal basis of the span of `columns`, scaled alike, less directions below `smallest` of the largest."""
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return u[:, s > smallest * max(s.max(initial=0.0), 1e-300)]


def evaluate(model: Model, at: Unknowns, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`, by the same compiled program as `solve`."""
    return solve(model, at, batch, runs, tolerance=np.inf, accuracy=accuracy).linearised
