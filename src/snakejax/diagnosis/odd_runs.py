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

    which is chi^2 with one degree of freedom where run i is like the others (score test, Rao 1948). `names`: the
    parameters that may shift and their columns. Fewer than three runs have no odd one.
    """
    if len(runs) < TRAIN_RUNS:
        return ()
    rows = np.asarray(fitted, int) + 1
    total = gram.sum(axis=0)
    normal = total[np.ix_(rows, rows)]
    if precision is not None:
        normal = normal + np.diag(precision[list(fitted)])
    inverse = _pseudoinverse(normal)
    step = inverse @ total[rows, 0]
    shifts = []
    for run, one in zip(runs, gram, strict=True):
        scores = [_score(one, rows, inverse, step, k + 1) for k in names.values()]
        best = int(np.argmax([fall for fall, _, _ in scores]))
        fall, shift, sd = scores[best]
        p = min(1.0, float(stats.chi2.sf(fall, 1)) * len(runs) * len(names))
        if p < LEVEL:
            near = [name for name, s in zip(names, scores, strict=True) if s[0] > fall - ALIKE]
            parameter = list(names)[best]
            shifts.append(OddRun(run, parameter, shift, sd, p, tuple(name for name in near if name != parameter)))
    return tuple(sorted(shifts, key=lambda odd: odd.p_value))


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
