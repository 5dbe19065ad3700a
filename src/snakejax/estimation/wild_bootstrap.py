"""Bootstrap of a fit: refits to what the model reports with its residuals, whose signs are drawn block by block."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from snakejax.core.autocorrelation import memory
from snakejax.core.parallel import in_threads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress

from .fit_record import Fit
from .fit_workspace import problem_of
from .linearisation import domains_of
from .problem import Problem, Solution
from .whitening import coloured

MEMORIES, SHORTEST = 5.0, 0.25
"""Duration of a block, as a multiple of the time in which the autocorrelation of the residuals falls below a tenth,
so that few errors reach from one block into the next; and the shortest duration [s]."""
FEWEST_BLOCKS = 4
"""Blocks of each run at least: with fewer the spread of the refits is that of a few signs."""
ENOUGH = 0.01
"""A refit stops where a step is expected to lower chi^2 by less."""
LEVERAGE = 0.99
"""Largest part of the residual of a block that counts as taken away by the fit."""


class Bootstrap(NamedTuple):
    """Refits of a fit: the estimated `values` (n,) by parameter, and the number of refits that did not converge, which
    are left out."""

    values: dict[str, Float[np.ndarray, " n"]]
    failed: int

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """The interval of each parameter that holds the middle `level` of the refits (percentiles; Efron 1979)."""
        tail = (1 - level) / 2
        return {
            name: (float(np.quantile(values, tail)), float(np.quantile(values, 1 - tail)))
            for name, values in self.values.items()
        }


def bootstrap(fit: Fit, count: int = 200, seed: int = 0, progress: Progress = no_progress) -> Bootstrap:
    """Refit the parameters and the start states to `count` made-up recordings of the train runs.

    Each is the model at the optimum with the measured residuals, of which those in a block of time change sign
    together, at random (the wild bootstrap of Wu 1986, by blocks: Cameron, Gelbach and Miller 2008). The spread of the
    refits is that of the estimates, also where the errors of neighbouring samples are correlated or their size differs,
    as long as errors of different blocks are independent; it needs no linear model. A block is `MEMORIES` times as long
    as the residuals are correlated, and at most 1 / `FEWEST_BLOCKS` of a run: errors of the model that last longer are
    not counted.

    A fit takes away a part of the errors: the residual of block b is (I - H_b)^(-1/2) r_b, with H_b = J_b N^-1 J_b^T
    (Bell and McCaffrey 2002), so that the variance of the linear model is right for independent errors. Each refit
    starts where the linear model expects it to end.
    **Raises:** `ValueError` for a fit without free parameters.
    """
    problem, best = problem_of(fit)
    if not best.free:
        raise ValueError("Nothing was estimated: all parameters of this fit are fixed.")
    train = problem.run_indices("train")
    blocks = _Blocks.of(problem, best, train)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(count, len(blocks.gradient)))
    steps = -signs @ blocks.gradient @ blocks.covariance
    domains, shape, K = domains_of(problem.model, best.free), best.start.shape, len(best.free)
    done: list[int] = []

    def refit(k: int) -> Solution:
        values = dict(best.values)
        for name, domain, step in zip(best.free, domains, steps[k], strict=False):
            values[name] = domain.moved_inside(values[name], step)
        made_up = eqx.tree_at(lambda p: p.batch.pose, problem, jnp.asarray(blocks.poses(problem, signs[k])))
        start = best.start + steps[k][K:].reshape(shape)
        solution = made_up.fit(values, best.free, train, start, threshold=best.threshold, enough=ENOUGH)
        done.append(k)
        progress(ProgressEvent(Phase.BOOTSTRAP, done=len(done), total=count))
        return solution

    refits = [solution for solution in in_threads(refit, range(count)) if solution.converged]
    values = {name: np.array([solution.values[name] for solution in refits]) for name in best.free}
    return Bootstrap(values, count - len(refits))


class _Blocks(NamedTuple):
    """The blocks of the `train` runs.

    `number` (R, n): the block of each sample; `residual` (R, n, 3) at the optimum, and as it is `corrected`; `gradient`
    (B, P): J_b^T of the corrected residual of each block, by the K parameters and the R S start states; `covariance`
    (P, P): the inverse of N = J^T J.
    """

    train: list[int]
    number: Int[np.ndarray, "R n"]
    residual: Float[np.ndarray, "R n 3"]
    corrected: Float[np.ndarray, "R n 3"]
    gradient: Float[np.ndarray, "B P"]
    covariance: Float[np.ndarray, "P P"]

    @staticmethod
    def of(problem: Problem, best: Solution, train: list[int]) -> "_Blocks":
        """The blocks at the optimum `best`."""
        times = np.asarray(problem.batch.times)[train]
        residual, weight = (np.asarray(p)[train] for p in (best.linearised.residual, problem.batch.weight))
        duration = _block_duration(times, np.where(weight > 0, residual, np.nan))
        number = np.floor((times - times[:, :1]) / duration).astype(int)
        number += (number.max() + 1) * np.arange(len(train))[:, None]
        number = np.unique(number, return_inverse=True)[1].reshape(number.shape)
        parts = [_columns(problem, best, run) for run in train]
        size = len(best.free) + best.start.size
        N = np.zeros((size, size))
        for place, columns in parts:
            flat = columns.reshape(-1, len(place))
            N[np.ix_(place, place)] += flat.T @ flat
        covariance = np.linalg.pinv(N, 1e-12, hermitian=True)
        corrected, gradient = residual.copy(), np.zeros((number.max() + 1, size))
        for row, (place, columns) in enumerate(parts):
            for b in np.unique(number[row]):
                inside = number[row] == b
                J, r = columns[inside].reshape(-1, len(place)), residual[row][inside].reshape(-1)
                r = _unfitted(J, r, covariance[np.ix_(place, place)])
                corrected[row, inside] = r.reshape(-1, 3)
                gradient[b, place] = J.T @ r
        return _Blocks(train, number, residual, corrected, gradient, covariance)

    def poses(self, problem: Problem, signs: Float[np.ndarray, " B"]) -> Float[np.ndarray, "R n 3"]:
        """The poses of all runs whose residuals at the optimum are the corrected ones, with these `signs`."""
        poses, weights = np.array(problem.batch.pose), np.asarray(problem.batch.weight)
        for row, run in enumerate(self.train):
            change = self.corrected[row] * signs[self.number[row]][:, None] - self.residual[row]
            K = problem.batch.whitening
            change = coloured(change, None if K is None else K[run])
            poses[run] += np.divide(change, weights[run], out=np.zeros_like(change), where=weights[run] > 0)
        return poses


def _block_duration(times: Float[np.ndarray, "R n"], residual: Float[np.ndarray, "R n 3"]) -> float:
    """The duration [s] of a block, from the memory of the `residual` (NaN: missing) of the channel that has most."""
    step = float(np.median(np.diff(times)))
    forgotten = step * max(memory(residual[..., channel]) for channel in range(3))
    longest = float((times[:, -1] - times[:, 0]).min()) / FEWEST_BLOCKS
    return min(max(MEMORIES * forgotten, SHORTEST), longest)


def _columns(problem: Problem, best: Solution, run: int) -> tuple[np.ndarray, np.ndarray]:
    """The unknowns on which a run depends, by number, and its derivatives (n, 3, p) by these."""
    S, K = best.start.shape[1], len(best.free)
    estimated = np.flatnonzero(np.asarray(problem.batch.free_start)[run] > 0)
    J = np.asarray(best.linearised.jacobian)[run]
    place = np.concatenate([np.arange(K), K + run * S + estimated])
    return place, np.concatenate([J[..., :K], J[..., J.shape[-1] - S :][..., estimated]], axis=-1)


def _unfitted(J: np.ndarray, r: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(I - H)^(-1/2) r with H = J C J^T: by Q, an orthonormal basis of the columns of J = Q S, from S C S^T."""
    Q, S = np.linalg.qr(J)
    taken, vectors = np.linalg.eigh(S @ covariance @ S.T)
    inside = vectors.T @ (Q.T @ r)
    return r + Q @ (vectors @ ((1 / np.sqrt(1 - np.clip(taken, 0.0, LEVERAGE)) - 1) * inside))
