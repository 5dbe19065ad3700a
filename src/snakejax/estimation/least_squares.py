"""Least squares over whole runs: the fit by Levenberg-Marquardt, of many runs with their start states eliminated."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snakejax.core.parallel import WORKERS, in_threads
from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Accuracy

from .batch import Batch
from .kept_program import KeptProgram
from .levenberg_marquardt import MOST_STEPS, StoppingRule, levenberg_marquardt
from .linear_residuals import LinearResiduals
from .linearisation import Linearised, Variables, domains_of, first, linearise, narrowed, retract, widened
from .many_runs import MANY, Ending, solve_many, solve_starts

INVERSE_DAMPING = 30.0
"""The first step of a fit is damped by the norms of the columns of the Jacobian over this number: of a single variable
it is 1 / (1 + 1 / 900) of the Gauss-Newton step."""


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


def _robust(r: np.ndarray, J: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals whose square is twice Huber's loss (Huber 1964), and their Jacobian.

    The square is r^2 for |r| <= t and 2 t |r| - t^2 above, with t the `threshold` in standard deviations.
    """
    size = np.abs(r)
    outlying = size > threshold
    if not outlying.any():
        return r, J
    t = np.where(outlying, threshold, 1.0)
    robust_size = np.sqrt(np.where(outlying, 2 * t * size - t**2, 1.0))
    slope = np.where(outlying, t / robust_size, 1.0)
    return np.where(outlying, np.sign(r) * robust_size, r), J * slope[..., None]


_linearise = KeptProgram(linearise, Linearised)


def linearise_in_threads(
    model: Model, at: Variables, batch: Batch, runs: list[int], accuracy: Accuracy, z: np.ndarray, starts: np.ndarray
) -> Linearised:
    """`linearise` of the `runs`, shared by `WORKERS` threads; of no runs it compiles the program.

    The runs take different time, so that there are more shares than threads.
    """

    def share(part: list[int]) -> Linearised:
        order, count = first(part, batch)
        done = _linearise(model, at, batch, order, count, z, starts, accuracy)
        return Linearised(*(np.asarray(leaf) for leaf in done))

    if len(runs) < WORKERS:
        return share(runs)
    count = min(len(runs), 2 * WORKERS)
    shares = in_threads(share, [runs[k::count] for k in range(count)])
    return Linearised(*(sum(parts[1:], parts[0]) for parts in zip(*shares, strict=True)))


class _Origin(NamedTuple):
    """Where a fit begins: `model` and `batch` at the variables `at`, simulated with `accuracy`, and the linearisation
    there if it is `known`."""

    model: Model
    at: Variables
    batch: Batch
    accuracy: Accuracy
    known: Linearised | None

    def linearised(self, runs: list[int], z: np.ndarray, moves: np.ndarray) -> Linearised:
        """The linearisation of `runs` after the steps `z` (K,) of the parameters and `moves` (R, S) of the starts."""
        if self.known is not None and not z.any() and not moves.any():
            return self.known
        return linearise_in_threads(self.model, self.at, self.batch, runs, self.accuracy, z, moves)

    def moved(self, z: np.ndarray, moves: np.ndarray) -> Variables:
        """The variables after these steps."""
        values = retract(domains_of(self.model, self.at.names), self.at, jnp.asarray(z))
        start = self.at.start + self.at.free_start * jnp.asarray(moves)
        return eqx.tree_at(lambda u: (u.values, u.start), self.at, (values, start))


def _solved_by_steps(origin: _Origin, runs: list[int], settings: SolverSettings, prior) -> LeastSquaresResult:
    """`solve` for few runs: with the start states of the whole batch as variables beside the parameters."""
    width, (R, depth) = len(origin.at.directions), origin.at.start.shape
    pull, strength = prior

    def linearised_at(z: np.ndarray) -> LinearResiduals:
        linearised = origin.linearised(runs, z[:width], z[width:].reshape(R, depth))
        r, J = _robust(*linearised, float(settings.threshold))
        pulled = strength * (z[:width] - pull)
        return LinearResiduals(r.reshape(R, -1), J.reshape(R, -1, width + depth), pulled, strength, linearised)

    samples = float((np.asarray(origin.batch.weight)[runs] > 0).sum())
    ending = StoppingRule(settings.enough, settings.crawl, _float64(samples), settings.most)
    ended = levenberg_marquardt(linearised_at, np.zeros(width + R * depth), _float64(INVERSE_DAMPING), ending)
    moved = origin.moved(ended.z[:width], ended.z[width:].reshape(R, depth))
    return LeastSquaresResult(moved, ended.residuals.detail, ended.steps, ended.settled)


def _solved_by_elimination(origin: _Origin, runs: list[int], settings: SolverSettings, prior) -> LeastSquaresResult:
    """`solve` for many runs, whose start states are eliminated run by run."""
    free_start = np.asarray(origin.batch.free_start)
    width, R = origin.at.directions.shape[0], len(free_start)
    last: dict[str, tuple] = {}

    def at_point(z: np.ndarray, starts: np.ndarray, numbers: np.ndarray) -> Linearised:
        all_starts = np.zeros_like(free_start)
        all_starts[runs] = starts
        return origin.linearised([runs[k] for k in numbers], z, all_starts)

    def of_runs(z: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linearised = at_point(z, starts, np.arange(len(runs)))
        last["point"] = (z.copy(), starts.copy(), linearised)
        return np.asarray(linearised.residual)[runs], np.asarray(linearised.jacobian)[runs]

    def of_some(starts: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linearised, some = at_point(np.zeros(width), starts, numbers), [runs[k] for k in numbers]
        return np.asarray(linearised.residual)[some], np.asarray(linearised.jacobian)[some]

    def robust(parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return _robust(*parts, float(settings.threshold))

    samples = int((np.asarray(origin.batch.weight)[runs] > 0).sum())
    ending = Ending(float(settings.enough), float(settings.crawl), samples, int(settings.most))
    if np.asarray(origin.at.directions).any():
        solved = solve_many(of_runs, robust, free_start[runs], prior, ending)
    else:
        solved = solve_starts(of_some, robust, free_start[runs], width, ending)
    if not (last and np.array_equal(last["point"][0], solved.z) and np.array_equal(last["point"][1], solved.starts)):
        of_runs(solved.z, solved.starts)
    moves = np.zeros((R, free_start.shape[1]))
    moves[runs] = solved.starts
    return LeastSquaresResult(origin.moved(solved.z, moves), last["point"][2], solved.taken, solved.settled)


def solve(
    model: Model,
    at: Variables,
    batch: Batch,
    runs: list[int],
    accuracy: Accuracy,
    settings: SolverSettings | None = None,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    known: Linearised | None = None,
) -> LeastSquaresResult:
    """Minimise chi^2 by Levenberg-Marquardt (Moré 1978) from `at`, over the runs with the indices `runs`.

    **Arguments:** `settings`: stopping rule and loss; `prior`: (mean, 1 / standard deviation) of the steps, each (K,);
    `known`: the linearisation at `at`, where it has been computed.
    """
    directions, at = at.directions, narrowed(at)
    width = at.directions.shape[0]
    prior = (np.zeros(width), np.zeros(width)) if prior is None else (prior[0][:width], prior[1][:width])
    settings = SolverSettings() if settings is None else settings
    if known is not None:
        known = known._replace(jacobian=np.delete(known.jacobian, np.s_[width : len(directions)], axis=-1))
    solved_by = _solved_by_elimination if len(runs) > MANY else _solved_by_steps
    solved = solved_by(_Origin(model, at, batch, accuracy, known), runs, settings, prior)
    return solved._replace(
        variables=eqx.tree_at(lambda u: u.directions, solved.variables, directions),
        linearised=widened(solved.linearised, len(directions) - width, width),
    )


def evaluate(model: Model, at: Variables, batch: Batch, runs: list[int], accuracy: Accuracy) -> Linearised:
    """Residuals and Jacobian at `at`, by the compiled program of `solve`."""
    moved = narrowed(at)
    kept = moved.directions.shape[0]
    linearised = linearise_in_threads(model, moved, batch, runs, accuracy, np.zeros(kept), np.zeros(batch.start.shape))
    return widened(linearised, len(at.directions) - kept, kept)
