"""What is left of runs or windows, and what every candidate would change of it: score tests from one linear model."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ._least_squares import Linearised
from ._score import ALPHA, Reduced, Scored, reduced, score
from ._study import Study
from ._windows import LENGTH, linearised


class Tested(NamedTuple):
    """The score tests of candidates, best first; `chi2` and `dof` are those of what the starts and the fit leave."""

    scores: list[Scored]
    chi2: float
    dof: int


class Sight(NamedTuple):
    """Runs or windows of `study` at `values` and `start`: what is left, and what every candidate would change of it."""

    study: Study
    runs: tuple[int, ...]
    values: Mapping[str, float]
    start: np.ndarray
    found: Linearised

    def probed(self, probes: Mapping[str, float]) -> "Sight":
        """A parameter without a derivative at zero by its secant: what a value of `probes` changes, over that value."""
        jacobian = self.found.jacobian.copy()
        for name, probe in probes.items():
            there = linearised(self.study, {**self.values, name: probe}, self.start, self.runs, ())
            jacobian[..., self.study.names.index(name)] = (there.residual - self.found.residual) / probe
        return self._replace(found=self.found._replace(jacobian=jacobian))

    def reduced(self) -> Reduced:
        """What is left when the starts have explained what they can."""
        free_start, times = np.asarray(self.study.batch.free_start), np.asarray(self.study.batch.times)
        return reduced(self.found, free_start, self.runs, times, LENGTH)


def tested(
    seen: Sight, fitted: Sequence[str], candidates: Mapping[str, Sequence[str]], probes: Mapping[str, float]
) -> Tested:
    """Score `candidates` beside the `fitted` parameters, those that were probed once more from the value found there.

    `probes` as in `Sight.probed`: a secant far from the value found has another shape than the effect has there.
    """
    model, names, values = seen.study.model, seen.study.names, seen.values
    rest = seen.reduced()
    scores = score(model, names, rest, fitted, candidates, values)
    chi2, dof = float((rest.residual**2).sum()), max(rest.residual.size - rest.lost - len(fitted), 1)
    nearer = {
        name: s.values[name]
        for s in scores
        for name in s.values
        if name in probes and values[name] == 0.0 and s.p_value < ALPHA and 0 < s.values[name] < 0.5 * probes[name]
    }
    if nearer:
        again = score(model, names, seen.probed(nearer).reduced(), fitted, candidates, values)
        better = {s.effect: s for s in again if nearer.keys() & s.values.keys()}
        scores = [max(s, better.get(s.effect, s), key=lambda one: one.reduction) for s in scores]
    return Tested(sorted(scores, key=lambda s: -s.reduction), chi2, dof)
