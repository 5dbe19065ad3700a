"""Residuals of runs or windows under a model, with their sensitivity to every parameter."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from .block_linearisation import linearise_runs
from .linearisation import Linearised
from .problem import Problem

DETECTABLE_SD = float(stats.norm.isf(0.01 / 50) + stats.norm.ppf(0.8))
"""Minimum detectable value in standard errors: power 0.8 of a two-sided test at level 0.01 with Bonferroni's correction
for 25 effects, z(1 - 0.01 / 50) + z(0.8).
"""
NEARER = 0.1
"""Fraction of its secant step at which a parameter without a derivative at zero is scored a second time."""


class Sensitivities(NamedTuple):
    """Residuals and Jacobian (`linearised`) of the runs or windows `runs` (indices), at `values` and `start` (R, S)."""

    problem: Problem
    runs: tuple[int, ...]
    values: Mapping[str, float]
    start: np.ndarray
    linearised: Linearised

    def probed(self, probes: Mapping[str, float]) -> "Sensitivities":
        """Columns of parameters without a derivative at zero by the secant (r(p) - r(0)) / p, with p from `probes`."""
        jacobian = self.linearised.jacobian.copy()
        for name, secant_step in probes.items():
            probe = linearise_runs(self.problem, {**self.values, name: secant_step}, self.start, self.runs, ())
            jacobian[..., self.problem.names.index(name)] = (probe.residual - self.linearised.residual) / secant_step
        return self._replace(linearised=self.linearised._replace(jacobian=jacobian))
