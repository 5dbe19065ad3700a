"""Least squares over whole runs: the fit by Levenberg-Marquardt, of many runs with their start states eliminated."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Accuracy

from .batch import Batch
from .levenberg_marquardt import MOST_STEPS, StoppingRule, levenberg_marquardt
from .linearisation import Linearised, Variables, domains_of, first, linearise, narrowed, retract, widened
from .many_runs import MANY, Ending, solve_many, solve_starts

INVERSE_DAMPING = 30.0
"""The first step of a fit is damped by the norms of the columns of the Jacobian over this number: of a single variable
it is 1 / (1 + 1 / 900) of the Gauss-Newton step."""
THREADS = 2
"""Threads that linearise many runs in parallel."""


def _float64(number: float | Array) -> Array:
    # An array of numpy takes a tenth of the time to make.
    return np.asarray(number, np.float64)  # type: ignore[return-value]


def _integer(number: int | Array) -> Array:
    return np.asarray(number)  # type: ignore[return-value]


class SolverSettings(eqx.Module):
    """When `solve` stops, and its loss.

    It stops where a step is expected to lower chi^2 by less than `enough`, far from the noise also where a step lowered
    chi^2 by less than the fraction `crawl`, and after `most` steps. `threshold` is that of Huber's loss (Huber 1964)
    [standard deviations].
    """

    enough: Float[Array, ""] = eqx.field(converter=_float64, default=0.05)
    crawl: Float[Array, ""] = eqx.field(converter=_float64, default=0.0)
    threshold: Float[Array, ""] = eqx.field(converter=_float64, default=np.inf)
    most: Int[Array, ""] = eqx.field(converter=_integer, default=MOST_STEPS)


class LeastSquaresResult(NamedTuple):
    """Result of Levenberg-Marquardt: variables, linearisation there, steps taken, whether the gain is exhausted."""

    variables: Variables
    linearised: Linearised
    steps: int
    settled: bool


def _robust(r, J, threshold):
    """Residuals whose square is twice Huber's loss (Huber 1964), and their Jacobian.

    The square is r^2 for |r| <= t and 2 t |r| - t^2 above, with t the `threshold` in standard deviations.
    """
    size = jnp.abs(r)
    outlying = size > threshold
    t = jnp.where(outlying, threshold, 1.0)
    robust_size = jnp.sqrt(jnp.where(outlying, 2 * t * size - t**2, 1.0))
    slope = jnp.where(outlying, t / robust_size, 1.0)
    return jnp.where(outlying, jnp.sign(r) * robust_size, r), J * slope[..., None]


def _triangles(r, J):
    """Triangular factor (R, K+S+1, K+S+1) of the QR decomposition of [J r], run by run, split into residual, Jacobian.

    It has the same norm, gradient and curvature as r and J in far fewer rows. The residual is infinite where an entry
    of [J r] is not finite.
    """
    augmented = jnp.concatenate([J, r[..., None]], axis=-1).reshape(r.shape[0], -1, J.shape[-1] + 1)
    finite = jnp.all(jnp.isfinite(augmented))
    # Sequentially: a batch of decompositions would wait for threads that two concurrent fits occupy.
    triangle = jax.lax.map(lambda one: jnp.linalg.qr(one, mode="r"), jnp.where(finite, augmented, 0.0))
    return jnp.where(finite, triangle[..., -1], jnp.inf), triangle[..., :-1]


@eqx.filter_jit
def _solve(model, at: Variables, batch: Batch, selection, inverse_damping, prior, settings: SolverSettings, accuracy):
    """The variables at the end, the linearisation there, the number of steps, and whether the gain is exhausted."""
    order, count = selection
    width, depth = at.directions.shape[0], at.start.shape[1]
    R = batch.times.shape[0]
    pull, strength = prior

    def residuals(z, _):
        fixed = jax.lax.stop_gradient(z)
        out = linearise(model, at, batch, order, count, fixed[:width], fixed[width:].reshape(R, depth), accuracy)
        r, J = _triangles(*_robust(*out, settings.threshold))
        dz, dstart = (z - fixed)[:width], (z - fixed)[width:].reshape(R, depth)
        # The value is r; the derivative is the Jacobian just computed, run by run.
        linear = r + jnp.einsum("rmk,k->rm", J[..., :width], dz) + jnp.einsum("rms,rs->rm", J[..., width:], dstart)
        return (linear, strength * (z[:width] - pull)), out

    present = jnp.sum(batch.weight > 0, axis=(1, 2))[order]
    samples = jnp.sum(jnp.where(jnp.arange(R) < count, present, 0)).astype(float)
    ending = StoppingRule(settings.enough, settings.crawl, samples, settings.most)
    z, out, taken, settled = levenberg_marquardt(residuals, jnp.zeros(width + R * depth), inverse_damping, ending)
    values = retract(domains_of(model, at.names), at, z[:width])
    start = at.start + at.free_start * z[width:].reshape(R, depth)
    ended = eqx.tree_at(lambda u: (u.values, u.start), at, (values, start))
    return ended, out, taken, settled


_linearise = eqx.filter_jit(linearise)


def in_threads(share: Callable[[list[int]], Linearised], runs: list[int]) -> Linearised:
    """The `runs` linearised by `THREADS` threads, each of which linearises its `share` of them and no other."""
    with ThreadPoolExecutor(THREADS) as pool:
        shares = list(pool.map(share, [runs[k::THREADS] for k in range(THREADS)]))
    return Linearised(*(sum(parts[1:], parts[0]) for parts in zip(*shares, strict=True)))


def linearise_in_threads(model, at: Variables, batch: Batch, runs: list[int], accuracy, z, starts) -> Linearised:
    """`linearise` of the `runs`, shared by `THREADS` threads."""

    def share(part: list[int]) -> Linearised:
        order, count = first(part, batch)
        done = _linearise(model, at, batch, order, count, jnp.asarray(z), jnp.asarray(starts), accuracy)
        return Linearised(*(np.asarray(leaf) for leaf in done))

    return in_threads(share, runs)


def _solved_by_elimination(model, at: Variables, batch: Batch, runs: list[int], accuracy, settings, prior):
    """What `_solve` returns, for many runs."""
    free_start = np.asarray(batch.free_start)
    width, R = at.directions.shape[0], len(free_start)
    last: dict[str, tuple] = {}

    def at_point(z: np.ndarray, starts: np.ndarray, numbers: np.ndarray) -> Linearised:
        all_starts = np.zeros_like(free_start)
        all_starts[runs] = starts
        return linearise_in_threads(model, at, batch, [runs[k] for k in numbers], accuracy, z, all_starts)

    def of_runs(z: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linearised = at_point(z, starts, np.arange(len(runs)))
        last["point"] = (z.copy(), starts.copy(), linearised)
        return np.asarray(linearised.residual)[runs], np.asarray(linearised.jacobian)[runs]

    def of_some(starts: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linearised, some = at_point(np.zeros(width), starts, numbers), [runs[k] for k in numbers]
        return np.asarray(linearised.residual)[some], np.asarray(linearised.jacobian)[some]

    def robust(parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        if not np.isfinite(float(settings.threshold)):
            return parts
        r, J = _robust(jnp.asarray(parts[0]), jnp.asarray(parts[1]), settings.threshold)
        return np.asarray(r), np.asarray(J)

    samples = int((np.asarray(batch.weight)[runs] > 0).sum())
    ending = Ending(float(settings.enough), float(settings.crawl), samples, int(settings.most))
    if np.asarray(at.directions).any():
        solved = solve_many(of_runs, robust, free_start[runs], prior, ending)
    else:
        solved = solve_starts(of_some, robust, free_start[runs], width, ending)
    if not (last and np.array_equal(last["point"][0], solved.z) and np.array_equal(last["point"][1], solved.starts)):
        of_runs(solved.z, solved.starts)
    moves = np.zeros((R, free_start.shape[1]))
    moves[runs] = solved.starts
    values = retract(domains_of(model, at.names), at, jnp.asarray(solved.z))
    ended = eqx.tree_at(lambda u: (u.values, u.start), at, (values, at.start + at.free_start * jnp.asarray(moves)))
    return ended, last["point"][2], solved.taken, solved.settled


def solve(
    model: Model,
    at: Variables,
    batch: Batch,
    runs: list[int],
    accuracy: Accuracy,
    settings: SolverSettings | None = None,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
) -> LeastSquaresResult:
    """Minimise chi^2 by Levenberg-Marquardt (Moré 1978) from `at`, over the runs with the indices `runs`.

    **Arguments:** `settings`: stopping rule and loss; `prior`: (mean, 1 / standard deviation) of the steps, each (K,).
    """
    directions, at = at.directions, narrowed(at)
    width = at.directions.shape[0]
    prior = (np.zeros(width), np.zeros(width)) if prior is None else (prior[0][:width], prior[1][:width])
    settings = SolverSettings() if settings is None else settings
    if len(runs) > MANY:
        ended, linearised, steps, settled = _solved_by_elimination(model, at, batch, runs, accuracy, settings, prior)
    else:
        ended, linearised, steps, settled = _solve(
            model,
            at,
            batch,
            first(runs, batch),
            _float64(INVERSE_DAMPING),
            prior,
            settings,
            accuracy,
        )
    linearised = widened(Linearised(*(np.asarray(part) for part in linearised)), len(directions) - width, width)
    return LeastSquaresResult(
        eqx.tree_at(lambda u: u.directions, ended, directions), linearised, int(steps), bool(settled)
    )


def evaluate(model: Model, at: Variables, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`: of a batch of few runs by the same compiled program as `solve`, which has the
    start states of the whole batch as variables; of a batch of many by one without them, however few of `runs`."""
    if batch.start.shape[0] > MANY:
        moved = narrowed(at)
        kept = moved.directions.shape[0]
        linearised = linearise_in_threads(
            model, moved, batch, runs, accuracy, np.zeros(kept), np.zeros(batch.start.shape)
        )
        return widened(linearised, len(at.directions) - kept, kept)
    return solve(model, at, batch, runs, accuracy, SolverSettings(most=1)).linearised
