"""Runs that differ from the others: another tyre, a bump of the floor, a marker that slipped between two runs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.core.parameter import Domain

LEVEL = 0.01
"""A run is odd where so large a statistic of any run and parameter has less than this probability by chance (Bonferroni
over the runs and the parameters)."""
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
    error `sd`; so would those in `alike`, nearly as well. `p_value`: corrected for the number of runs and parameters.
    """

    run: str
    parameter: str
    shift: float
    sd: float
    p_value: float
    alike: tuple[str, ...] = ()

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

    which is chi^2 with one degree of freedom where run i is like the others (score test, Rao 1948). The others are
    judged again without the run that is odd: it moves the common parameters, which makes them look odd too.
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

        (theta_i - value)^T V_i^-1 (theta_i - value) > chi^2 of B degrees of freedom at `LEVEL` / R,

    and not that it is neutral, theta_i^T V_i^-1 theta_i below the same bound. None where there is no such run.
    """
    if len(gram) < TRAIN_RUNS:
        return None
    rows, total = np.asarray(fitted, int) + 1, gram.sum(axis=0)
    at = [list(fitted).index(k) for k in some]
    bound = float(stats.chi2.isf(LEVEL / len(gram), len(at)))
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
    rows = np.asarray(fitted, int) + 1
    total = gram.sum(axis=0)
    normal = total[np.ix_(rows, rows)]
    if precision is not None:
        normal = normal + np.diag(precision[list(fitted)])
    inverse = _pseudoinverse(normal)
    step = inverse @ total[rows, 0]
    scores = [[_score(one, rows, inverse, step, k + 1) for k in names.values()] for one in gram]
    falls = np.array([[fall for fall, _, _ in of_run] for of_run in scores])
    run, best = divmod(int(np.argmax(falls)), len(names))
    fall, shift, sd = scores[run][best]
    p = min(1.0, float(stats.chi2.sf(fall, 1)) * falls.size)
    if not p < LEVEL:
        return None
    parameter = list(names)[best]
    near = [name for name, other in zip(names, falls[run], strict=True) if other > fall - ALIKE]
    return run, OddRun(runs[run], parameter, shift, sd, p, tuple(name for name in near if name != parameter))


def _pseudoinverse(normal: np.ndarray) -> np.ndarray:
    """The inverse of a semidefinite matrix, scaled to a unit diagonal; what the runs do not show takes no step."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size)
    return np.linalg.pinv(scaled, rcond=UNSHOWN, hermitian=True) / np.outer(size, size)


def _score(gram: np.ndarray, rows: np.ndarray, inverse: np.ndarray, step: np.ndarray, k: int) -> tuple[float, ...]:
    """The fall of chi^2, the shift and its standard deviation; zeros for a parameter that the run does not show."""
    cross = gram[k, rows]
    left = gram[k, 0] - cross @ step
    own = gram[k, k] - cross @ inverse @ cross
    if not own > 1e-9 * gram[k, k]:
        return 0.0, 0.0, np.inf
    return float(left**2 / own), float(left / own), float(own**-0.5)
