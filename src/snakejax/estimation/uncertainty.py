"""Uncertainty of fitted parameters: standard errors, correlation, and what the runs do not determine."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.parameter import Domain

from .goodness_of_fit import consistent_with_noise
from .jackknife import left_out_sd
from .linearisation import Linearised, domains_of, project_out_starts
from .multiple_shooting import LENGTH
from .problem import Problem, Solution

UNDETERMINED_SD = 0.5
"""A parameter is undetermined if its relative standard error (for E: the standard error) is larger than this."""
UNKNOWN = 10.0
"""Above this relative standard error none is reported: the linear model does not hold so far from the optimum."""

MOST_WHOLE_RUNS = 8
"""More runs than these that all begin in motion are windows of longer recordings."""
FEWEST_RECORDINGS = 10
"""With fewer recordings than these single windows are left out: one of few holds so much of what is known that the
linear problem says little without it."""


class RefittedInterval(NamedTuple):
    """A 95% interval from refits, and its `source`, "profile" or "bootstrap"; an open end is None."""

    low: float | None
    high: float | None
    source: str


class Estimate(NamedTuple):
    """A fitted `value` in `unit`; `sd`: one standard error, None at a bound or if the data do not limit the value."""

    value: float
    sd: float | None
    unit: str
    determined: bool
    at_bound: bool = False

    def __str__(self) -> str:
        sd = "" if self.sd is None else f" +- {self.sd:.2g}"
        return f"{self.value:.4g}{sd} {self.unit}".removesuffix(" -")

    def interval(self, quantile: float = 1.959964) -> tuple[float, float] | None:
        """The interval value -+ `quantile` sd; the default is the 95 % interval of the normal distribution."""
        return None if self.sd is None else (self.value - quantile * self.sd, self.value + quantile * self.sd)


def estimate_of(value: float, step: float, domain: Domain, held: bool) -> Estimate:
    """The estimate of a parameter of `domain` at `value`, whose standard error is one `step`; none where it is `held`
    at a bound."""
    shaped = domain.multiplicative or domain.typical is not None
    sd = None if held else step * (abs(value) if domain.multiplicative else 1.0)
    return Estimate(value, sd, domain.unit, not held and not (shaped and step > UNDETERMINED_SD), held)


def spread(solution: Solution) -> float:
    """Factor on standard errors for a misfit above noise: sqrt(max(1, chi^2 / degrees of freedom))."""
    unknown = len(solution.loose) + solution.start.size
    return float(np.sqrt(max(1.0, solution.misfit * solution.samples / max(solution.samples - unknown, 1))))


def contradicted(problem: Problem, solution: Solution) -> dict[str, float]:
    """Standard errors by the jackknife over runs, for interior parameters of effects; empty if only noise is left.

    The value of an effect that stands in for a missing one differs between runs. For a single run, intervals of
    `LENGTH` [s] are left out in place of runs. Of windows of longer recordings all parameters have one: what a vehicle
    does not repeat lasts as long as a window. Whole recordings are left out, windows where there are less than
    `FEWEST_RECORDINGS`.
    """
    if consistent_with_noise(solution):
        return {}
    columns = [solution.free.index(name) for name in solution.loose]
    free_start, times = np.asarray(problem.batch.free_start), np.asarray(problem.batch.times)
    # The Jacobian of runs that were not fitted is zero.
    runs = [k for k, J in enumerate(solution.linearised.jacobian) if J.any()]
    windows = len(runs) > MOST_WHOLE_RUNS and all(problem.runs[k].moving for k in runs)
    concerned = [name for name in solution.loose if windows or name.startswith("effects.")]
    if not concerned:
        return {}
    linearised = solution.linearised
    if windows and np.isfinite(solution.threshold):
        # The weights of Huber's loss, with which least squares have the same optimum.
        size = np.maximum(np.abs(linearised.residual), solution.threshold)
        root = np.sqrt(solution.threshold / size)
        linearised = Linearised(linearised.residual * root, linearised.jacobian * root[..., None])
    parts = [project_out_starts(linearised, k, problem.width, free_start) for k in runs]
    J, r = np.concatenate([J[:, columns] for _, J in parts]), np.concatenate([r for r, _ in parts])
    if not (np.isfinite(J).all() and np.isfinite(r).all()):
        return {}
    names, recording = np.unique([problem.runs[k].recorded_as for k in runs], return_inverse=True)
    left_out = recording if windows and len(names) >= FEWEST_RECORDINGS else np.asarray(runs)
    group = np.repeat(left_out, [len(r) for r, _ in parts])
    if len(runs) == 1:
        group = np.repeat(np.floor((times[runs[0]] - times[runs[0]][0]) / LENGTH), 3)
    jackknife = dict(zip(solution.loose, left_out_sd(J, r, group), strict=True))
    return {name: float(jackknife[name]) for name in concerned}


def estimates_of(problem: Problem, solution: Solution) -> dict[str, Estimate]:
    """Value, standard error and identifiability of each free parameter.

    The standard error is sqrt(covariance) times `spread`. For a parameter of an effect, and for all of a fit to
    windows, it is the jackknife error if that is larger and more than noise is left, see `contradicted`.
    """
    factor, jackknife = spread(solution), contradicted(problem, solution)
    variances = dict(zip(solution.loose, np.diag(solution.covariance), strict=True))
    estimates = {}
    for name, domain in zip(solution.free, domains_of(problem.model, solution.free), strict=True):
        value = solution.values[name]
        if name in solution.held:
            estimates[name] = Estimate(value, None, domain.unit, False, True)
            continue
        step = max(float(np.sqrt(variances[name])) * factor, jackknife.get(name, 0.0))
        sd = step * abs(value) if domain.multiplicative else step
        shaped = domain.multiplicative or domain.typical is not None
        known = bool(np.isfinite(sd)) and not (shaped and step > UNKNOWN)
        determined = known and not (shaped and step > UNDETERMINED_SD)
        estimates[name] = Estimate(value, sd if known else None, domain.unit, determined)
    return estimates


def correlation(solution: Solution) -> Float[np.ndarray, "k k"]:
    """Correlation matrix (k, k) of the interior parameters; NaN where a standard error is not finite."""
    sd = np.sqrt(np.diag(solution.covariance)) if solution.covariance.size else np.zeros(0)
    known = np.isfinite(sd) & (sd > 0)
    matrix = np.full(solution.covariance.shape, np.nan)
    rows = np.ix_(known, known)
    matrix[rows] = solution.covariance[rows] / np.outer(sd[known], sd[known])
    return matrix


def identifiable_combinations(
    problem: Problem, solution: Solution, estimates: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Combinations of parameters that the runs determine although they do not determine the single parameters.

    These are the cornering stiffness BCD [N/rad], and eigenvectors of the covariance of undetermined parameters whose
    standard error is below 0.1 (10 % for a product of powers, written as a sum of logarithms).
    """
    factor, loose = spread(solution), list(solution.loose)
    combinations = {}
    pacejka = ["tyre.B", "tyre.C", "tyre.D"]
    if all(name in solution.values for name in pacejka) and any(name in loose for name in pacejka):
        rows = [loose.index(name) for name in pacejka if name in loose]
        relative = float(np.sqrt(max(solution.covariance[np.ix_(rows, rows)].sum(), 0.0))) * factor
        value = float(np.prod([solution.values[name] for name in pacejka]))
        known = relative < UNKNOWN
        combinations["BCD"] = Estimate(value, relative * value if known else None, "N/rad", relative < UNDETERMINED_SD)
    finite = np.isfinite(np.diag(solution.covariance)) if loose else np.zeros(0, bool)
    undetermined = [
        name for name, is_finite in zip(loose, finite, strict=True) if is_finite and not estimates[name].determined
    ]
    if len(undetermined) > 1:
        rows = [loose.index(name) for name in undetermined]
        values, vectors = np.linalg.eigh(solution.covariance[np.ix_(rows, rows)])
        domains = domains_of(problem.model, undetermined)
        for variance, vector in zip(values, vectors.T, strict=True):
            sd = float(np.sqrt(max(variance, 0.0))) * factor
            if sd < 0.1:
                vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
                terms = [
                    f"{weight:+.2f} {'ln ' if d.multiplicative else ''}{name.rsplit('.', 1)[-1]}"
                    for weight, name, d in zip(vector, undetermined, domains, strict=True)
                ]
                points = [d.step_to(solution.values[name]) for name, d in zip(undetermined, domains, strict=True)]
                combinations[" ".join(terms)] = Estimate(float(vector @ points), sd, "-", True)
    return combinations


def warnings_about(
    solution: Solution, estimates: Mapping[str, Estimate], combinations: Mapping[str, Estimate]
) -> list[str]:
    """Warnings for the user: missing standard errors, undetermined parameters, bounds, convergence, model error.

    A misfit above 1.1 (5 % above the noise) counts as model error.
    """
    messages = []
    if solution.rough:
        names = ", ".join(name.rsplit(".", 1)[-1] for name in solution.rough)
        messages.append(
            f"The simulations do not change smoothly with {names} where the fit ended: there are no standard errors. "
            f"Hold one of them, as with --set {names.split(', ')[0]}=VALUE, or check the measures of the vehicle and "
            "the units of the inputs: `snakejax check` compares them with the motion."
        )
    loose = [name.rsplit(".", 1)[-1] for name, e in estimates.items() if not e.determined and not e.at_bound]
    if loose and not solution.rough:
        text = f"These runs cannot determine {', '.join(loose)} one by one"
        if "BCD" in combinations and combinations["BCD"].determined:
            bcd = combinations["BCD"]
            text += f"; they do determine the cornering stiffness BCD = {bcd.value:.4g} +- {bcd.sd:.2g} N/rad"
        messages.append(text + ". Runs with slip beyond the peak of the tyre force would determine them better.")
    for name in solution.held:
        messages.append(f"{name} ended on the bound of its physical domain, {solution.values[name]:g}.")
    if not solution.converged:
        messages.append("The fit did not converge: its last steps still changed the result.")
    if solution.misfit > 1.1:
        messages.append(
            f"The error is {solution.misfit**0.5:.3g} times the noise: the model lacks something. "
            "`snakejax compare` shows where it fails, `snakejax explain` what is missing."
        )
    return messages
