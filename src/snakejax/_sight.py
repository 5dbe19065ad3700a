"""What is left of runs or windows, and what every candidate would change of it: score tests from one linear model."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ._least_squares import Linearised
from ._score import ALPHA, Reduced, Scored, reduced, score
from ._study import Study
from ._windows import LENGTH, linearised

NEARER = 0.1
"""The share of its probe from which a parameter without a slope at zero is scored as well."""


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
    """Score `candidates` beside the `fitted` parameters.

    A parameter without a derivative at zero is scored by secants, from its value in `probes`, from a `NEARER` one, and
    from the value found with the better of these: far from that value a secant has another shape than the effect.
    """
    model, names = seen.study.model, seen.study.names
    probes = {name: probe for name, probe in probes.items() if seen.values[name] == 0.0}

    def scores(rest: Reduced) -> dict[str, Scored]:
        return {s.effect: s for s in score(model, names, rest, fitted, candidates, seen.values)}

    rest = (seen.probed(probes) if probes else seen).reduced()
    best = scores(rest)
    if probes:
        nearer = {name: probe * NEARER for name, probe in probes.items()}
        best = _better(best, scores(seen.probed(nearer).reduced()), probes)
        found = {n: s.values[n] for s in best.values() if s.p_value < ALPHA for n in probes.keys() & s.values.keys()}
        found = {name: value for name, value in found.items() if value > 0}
        best = _better(best, scores(seen.probed(found).reduced()), found) if found else best
    dof = max(rest.residual.size - rest.lost - len(fitted), 1)
    return Tested(sorted(best.values(), key=lambda s: -s.reduction), float((rest.residual**2).sum()), dof)


def _better(old: dict[str, Scored], new: dict[str, Scored], probed: Mapping[str, float]) -> dict[str, Scored]:
    """`old`, and where one of the `probed` parameters explains more in `new`, that."""
    return {
        effect: max(s, new.get(effect, s), key=lambda one: one.reduction) if probed.keys() & s.values.keys() else s
        for effect, s in (new | old).items()
    }
