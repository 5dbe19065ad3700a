"""Whole-run least squares: the residuals of many runs and their Jacobian, and the fit of them."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._batch import Batch
from ._marquardt import MOST_STEPS, Ending, levenberg_marquardt
from ._model import Model
from ._simulate import Accuracy, simulate
from ._units import Domain, parameters, with_parameters
from ._whitening import whitened

REACH = 3.0
LANES = 8
"""Derivatives in so many directions cost as much as in fewer: numbers in one vector of the processor."""


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
    settled: bool


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


def narrowed(at: Unknowns) -> Unknowns:
    """`at` without the directions behind the last one in use, but with as many as fill whole vectors of `LANES`."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    used = np.flatnonzero(np.asarray(at.directions).any(axis=1))
    least = 0 if not used.size else int(used[-1]) + 1
    kept = min(width, -(-max(least + depth, 1) // LANES) * LANES - depth)
    return eqx.tree_at(lambda u: u.directions, at, at.directions[:kept])


def widened(found: Linearised, missing: int, kept: int) -> Linearised:
    """`found` with `missing` columns of zeros behind the `kept` directions."""
    return found._replace(jacobian=np.insert(found.jacobian, [kept] * missing, 0.0, axis=-1))


def _run_residual(model, names, values, start, batch: Batch, accuracy: Accuracy):
    """Residual (n, 3) of one run; `batch` without its leading axis."""
    set_ = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
    loaded = eqx.tree_at(lambda m: m.board, set_, replace_fn=lambda b: b.loaded(*batch.payload))
    how = {"accuracy": accuracy, "throw": False, "resting": batch.resting}
    pose = simulate(loaded, batch.gait, batch.times, start, **how).pose
    return whitened(jnp.where(batch.weight > 0, (batch.pose - pose) * batch.weight, 0.0), batch.whitening)


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


def first(runs: Sequence[int], batch: Batch) -> tuple[Int[Array, " R"], Int[Array, ""]]:
    """`runs` as `linearise` takes them: their numbers, padded to all runs of `batch`, and how many they are."""
    order = np.zeros(batch.start.shape[0], np.int64)
    order[: len(runs)] = runs
    return jnp.asarray(order), jnp.asarray(len(runs))


def _robust(r, J, threshold):
    """Residuals whose square is twice Huber's loss: quadratic below `threshold`, linear above."""
    size = jnp.abs(r)
    far = size > threshold
    t = jnp.where(far, threshold, 1.0)
    bent = jnp.sqrt(jnp.where(far, 2 * t * size - t**2, 1.0))
    slope = jnp.where(far, t / bent, 1.0)
    return jnp.where(far, jnp.sign(r) * bent, r), J * slope[..., None]


def _triangles(r, J):
    """R (R, K+S+1, K+S+1) of the QR decomposition of [J r], run by run: as a residual and its Jacobian it has the same
    norm, gradient and curvature as they, in few numbers. Where one is not finite the residual is infinite.
    """
    whole = jnp.concatenate([J, r[..., None]], axis=-1).reshape(r.shape[0], -1, J.shape[-1] + 1)
    finite = jnp.all(jnp.isfinite(whole))
    # One after the other: a batch of decompositions waits for threads that two fits at a time do not leave it.
    triangle = jax.lax.map(lambda one: jnp.linalg.qr(one, mode="r"), jnp.where(finite, whole, 0.0))
    return jnp.where(finite, triangle[..., -1], jnp.inf), triangle[..., :-1]


@eqx.filter_jit
def _solve(model, at: Unknowns, batch: Batch, order, count, unit, prior, enough, crawl, threshold, most, accuracy):
    width, depth = at.directions.shape[0], at.start.shape[1]
    R = batch.times.shape[0]
    pull, strength = prior

    def residuals(z, _):
        fixed = jax.lax.stop_gradient(z)
        out = linearise(model, at, batch, order, count, fixed[:width], fixed[width:].reshape(R, depth), accuracy)
        r, J = _triangles(*_robust(*out, threshold))
        dz, dstart = (z - fixed)[:width], (z - fixed)[width:].reshape(R, depth)
        # The value is r; the derivative is the Jacobian just computed, run by run.
        linear = r + jnp.einsum("rmk,k->rm", J[..., :width], dz) + jnp.einsum("rms,rs->rm", J[..., width:], dstart)
        return (linear, strength * (z[:width] - pull)), out

    present = jnp.sum(batch.weight > 0, axis=(1, 2))[order]
    samples = jnp.sum(jnp.where(jnp.arange(R) < count, present, 0)).astype(float)
    ending = Ending(enough, crawl, samples, most)
    z, out, taken, settled = levenberg_marquardt(residuals, jnp.zeros(width + R * depth), unit, ending)
    values = moved(domains_of(model, at.names), at, z[:width])
    start = at.start + at.free_start * z[width:].reshape(R, depth)
    ended = eqx.tree_at(lambda u: (u.values, u.start), at, (values, start))
    return ended, out, taken, settled


def solve(
    model: Model,
    at: Unknowns,
    batch: Batch,
    runs: list[int],
    *,
    unit: float = 30.0,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    enough: float = 0.05,
    crawl: float = 0.0,
    threshold: float = np.inf,
    most: int = MOST_STEPS,
    accuracy: Accuracy,
) -> Solved:
    """Levenberg-Marquardt from `at` over the runs numbered `runs`.

    The first step changes the residuals by about `unit` standard deviations of the noise at most. It ends where a step
    promises to lower chi^2 by less than `enough`, or far from the noise has lowered it by less than the share `crawl`,
    and after `most` steps. `prior` (mean, 1 / spread) of the steps, each (K,), if any.
    """
    directions, at = at.directions, narrowed(at)
    width = at.directions.shape[0]
    prior = (np.zeros(width), np.zeros(width)) if prior is None else (prior[0][:width], prior[1][:width])
    ended, linearised, steps, settled = _solve(
        model,
        at,
        batch,
        *first(runs, batch),
        jnp.asarray(unit, jnp.float64),
        (jnp.asarray(prior[0]), jnp.asarray(prior[1])),
        jnp.asarray(enough, jnp.float64),
        jnp.asarray(crawl, jnp.float64),
        jnp.asarray(threshold, jnp.float64),
        jnp.asarray(most),
        accuracy,
    )
    linearised = widened(Linearised(*(np.asarray(part) for part in linearised)), len(directions) - width, width)
    return Solved(eqx.tree_at(lambda u: u.directions, ended, directions), linearised, int(steps), bool(settled))


def starts_removed(
    found: Linearised, run: int, width: int, free_start: np.ndarray, beside: np.ndarray | None = None
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
    """Residual and parameter columns of one run, and columns (N, c) `beside` these, with what its free start components
    explain projected out.

    A component that moves nothing, such as the memory of an effect at its neutral value, explains nothing.
    """
    r = np.asarray(found.residual[run]).reshape(-1)
    J = np.asarray(found.jacobian[run]).reshape(r.size, -1)
    felt = (free_start[run] > 0) & ((J[:, width:] ** 2).sum(axis=0) > 0)
    q, _ = np.linalg.qr(J[:, width:][:, felt])
    columns = J[:, :width] if beside is None else np.concatenate([J[:, :width], beside], axis=1)
    return r - q @ (q.T @ r), columns - q @ (q.T @ columns)


def basis(columns: Float[np.ndarray, "N K"], smallest: float) -> Float[np.ndarray, "N k"]:
    """An orthonormal basis of the span of `columns`, scaled alike, less directions below `smallest` of the largest."""
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return u[:, s > smallest * max(s.max(initial=0.0), 1e-300)]


def evaluate(model: Model, at: Unknowns, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`, by the same compiled program as `solve`."""
    return solve(model, at, batch, runs, most=1, accuracy=accuracy).linearised
