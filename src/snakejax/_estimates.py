"""What a fit says of its parameters: values, standard errors, and what the runs cannot determine."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ._least_squares import domains_of
from ._study import Optimum, Study

LOOSE = 0.5
"""A parameter is undetermined where its relative standard error (for E: the standard error) is larger than this."""


class Estimate(NamedTuple):
    """A fitted number: `sd` is one standard error, None where the data or a bound of the domain leave it open."""

    value: float
    sd: float | None
    unit: str
    determined: bool
    at_bound: bool = False

    def interval(self, quantile: float = 1.959964) -> tuple[float, float] | None:
        """The 95% interval."""
        return None if self.sd is None else (self.value - quantile * self.sd, self.value + quantile * self.sd)


def spread(optimum: Optimum) -> float:
    """The factor on standard errors where the misfit is larger than noise: sqrt(chi^2 / degrees of freedom), >= 1."""
    unknown = len(optimum.loose) + optimum.start.size
    return float(np.sqrt(max(1.0, optimum.misfit * optimum.samples / max(optimum.samples - unknown, 1))))


def estimated(study: Study, optimum: Optimum) -> dict[str, Estimate]:
    """Value, standard error and whether it is determined, for each free parameter."""
    factor = spread(optimum)
    variances = dict(zip(optimum.loose, np.diag(optimum.covariance), strict=True))
    found = {}
    for name, domain in zip(optimum.free, domains_of(study.model, optimum.free), strict=True):
        value = optimum.values[name]
        if name in optimum.held:
            found[name] = Estimate(value, None, domain.unit, False, True)
            continue
        step = float(np.sqrt(variances[name])) * factor
        natural = step * abs(value) if domain.multiplicative else step
        shaped = domain.multiplicative or domain.typical is not None
        determined = bool(np.isfinite(step)) and not (shaped and step > LOOSE)
        found[name] = Estimate(value, natural if np.isfinite(natural) else None, domain.unit, determined)
    return found


def combined(study: Study, optimum: Optimum, estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """BCD, the cornering stiffness [N/rad], and the sums of steps that the runs determine where single ones are not."""
    factor, loose = spread(optimum), list(optimum.loose)
    found = {}
    pacejka = ["tyre.B", "tyre.C", "tyre.D"]
    if all(name in optimum.values for name in pacejka) and any(name in loose for name in pacejka):
        weights = np.array([1.0 if name in pacejka else 0.0 for name in loose])
        relative = float(np.sqrt(weights @ optimum.covariance @ weights)) * factor
        value = float(np.prod([optimum.values[name] for name in pacejka]))
        found["BCD"] = Estimate(value, relative * value, "N/rad", relative < LOOSE)
    open_ = [name for name in loose if not estimates[name].determined]
    if len(open_) > 1:
        rows = [loose.index(name) for name in open_]
        values, vectors = np.linalg.eigh(optimum.covariance[np.ix_(rows, rows)])
        domains = domains_of(study.model, open_)
        for variance, vector in zip(values, vectors.T, strict=True):
            sd = float(np.sqrt(max(variance, 0.0))) * factor
            if sd < 0.1:
                vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
                terms = [
                    f"{weight:+.2f} {'ln ' if d.multiplicative else ''}{name.rsplit('.', 1)[-1]}"
                    for weight, name, d in zip(vector, open_, domains, strict=True)
                ]
                points = [d.step_to(optimum.values[name]) for name, d in zip(open_, domains, strict=True)]
                found[" ".join(terms)] = Estimate(float(vector @ points), sd, "-", True)
    return found


def advice(optimum: Optimum, estimates: Mapping[str, Estimate], combinations: Mapping[str, Estimate]) -> list[str]:
    """What the user should know before believing the numbers."""
    said = []
    loose = [name.rsplit(".", 1)[-1] for name, e in estimates.items() if not e.determined and not e.at_bound]
    if loose:
        text = f"These runs cannot determine {', '.join(loose)} one by one"
        if "BCD" in combinations and combinations["BCD"].determined:
            bcd = combinations["BCD"]
            text += f"; they do determine the cornering stiffness BCD = {bcd.value:.4g} +- {bcd.sd:.2g} N/rad"
        said.append(text + ". Runs that slip past the peak of the tyre force would tell more.")
    for name in optimum.held:
        said.append(f"{name} ended on the bound of its physical domain, {optimum.values[name]:g}.")
    if not optimum.converged:
        said.append("The fit did not converge: its last steps still changed the result.")
    if optimum.misfit > 1.1:
        said.append(
            f"The misfit is {optimum.misfit:.3g} times noise: the model lacks something. "
            "`snakejax compare` shows where it fails, `snakejax explain` what is missing."
        )
    return said
