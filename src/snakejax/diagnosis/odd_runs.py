"""Runs that differ from the others: another tyre, a bump of the floor, a marker that slipped between two runs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.core.parameter import Domain

LEVEL = 0.05
"""A run is odd where so large a statistic of any run and parameter has less than this probability by chance: of twenty
cases without an odd run, one names a run."""
EXCLUDED = 0.01
"""The other runs exclude the value of an effect where they contradict it at this level, divided by the number of runs.
"""
DRAWS = 4000
"""Made-up cases by which the probability of the largest statistic is estimated: at `LEVEL` within 0.0035."""
NUMBERS = 1_000_000
"""So many numbers of made-up cases are held at a time: 8 MB."""
OWN = 1e-9
"""A run does not show a parameter where less than this share of G_i[k, k] is left beside the common parameters."""
TRAIN_RUNS = 3
"""Of two runs that differ nobody can say which is the odd one."""
UNSHOWN = 1e-10
"""A combination of parameters whose normal equations are smaller than this share of the largest is one that the runs do
not show."""
ALIKE = 4.0
"""Another parameter is named as well where its statistic is lower by less than this: a likelihood ratio of exp(2)."""


class OddRun(NamedTuple):
    """A run to which the parameters of all runs do not apply.

    `parameter` would explain the run with a value of its own, `shift` away from that of all runs, with its standard
    error `sd`; so would those in `alike`, nearly as well. `p_value`: of so large a statistic in any run and parameter.
    `effects`: those of which each explains as much if it acts in all runs.
    """

    run: str
    parameter: str
    shift: float
    sd: float
    p_value: float
    alike: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()

    @property
    def fall(self) -> float:
        """By how much chi^2 falls with the shift."""
        return (self.shift / self.sd) ** 2

    def in_units(self, domain: Domain, value: float) -> "OddRun":
        """With a shift of the parameter at `value`, where it was one of the coordinates that a fit moves."""
        scale = abs(value) if domain.multiplicative else 1.0
        return self._replace(shift=self.shift * scale, sd=self.sd * scale)


def run_grams(
    residual: Float[np.ndarray, " N"], columns: Float[np.ndarray, "N P"], run: np.ndarray
) -> Float[np.ndarray, "R P1 P1"]:
    """Gram matrices of [residual | columns] of each run, with the `run` (N,) to which each row belongs."""
    both = np.column_stack([residual, columns])
    return np.array([both[run == k].T @ both[run == k] for k in range(int(run.max()) + 1)])


def odd_runs(
    gram: Float[np.ndarray, "R P1 P1"],
    runs: Sequence[str],
    names: Mapping[str, int],
    fitted: Sequence[int],
    precision: Float[np.ndarray, " P"] | None = None,
) -> tuple[OddRun, ...]:
    """The runs that one parameter with a value of its own explains better, the surest first.

    With the Gram matrices G_i of [r | C] of each run (residual whitened, r - C d after a step d), the parameters
    `fitted` in common and the normal equations H = sum of G_i (+ `precision` of their priors), a shift s of parameter k
    in run i alone lowers chi^2 by

        u^2 / V,   u = C_k^T (r - C d),   V = G_i[k, k] - G_i[k, F] H^-1 G_i[F, k],   s = u / V,

    which is chi^2 with one degree of freedom where run i is like the others (score test, Rao 1948). The largest of all
    runs and parameters is compared with the largest of made-up cases without an odd run: many parameters act alike, so
    that it is smaller than that of as many independent tests. The others are judged again without the run that is odd:
    it moves the common parameters, which makes them look odd too.
    `names`: the parameters that may shift and their columns. Of fewer than three runs none is the odd one.
    """
    odd_ones: list[OddRun] = []
    gram, left = gram.copy(), len(runs)
    while left >= TRAIN_RUNS and (odd := _oddest(gram, runs, names, fitted, precision)) is not None:
        run, shift = odd
        odd_ones.append(shift)
        gram[run] = 0.0
        left -= 1
    return tuple(odd_ones)


def run_that_alone_shows(
    gram: Float[np.ndarray, "R P1 P1"],
    fitted: Sequence[int],
    some: Sequence[int],
    value: Float[np.ndarray, " B"],
) -> int | None:
    """The number of the run without which the parameters `some` (B,), at `value` from neutral, are not there.

    With theta_i and its covariance V_i from all runs but run i, in the linear model of `gram` at the fit of the
    parameters `fitted`: the others exclude the value,

        (theta_i - value)^T V_i^-1 (theta_i - value) > chi^2 of B degrees of freedom at `EXCLUDED` / R,

    and not that it is neutral, theta_i^T V_i^-1 theta_i below the same bound. None where there is no such run.
    """
    if len(gram) < TRAIN_RUNS:
        return None
    rows, total = np.asarray(fitted, int) + 1, gram.sum(axis=0)
    at = [list(fitted).index(k) for k in some]
    bound = float(stats.chi2.isf(EXCLUDED / len(gram), len(at)))
    for run, one in enumerate(gram):
        others = total - one
        covariance = _pseudoinverse(others[np.ix_(rows, rows)])
        moved = (covariance @ others[rows, 0])[at]
        information = _pseudoinverse(covariance[np.ix_(at, at)])
        if moved @ information @ moved > bound >= (value + moved) @ information @ (value + moved):
            return run
    return None


def _oddest(
    gram: Float[np.ndarray, "R P1 P1"],
    runs: Sequence[str],
    names: Mapping[str, int],
    fitted: Sequence[int],
    precision: Float[np.ndarray, " P"] | None,
) -> tuple[int, OddRun] | None:
    """The run and the parameter whose shift lowers chi^2 most, and the number of the run; None where none is odd."""
    test = _ShiftTest.of(gram, list(names.values()), fitted, precision)
    falls = test.score**2 * test.variance
    run, best = divmod(int(np.argmax(falls)), len(names))
    fall, variance = float(falls[run, best]), float(test.variance[run, best])
    p = test.probability(fall)
    if not p < LEVEL:
        return None
    parameter = list(names)[best]
    near = [name for name, other in zip(names, falls[run], strict=True) if other > fall - ALIKE]
    shift = float(test.score[run, best]) * variance
    alike = tuple(name for name in near if name != parameter)
    return run, OddRun(runs[run], parameter, shift, variance**0.5, p, alike)


class _ShiftTest(NamedTuple):
    """The score test of a shift of each of K parameters in each of R runs beside F fitted parameters.

    `gram`: G_i of the P columns; `cross`: C_k^T C_F of each run; `inverse`: of H; `prior`: square roots of the
    precisions of the priors; `score`: u; `variance`: 1 / V, zero where the run does not show the parameter.
    """

    gram: Float[np.ndarray, "R P P"]
    columns: np.ndarray
    fitted: np.ndarray
    cross: Float[np.ndarray, "R K F"]
    inverse: Float[np.ndarray, "F F"]
    prior: Float[np.ndarray, " F"]
    score: Float[np.ndarray, "R K"]
    variance: Float[np.ndarray, "R K"]

    @classmethod
    def of(
        cls,
        gram: Float[np.ndarray, "R P1 P1"],
        columns: Sequence[int],
        fitted: Sequence[int],
        precision: Float[np.ndarray, " P"] | None,
    ) -> "_ShiftTest":
        some, common = np.asarray(columns, int), np.asarray(fitted, int)
        scores, grams = gram[:, 1:, 0], gram[:, 1:, 1:]
        prior = np.zeros(len(common)) if precision is None else np.asarray(precision)[common]
        inverse = _pseudoinverse(grams.sum(axis=0)[np.ix_(common, common)] + np.diag(prior))
        cross = grams[:, some[:, None], common]
        u = scores[:, some] - cross @ (inverse @ scores.sum(axis=0)[common])
        own = grams[:, some, some]
        V = own - np.einsum("rkf,fg,rkg->rk", cross, inverse, cross)
        variance = np.divide(1.0, V, out=np.zeros_like(V), where=OWN * own < V)
        return cls(grams, some, common, cross, inverse, np.sqrt(prior), u, variance)

    def probability(self, fall: float) -> float:
        """Probability of a statistic as large as `fall` in any run and parameter where no run is odd.

        The share of `DRAWS` made-up cases, with C^T r of run i drawn from N(0, G_i) and that of the priors from their
        precision; where it is too small for so few, the bound of Bonferroni.
        """
        bound = min(1.0, float(stats.chi2.sf(fall, 1)) * self.score.size)
        if bound < 1.0 / DRAWS:
            return bound
        random, roots, above = np.random.default_rng(0), _roots(self.gram), 0
        runs, width, _ = self.gram.shape
        batch = max(1, NUMBERS // (runs * width))
        for first in range(0, DRAWS, batch):
            count = min(batch, DRAWS - first)
            scores = roots @ random.normal(size=(runs, width, count))
            priors = self.prior[:, None] * random.normal(size=(len(self.fitted), count))
            step = self.inverse @ (scores.sum(axis=0)[self.fitted] + priors)
            u = scores[:, self.columns] - self.cross @ step
            above += int(np.sum(np.max(u**2 * self.variance[:, :, None], axis=(0, 1)) >= fall))
        return min(bound, (1 + above) / (1 + DRAWS))


def _roots(gram: Float[np.ndarray, "R P P"]) -> Float[np.ndarray, "R P P"]:
    """A matrix A_i with A_i A_i^T = G_i of each semidefinite G_i."""
    size = np.sqrt(np.maximum(np.einsum("rpp->rp", gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / (size[:, :, None] * size[:, None, :]))
    return size[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]


def _pseudoinverse(normal: np.ndarray) -> np.ndarray:
    """The inverse of a semidefinite matrix, scaled to a unit diagonal; what the runs do not show takes no step."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size)
    return np.linalg.pinv(scaled, rcond=UNSHOWN, hermitian=True) / np.outer(size, size)
