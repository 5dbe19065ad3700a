"""One step of an explanation as plain data: the model after it, how it fares, and the candidates beside it."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

from snakejax.core.tabular import Tabular, three_digits
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.model import Model
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.goodness_of_fit import RunScore, Score, largest_noise_misfit
from snakejax.estimation.uncertainty import Estimate

from .criteria import CRITERIA, SelectionCriteria

SWITCH_DESCRIPTION = "Each wheelset slips separately."


@dataclasses.dataclass(frozen=True, eq=False)
class CandidateScore:
    """One candidate effect, added to the model of a step: its test, and its refit if there was one.

    `p_value`: corrected for the number of candidates; `statistic`: that of the test. `predicted_misfit`: misfit by the
    linear model, of whole runs or of short windows; `misfit_without`: the same without the candidate. `windows_chi2`:
    chi^2 of the windows to which it was fitted, None where it was scored alone. `estimate`:
    expected values of its parameters by their short names; `refit_estimate`: those of the refit; `detectable`: the
    smallest values that these runs would show. `confusable_with`: the candidates that these runs cannot distinguish
    from it. `failed`: the refit ended with a larger misfit than the model without the effect, so it means nothing.
    `converged`: whether the refit converged, None without one. `of_measurement`: it is an error of the measurement, not
    of the vehicle.
    """

    effect: str
    description: str = ""
    p_value: float | None = None
    statistic: float | None = None
    predicted_misfit: float | None = None
    refit_misfit: float | None = None
    estimate: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    refit_estimate: dict[str, Estimate] | None = None
    detectable: dict[str, float] = dataclasses.field(default_factory=dict)
    confusable_with: tuple[str, ...] = ()
    failed: bool = False
    converged: bool | None = None
    of_measurement: bool = False
    misfit_without: float | None = None
    windows_chi2: float | None = None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SelectionStep(Tabular):
    """The model after one step of the selection, with its scores and its candidates.

    `change`: "base", or "added" or "dropped" with the `name` of the effect. `effects`: the effects in the model,
    including `lateral_skid` if the structure was changed. `fitted`: the model in all runs. `train`, `heldout` (None
    without held-out runs) and `runs`: its scores; held-out runs are used once for each step. `estimates`: by parameter
    name. `converged`: whether the fit converged, or no value would change by a standard error. `ranking`: the
    candidates, best first; `left_out`: those without a rank, with the reason: they do not apply, or these runs do not
    show them. `criteria`: those of every decision in this step.
    """

    change: str
    name: str
    effects: tuple[str, ...]
    fitted: FittedModel
    train: Score
    heldout: Score | None
    runs: tuple[RunScore, ...]
    estimates: dict[str, Estimate]
    converged: bool
    ranking: tuple[CandidateScore, ...] = ()
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)
    criteria: SelectionCriteria = CRITERIA

    @property
    def title(self) -> str:
        """`base`, `added ground_slope`, `dropped rotor_lag`."""
        return f"{self.change} {self.name}".strip()

    def headline(self) -> str:
        """The change, the error in multiples of the noise, and the best candidate beside it."""
        unseen = "" if self.heldout is None else f", {three_digits(self.heldout.times_noise)} held out"
        doubt = "" if self.converged else "; did not converge"
        best = f"; {self.ranking[0].effect} first of {len(self.ranking)} candidates" if self.ranking else ""
        return f"{self.title}; {three_digits(self.train.times_noise)} times the noise{unseen}{doubt}{best}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each candidate beside it, the best first."""
        rows = self.ranking
        return {
            "effect": [row.effect for row in rows],
            "p_value": [row.p_value for row in rows],
            "statistic": [row.statistic for row in rows],
            "predicted_misfit": [row.predicted_misfit for row in rows],
            "misfit_without": [row.misfit_without for row in rows],
            "refit_misfit": [row.refit_misfit for row in rows],
            "converged": [row.converged for row in rows],
            "expected": [", ".join(f"{name} = {e}" for name, e in row.estimate.items()) for row in rows],
            "confusable_with": [", ".join(row.confusable_with) for row in rows],
        }

    @property
    def model(self) -> Model:
        """The fitted model, with the effects of this step alone."""
        return self.fitted.model

    @property
    def predicted_of_runs(self) -> bool:
        """Whether `predicted_misfit` of its candidates is that of whole runs; else it is that of short windows."""
        return self.train.misfit < self.criteria.linear_misfit

    def estimates_of(self, effect: str) -> dict[str, Estimate]:
        """The estimates of the parameters of one of its effects, by their short names; none for `lateral_skid`."""
        start = f"effects.{effect}."
        return {n.removeprefix(start): e for n, e in self.estimates.items() if n.startswith(start)}

    def description_of(self, effect: str) -> str:
        """The description of one of its effects or candidates."""
        if effect == LATERAL_SLIP_SWITCH:
            return SWITCH_DESCRIPTION
        if effect in self.model.effects:
            return self.model.effects[effect].description
        return next((row.description for row in self.ranking if row.effect == effect), "")


def raises_heldout_error(before: SelectionStep, after: SelectionStep) -> bool:
    """Whether held-out runs are further off with the step `after` than with that `before`, and further than noise."""
    if before.heldout is None or after.heldout is None:
        return False
    return not after.heldout.misfit <= max(before.heldout.misfit, largest_noise_misfit(after.heldout.samples))


def indistinguishable(steps: Sequence[SelectionStep], effect: str) -> tuple[str, ...]:
    """The candidates that explain the runs nearly as well as `effect`, by the ranking beside which it was added.

    Those that are confusable with it, unless chi^2 differs by more than `distinct_chi2`: of whole runs where both were
    refitted, else of windows to which both were fitted. Effects of the last step are none: both act.
    """
    pairs = [*itertools.pairwise(steps)]
    before = next((b for b, after in reversed(pairs) if (after.change, after.name) == ("added", effect)), None)
    if before is None:
        return ()
    rows = {row.effect: row for row in before.ranking}

    def distinct(other: str) -> bool:
        own, others = rows[effect], rows[other]
        if own.refit_misfit is not None and others.refit_misfit is not None:
            difference = (others.refit_misfit - own.refit_misfit) * before.train.samples
        elif own.windows_chi2 is not None and others.windows_chi2 is not None:
            difference = others.windows_chi2 - own.windows_chi2
        else:
            return False
        return abs(difference) > before.criteria.distinct_chi2

    twins = rows[effect].confusable_with if effect in rows else ()
    return tuple(name for name in twins if name in rows and name not in steps[-1].effects and not distinct(name))
