"""The restricted likelihood of noise and random force, with its slope.

Restricted (residual) maximum likelihood (Patterson and Thompson 1971) counts what the free parameters d take up:

    R = L + chi^2 + ln |N|        N = D^T D + prior precision        (-2 log likelihood, d integrated out)

with L and the Gram matrix G of `kalman`, each a sum over runs. With d the optimum, R changes with G by dR/dG, which is
(1, -d) (1, -d)^T and N^-1 for the parameters, so the slope of R is that of L + <dR/dG, G> with dR/dG held. Run by run,
what reverse differentiation keeps stays in the cache of a core, and several cores work side by side.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.parallel import WORKERS, ContextThreads, cores

from ..kept_program import KeptProgram
from .kalman import Discrepancy, SegmentData, filter_runs
from .least_squares import Prior

COLUMNS = 8
"""The number of columns of a compiled program is a multiple of this."""


def discrepancy_of(logarithms: Float[np.ndarray, "9"]) -> Discrepancy:
    """The discrepancy of nine logarithms: white and wandering noise of position and of heading, the time constant of
    the latter, three strengths of the force and its time constant."""
    e = np.exp(logarithms)
    return Discrepancy(e[[0, 0, 1]], e[[2, 2, 3]], float(e[4]), e[5:8], float(e[8]))


def logarithms_of(of: Discrepancy) -> Float[np.ndarray, "9"]:
    """The nine logarithms of a discrepancy, see `discrepancy_of`."""
    return np.log([of.white[0], of.white[2], of.wander[0], of.wander[2], of.wander_time, *of.force, of.force_time])


def _gram_and_logs(logarithms, data: SegmentData):
    e = jnp.exp(logarithms)
    position, both = jnp.array([0, 0, 1]), jnp.array([2, 2, 3])
    noise = (e[position], e[both], e[4], e[5:8], e[8])
    gram, logs, _ = filter_runs(data, noise, jnp.zeros(data.columns.shape[1]))
    return gram.sum(axis=(0, 1)), logs.sum()


def _weighted(logarithms, data: SegmentData, weight):
    gram, logs = _gram_and_logs(logarithms, data)
    return logs + jnp.sum(weight * gram)


_gram_of_run = KeptProgram(_gram_and_logs)


@KeptProgram
def _slope_of_run(logarithms, data: SegmentData, weight):
    return jax.grad(_weighted)(logarithms, data, weight)


class RestrictedLikelihood(NamedTuple):
    """R of `runs`, each the data of one, with the parameters free that have the prior `precision` and `mean` (P,); runs
    are filtered by `threads`."""

    runs: tuple[SegmentData, ...]
    precision: np.ndarray
    mean: np.ndarray
    threads: ContextThreads

    def value(self, logarithms: Float[np.ndarray, "9"]) -> float:
        """R at nine logarithms."""
        return self._value_and_weight(jnp.asarray(logarithms))[0]

    def value_and_slope(self, logarithms: Float[np.ndarray, "9"]) -> tuple[float, Float[np.ndarray, "9"]]:
        """R at nine logarithms, and its derivatives."""
        at = jnp.asarray(logarithms)
        value, weight = self._value_and_weight(at)
        slopes = self.threads.map(lambda run: np.asarray(_slope_of_run(at, run, weight)), self.runs)
        return value, np.sum(list(slopes), axis=0)

    def _value_and_weight(self, at: jax.Array) -> tuple[float, np.ndarray]:
        """R and dR/dG."""
        filtered = self.threads.map(lambda run: jax.tree.map(np.asarray, _gram_of_run(at, run)), self.runs)
        grams, logs = zip(*filtered, strict=True)
        gram = np.sum(grams, axis=0)
        normal, right = gram[1:, 1:] + np.diag(self.precision), gram[1:, 0] + self.precision * self.mean
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.sqrt(np.diag(normal))
            scaled = normal / np.outer(size, size)
        try:
            inverse = np.linalg.inv(scaled) / np.outer(size, size)
        except np.linalg.LinAlgError:
            return np.nan, np.full_like(gram, np.nan)
        step = np.linalg.solve(scaled, right / size) / size
        chi2 = gram[0, 0] + self.precision @ self.mean**2 - right @ step
        weight = np.zeros_like(gram)
        weight[0, 0], weight[1:, 0], weight[1:, 1:] = 1.0, -2 * step, np.outer(step, step) + inverse
        return float(np.sum(logs) + chi2 + np.linalg.slogdet(scaled)[1] + 2 * np.log(size).sum()), weight


@contextmanager
def likelihood_of(data: SegmentData, free: np.ndarray, prior: Prior) -> Iterator[RestrictedLikelihood]:
    """R of `data` with the parameters numbered `free` free within their `prior`.

    Columns are filled up with zeros, so that one compiled program serves several sets of parameters; a column filled in
    has precision 1, which adds nothing to R.
    """
    kept, missing = data.keeping(free), -len(free) % COLUMNS
    filled = kept._replace(
        columns=np.pad(kept.columns, [(0, 0)] * 4 + [(0, missing)]),
        shift=np.pad(kept.shift, [(0, 0)] * 3 + [(0, missing)]),
    )
    runs = tuple(SegmentData(*(jnp.asarray(part[k : k + 1]) for part in filled)) for k in range(len(data.rest)))
    precision = np.pad(prior.precision[free], (0, missing), constant_values=1.0)
    with ContextThreads(min(WORKERS, cores())) as threads:
        yield RestrictedLikelihood(runs, precision, np.pad(prior.mean[free], (0, missing)), threads)


def restricted_likelihood(data: SegmentData, of: Discrepancy, free: np.ndarray, prior: Prior) -> float:
    """R (-2 log restricted likelihood) with the parameters numbered `free` free within their `prior`."""
    with likelihood_of(data, free, prior) as likelihood:
        return likelihood.value(logarithms_of(of))
