"""What the loop found, as plain data."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.tabular import Tabular, listed, three_digits
from snakejax.dynamics.law import Law
from snakejax.estimation.goodness_of_fit import BAND, score_columns
from snakejax.estimation.uncertainty import Estimate
from snakejax.recording.run import Case, Noise, Run

from .latent_force.missing_force import LatentForce
from .odd_runs import OddRun
from .selection.steps import SelectionStep


class TriedCandidate(NamedTuple):
    """One candidate beside the model of one step: whether it was `taken`, and `why` or why not.

    `share`: of the squared error on runs left out that it takes away; `misfit`: of its refit on whole train runs;
    `instead_of`: the effects in whose place it would do nearly as well.
    """

    step: int
    effect: str
    share: float | None
    p_value: float | None
    misfit: float | None
    taken: bool
    why: str
    instead_of: tuple[str, ...] = ()


class PoseError(NamedTuple):
    """A root mean square error in `position_m` and `heading_rad`; `source`: whence it is known."""

    position_m: float
    heading_rad: float
    source: str


class RunBand(NamedTuple):
    """How well the bands of 95% of a prediction from the start of a run hold what was measured.

    `inside`: the share of its x, y and heading within 1.96 standard deviations of the prediction. At the `times` (n,)
    [s]: the `residual` (n, 3), measured less predicted [m, m, rad], NaN where nothing was measured, and its standard
    deviation `sd` (n, 3), which counts parameters, random force and cameras.
    """

    run: str
    role: str
    inside: float
    times: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "n 3"]


def run_bands(runs: Sequence[Run], residuals: Sequence[np.ndarray], sds: Sequence[np.ndarray]) -> tuple[RunBand, ...]:
    """The band of each of the `runs` in which anything was measured; rows after the end of a run are left out."""
    bands = []
    for run, residual, sd in zip(runs, residuals, sds, strict=True):
        times = np.asarray(run.times)
        residual, sd = residual[: len(times)], sd[: len(times)]
        measured = np.isfinite(residual)
        if measured.any():
            inside = float((np.abs(residual[measured]) <= BAND * sd[measured]).mean())
            bands.append(RunBand(run.name, run.role, inside, times, residual, sd))
    return tuple(bands)


def vehicle_constants(final: SelectionStep) -> dict[str, Estimate]:
    """The constants of the vehicle among the estimates of a step, by their name in its table of `case.toml`."""
    return {
        name.removeprefix("board."): estimate for name, estimate in final.estimates.items() if name.startswith("board.")
    }


class Remainder(NamedTuple):
    """The root mean square error above the floor that the final model leaves, and the shares of variables in it.

    `laws`: formulas of forces that would explain a part of it, among which these runs cannot choose.
    """

    position_m: float
    heading_rad: float
    depends_on: tuple[tuple[str, float], ...] = ()
    laws: tuple[str, ...] = ()

    @staticmethod
    def above(floor: PoseError, position_m: float, heading_rad: float) -> "Remainder":
        """What errors have above the `floor`, in squares."""
        position = max(position_m**2 - floor.position_m**2, 0.0)
        heading = max(heading_rad**2 - floor.heading_rad**2, 0.0)
        return Remainder(float(np.sqrt(position)), float(np.sqrt(heading)))


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Explanation(Tabular):
    """The result of `explain`: `steps[0]` is the base model, the last step the final model.

    `verdict`: "adequate", "explained" or "unexplained". `effects`: the effects that explain the recordings; with the
    verdict "unexplained", those that stay significant together with the missing force. `partial`: effects that lower
    the error without explaining it. `left_out`: candidates that do not apply, with the reason. `missing`: the force
    that the base lacks, if nothing explains it; None if there is only one train run.

    `confidence` of each effect: "sure", "likely", "stand_in" or "ambiguous". `share`: the share of the squared error of
    omitted runs that each effect removes; `explained_share`: that of all effects together. `floor`: the error that the
    vehicle and the cameras cause by themselves; `remainder`: the error above it. `candidates`: those of every step.
    `constants`: the constants of the vehicle, estimated within their uncertainty; `constants_share`: the share that
    they remove without any effect. `bands`: the predictive check of each run. `odd_runs`: train runs that differ from
    the others. `law`: the force in which a law among the effects was found, None without one. `calibrated`: if nothing
    was added, the base model with the estimated constants of the vehicle. `of_windows`: whether the runs are many short
    windows, and effects were judged by left-out recordings.
    """

    case: Case
    noise: Noise
    steps: tuple[SelectionStep, ...]
    verdict: str
    effects: tuple[str, ...]
    partial: tuple[str, ...]
    left_out: dict[str, str]
    missing: LatentForce | None
    confidence: dict[str, str] = dataclasses.field(default_factory=dict)
    share: dict[str, float] = dataclasses.field(default_factory=dict)
    explained_share: float | None = None
    floor: PoseError | None = None
    remainder: Remainder | None = None
    candidates: tuple[TriedCandidate, ...] = ()
    constants: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    constants_share: float = 0.0
    bands: tuple[RunBand, ...] = ()
    odd_runs: tuple[OddRun, ...] = ()
    law: LatentForce | None = None
    calibrated: SelectionStep | None = None
    of_windows: bool = False

    @property
    def base(self) -> SelectionStep:
        """The fit before anything was added."""
        return self.steps[0]

    @property
    def final(self) -> SelectionStep:
        """The fit with all that was added, and with the constants of the vehicle as they were estimated."""
        return self.steps[-1] if self.calibrated is None else self.calibrated

    @property
    def named_laws(self) -> dict[str, Law]:
        """The laws in the final model, by name."""
        return {name: effect for name, effect in self.final.model.effects.items() if isinstance(effect, Law)}

    def headline(self) -> str:
        """The verdict, the error before and after in multiples of the noise, and the runs."""
        verdict = self.verdict + (f" by {listed(self.effects)}" if self.effects and self.verdict == "explained" else "")
        beside = f" but for {listed(self.effects)}" if self.effects and self.verdict == "unexplained" else ""
        helped = f"; {listed(self.partial)} helped" if self.partial else ""
        ends = [self.base] if self.final is self.base else [self.base, self.final]
        error = " -> ".join(three_digits(step.train.times_noise) for step in ends)
        return f"{verdict}{beside}; {error} times the noise{helped}; {self.base.fitted.runs_text}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each step, with its errors on train and on held-out runs."""
        return {
            "step": [step.title for step in self.steps],
            **score_columns([step.train for step in self.steps], [step.heldout for step in self.steps]),
            "converged": [step.converged for step in self.steps],
        }
