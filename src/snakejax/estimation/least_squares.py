"""Least squares over whole runs: residuals of many runs, their Jacobian, and the fit by Levenberg-Marquardt."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snakejax.core.parameter import Domain, parameters, with_parameters
from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Accuracy, simulate

from .batch import Batch
from .levenberg_marquardt import MOST_STEPS, StoppingRule, levenberg_marquardt
from .many_runs import MANY, Ending, solve_many, solve_starts
from .whitening import whitened

REACH = 3.0
"""Largest step of a scaled parameter: exp(3), a factor of 20, for a multiplicative parameter."""
INVERSE_DAMPING = 30.0
"""The first step of a fit is damped by the norms of the columns of the Jacobian over this number: of a single variable
it is 1 / (1 + 1 / 900) of the Gauss-Newton step."""
THREADS = 2
"""Threads that linearise many runs in parallel."""
LANES = 8
"""Double precision numbers in one vector register (512 bits); 8 derivative directions cost as much as fewer."""


class Variables(eqx.Module):
    """Decision variables: parameter values and start states, and the directions in which they may move.

    `values` (P,) are the values of the parameters `names`. Row k of `directions` (K, P) moves them by a step z_k:
    additively, or by the factor exp(z_k) if the parameter is multiplicative. A row of zeros is an unused direction, so
    one compiled program serves every choice of free parameters among `names`. `start` (R, S) are the start states of
    the runs; `free_start` (R, S) is 1 for each component that is estimated, else 0.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[Array, " P"]
    directions: Float[Array, "K P"]
    start: Float[Array, "R S"]
    free_start: Float[Array, "R S"]


class Linearised(NamedTuple):
    """Whitened `residual` (R, n, 3), measured minus modelled over the noise, and its `jacobian` (R, n, 3, K + S) by the
    K parameter steps and the S components of the start state."""

    residual: Float[Array, "R n 3"]
    jacobian: Float[Array, "R n 3 K+S"]


def _float64(number: float | Array) -> Array:
    return jnp.asarray(number, jnp.float64)


class SolverSettings(eqx.Module):
    """When `solve` stops, and its loss.

    It stops where a step is expected to lower chi^2 by less than `enough`, far from the noise also where a step lowered
    chi^2 by less than the fraction `crawl`, and after `most` steps. `threshold` is that of Huber's loss (Huber 1964)
    [standard deviations].
    """

    enough: Float[Array, ""] = eqx.field(converter=_float64, default=0.05)
    crawl: Float[Array, ""] = eqx.field(converter=_float64, default=0.0)
    threshold: Float[Array, ""] = eqx.field(converter=_float64, default=np.inf)
    most: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=MOST_STEPS)


class LeastSquaresResult(NamedTuple):
    """Result of Levenberg-Marquardt: variables, linearisation there, steps taken, whether the gain is exhausted."""

    variables: Variables
    linearised: Linearised
    steps: int
    settled: bool


def variables(model: Model, names: Sequence[str], free: Sequence[str], runs: Batch, width: int) -> Variables:
    """`Variables` at the values of `model`, with the parameters `free` among `names` in `width` directions.

    An empty name in `free` leaves its direction unused.
    """
    known = parameters(model)
    directions = np.zeros((width, len(names)))
    for row, name in enumerate(free):
        if name:
            directions[row, list(names).index(name)] = 1.0
    values = jnp.asarray([float(known[name].value) for name in names])
    return Variables(tuple(names), values, jnp.asarray(directions), runs.start, runs.free_start)


def retract(domains: list[Domain], at: Variables, steps: Float[Array, " K"]) -> Float[Array, " P"]:
    """The parameter values (P,) after `steps` (K,); a step across a bound of the domain is reflected back inside.

    For a parameter with a natural scale the step z saturates as REACH tanh(z / REACH), so one large step cannot lead
    to values at which a simulation becomes very slow. A fit reaches values further away by restarting.
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
    # A very large step is still outside after one reflection: it is clipped.
    inside = (values >= low) & (values <= high)
    return jnp.where(inside, values, jnp.clip(values, low, high))


def domains_of(model: Model, names: Sequence[str]) -> list[Domain]:
    """The domains of the parameters `names`."""
    known = parameters(model)
    return [known[name].domain for name in names]


def narrowed(at: Variables) -> Variables:
    """`at` without trailing unused directions; the number of derivatives stays a multiple of `LANES`."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    used_rows = np.flatnonzero(np.asarray(at.directions).any(axis=1))
    needed = 0 if not used_rows.size else int(used_rows[-1]) + 1
    kept = min(width, -(-max(needed + depth, 1) // LANES) * LANES - depth)
    return eqx.tree_at(lambda u: u.directions, at, at.directions[:kept])


def widened(linearised: Linearised, missing: int, kept: int) -> Linearised:
    """`linearised` with `missing` columns of zeros behind the `kept` directions."""
    return linearised._replace(jacobian=np.insert(linearised.jacobian, [kept] * missing, 0.0, axis=-1))


def _run_residual(model, names, values, start, batch: Batch, accuracy: Accuracy):
    """Residual (n, 3) of one run; `batch` without its leading axis."""
    at_values = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
    with_payload = at_values.with_traced_payload(batch.payload)
    how = {"accuracy": accuracy, "throw": False, "resting": batch.resting}
    pose = simulate(with_payload, batch.gait, batch.times, start, **how).pose
    return whitened(jnp.where(batch.weight > 0, (batch.pose - pose) * batch.weight, 0.0), batch.whitening)


def linearise(model, at: Variables, batch: Batch, order, count, steps, start_steps, accuracy) -> Linearised:
    """Residuals and Jacobian at `at` moved by `steps` (K,) and `start_steps` (R, S), for the runs `order[:count]`."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    R, n = batch.times.shape
    domains = domains_of(model, at.names)

    def add_run(run: Int[Array, ""], linearised: Linearised) -> Linearised:
        k = order[run]
        arguments = jax.tree.map(lambda leaf: leaf[k], (batch, at.start, at.free_start, start_steps))
        data, start, free, shift = arguments

        def residual(z):
            values = retract(domains, at, steps + z[:width])
            return _run_residual(model, at.names, values, start + free * (shift + z[width:]), data, accuracy)

        zero = jnp.zeros(width + depth)
        r, J = jax.vmap(lambda d: jax.jvp(residual, (zero,), (d,)), out_axes=(None, -1))(jnp.eye(width + depth))
        return Linearised(linearised.residual.at[k].set(r), linearised.jacobian.at[k].set(J))

    empty = Linearised(jnp.zeros((R, n, 3)), jnp.zeros((R, n, 3, width + depth)))
    return jax.lax.fori_loop(0, count, add_run, empty)


def first(runs: Sequence[int], batch: Batch) -> tuple[Int[Array, " R"], Int[Array, ""]]:
    """`runs` as arguments of `linearise`: their indices padded to the number of runs of `batch`, and their count."""
    order = np.zeros(batch.start.shape[0], np.int64)
    order[: len(runs)] = runs
    return jnp.asarray(order), jnp.asarray(len(runs))


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


def _in_threads(model, at: Variables, batch: Batch, runs: list[int], accuracy, z, starts) -> Linearised:
    """`linearise` of the `runs`, shared by `THREADS` threads."""

    def share(part: list[int]) -> Linearised:
        order, count = first(part, batch)
        done = _linearise(model, at, batch, order, count, jnp.asarray(z), jnp.asarray(starts), accuracy)
        return Linearised(*(np.asarray(leaf) for leaf in done))

    with ThreadPoolExecutor(THREADS) as pool:
        shares = list(pool.map(share, [runs[k::THREADS] for k in range(THREADS)]))
    return Linearised(*(sum(parts[1:], parts[0]) for parts in zip(*shares, strict=True)))


def _solved_by_elimination(model, at: Variables, batch: Batch, runs: list[int], accuracy, settings, prior):
    """What `_solve` returns, for many runs."""
    free_start = np.asarray(batch.free_start)
    width, R = at.directions.shape[0], len(free_start)
    last: dict[str, tuple] = {}

    def at_point(z: np.ndarray, starts: np.ndarray, numbers: np.ndarray) -> Linearised:
        all_starts = np.zeros_like(free_start)
        all_starts[runs] = starts
        return _in_threads(model, at, batch, [runs[k] for k in numbers], accuracy, z, all_starts)

    def of_runs(z: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = at_point(z, starts, np.arange(len(runs)))
        last["found"] = (z.copy(), starts.copy(), found)
        return np.asarray(found.residual)[runs], np.asarray(found.jacobian)[runs]

    def of_some(starts: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, some = at_point(np.zeros(width), starts, numbers), [runs[k] for k in numbers]
        return np.asarray(found.residual)[some], np.asarray(found.jacobian)[some]

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
    if not (last and np.array_equal(last["found"][0], solved.z) and np.array_equal(last["found"][1], solved.starts)):
        of_runs(solved.z, solved.starts)
    moves = np.zeros((R, free_start.shape[1]))
    moves[runs] = solved.starts
    values = retract(domains_of(model, at.names), at, jnp.asarray(solved.z))
    ended = eqx.tree_at(lambda u: (u.values, u.start), at, (values, at.start + at.free_start * jnp.asarray(moves)))
    return ended, last["found"][2], solved.taken, solved.settled


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
            (jnp.asarray(prior[0]), jnp.asarray(prior[1])),
            settings,
            accuracy,
        )
    linearised = widened(Linearised(*(np.asarray(part) for part in linearised)), len(directions) - width, width)
    return LeastSquaresResult(
        eqx.tree_at(lambda u: u.directions, ended, directions), linearised, int(steps), bool(settled)
    )


def project_out_starts(
    linearised: Linearised, run: int, width: int, free_start: np.ndarray, others: np.ndarray | None = None
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
    """Residual and parameter columns of one run, and `others` (N, c) behind them, orthogonal to its free start state.

    Variable projection (Golub and Pereyra 1973): with the orthonormal basis Q of the columns of the free start
    components, r - Q Q^T r and J - Q Q^T J. A start component without influence, such as the memory of an effect at its
    neutral value, is left out of Q.
    """
    r = np.asarray(linearised.residual[run]).reshape(-1)
    J = np.asarray(linearised.jacobian[run]).reshape(r.size, -1)
    observable = (free_start[run] > 0) & ((J[:, width:] ** 2).sum(axis=0) > 0)
    basis, _ = np.linalg.qr(J[:, width:][:, observable])
    columns = J[:, :width] if others is None else np.concatenate([J[:, :width], others], axis=1)
    return r - basis @ (basis.T @ r), columns - basis @ (basis.T @ columns)


def orthonormal_basis(columns: Float[np.ndarray, "N K"], smallest: float) -> Float[np.ndarray, "N k"]:
    """Orthonormal basis of the span of the normalised `columns`; singular values below `smallest` times the largest are
    dropped."""
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return u[:, s > smallest * max(s.max(initial=0.0), 1e-300)]


def evaluate(model: Model, at: Variables, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`, by the same compiled program as `solve`."""
    if len(runs) > MANY:
        moved = narrowed(at)
        kept = moved.directions.shape[0]
        found = _in_threads(model, moved, batch, runs, accuracy, np.zeros(kept), np.zeros(batch.start.shape))
        return widened(found, len(at.directions) - kept, kept)
    return solve(model, at, batch, runs, accuracy, SolverSettings(most=1)).linearised
