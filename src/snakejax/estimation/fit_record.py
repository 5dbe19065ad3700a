"""The result of a fit, as plain data."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from snakejax.core.tabular import Tabular, three_digits
from snakejax.dynamics.model import Model
from snakejax.recording.run import Run

from .fitted_model import FittedModel
from .goodness_of_fit import RunScore, Score, pooled_score
from .uncertainty import Estimate


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Fit(Tabular):
    """A fitted model with its statistics.

    `fitted`: the model in all runs, those held out with only their start states estimated. `estimates` by parameter
    name, for every parameter that was free; `correlation` (k, k) of the interior parameters; `combinations`: products
    of parameters that the runs determine although they do not determine the factors. `runs`: scores of the train runs;
    `heldout`: scores of the held-out runs. `converged`: whether the last steps changed nothing. `advice`: warnings in
    words. `rough`: parameters whose derivative was not that of the simulation, None if that was not checked.
    """

    fitted: FittedModel
    estimates: dict[str, Estimate]
    correlation: Float[np.ndarray, "k k"]
    combinations: dict[str, Estimate]
    runs: tuple[RunScore, ...]
    heldout: tuple[RunScore, ...]
    converged: bool
    advice: tuple[str, ...] = ()
    rough: tuple[str, ...] | None = None

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.fitted.model

    @property
    def recordings(self) -> tuple[Run, ...]:
        """The recorded runs, with the clocks of their joint logs as they were estimated."""
        return self.fitted.recordings

    @property
    def train_score(self) -> Score:
        """All train runs together."""
        return pooled_score(self.runs)

    @property
    def heldout_score(self) -> Score | None:
        """All held-out runs together, or None where there are none."""
        return pooled_score(self.heldout) if self.heldout else None

    @property
    def misfit(self) -> float:
        """The mean squared residual of all train runs in variances of the noise; 1 is noise."""
        return self.train_score.misfit

    def headline(self) -> str:
        """The model, its error in multiples of the noise, and the estimates."""
        held = self.heldout_score
        unseen = "" if held is None else f", {three_digits(held.times_noise)} held out"
        doubt = "" if self.converged else "; did not converge"
        error = f"{three_digits(self.train_score.times_noise)} times the noise{unseen}"
        first = f"{self.fitted.name}; {error}; {self.fitted.runs_text}{doubt}"
        values = ", ".join(f"{name.rsplit('.', 1)[-1]} = {estimate}" for name, estimate in self.estimates.items())
        return f"{first}\n{values}" if values else first

    def columns(self) -> dict[str, list[Any]]:
        """A row for each estimate, with its 95 % interval."""
        ends = [estimate.interval() or (None, None) for estimate in self.estimates.values()]
        rows = list(self.estimates.values())
        return {
            "parameter": list(self.estimates),
            "value": [row.value for row in rows],
            "sd": [row.sd for row in rows],
            "unit": [row.unit for row in rows],
            "low_95": [low for low, _ in ends],
            "high_95": [high for _, high in ends],
            "determined": [row.determined for row in rows],
            "at_bound": [row.at_bound for row in rows],
        }
