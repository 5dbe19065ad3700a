"""Comparison: where, when and with what a fitted model fails. Everything here is counted, nothing is refitted.

The residual e of a sample is measured minus modelled, over the standard deviation of the noise: white and of variance 1
where the model lacks nothing.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.tabular import Tabular
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.fitting import fit
from snakejax.estimation.goodness_of_fit import Score
from snakejax.estimation.initial_model import starting_model
from snakejax.recording.quality import noise_of
from snakejax.recording.run import Case, Noise

from .dependence import LEVEL, VarianceShare, residual_dependence, significant_shares
from .intervals import IntervalMisfit, LargestResidual, interval_misfits, largest_residuals
from .replays import replay_fit
from .whiteness import Whiteness, whiteness


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Comparison(Tabular):
    """Where a model fails: `stretches`, `worst` and `whiteness` of all runs, `shares` of the train runs."""

    stretches: tuple[IntervalMisfit, ...]
    worst: tuple[LargestResidual, ...]
    whiteness: tuple[Whiteness, ...]
    shares: tuple[VarianceShare, ...]

    @property
    def white(self) -> bool:
        """No run and channel differs from white noise, at 5% for all of them together (Bonferroni)."""
        return all(test.p_value * len(self.whiteness) > LEVEL for test in self.whiteness)

    @property
    def depends_on(self) -> tuple[VarianceShare, ...]:
        """The shares that are not chance, at 5% for all of them together, the largest first."""
        return significant_shares(self.shares)

    def headline(self) -> str:
        """Whether only noise is left, on what the residual depends, and where it is largest."""
        noise = "only noise is left" if self.white else "more than noise is left"
        depends = "".join(f"; {s.channel} depends on {s.variable} ({s.share:.0%})" for s in self.depends_on[:2])
        worst = "".join(f"; worst in {m.run} at {m.time:.2f} s ({m.deviations:.1f} sd)" for m in self.worst[:1])
        return noise + depends + worst

    def columns(self) -> dict[str, list[Any]]:
        """A row for each stretch of each run and channel."""
        return {
            "run": [stretch.run for stretch in self.stretches],
            "channel": [stretch.channel for stretch in self.stretches],
            "begin_s": [stretch.begin for stretch in self.stretches],
            "end_s": [stretch.end for stretch in self.stretches],
            "misfit": [stretch.misfit for stretch in self.stretches],
        }


class ModelScore(NamedTuple):
    """One model in a table of several: its scores and whether its fit `converged`, or in `failure` why it has none."""

    model: str
    train: Score | None
    heldout: Score | None
    failure: str | None = None
    converged: bool | None = None


def compare(fitted: Fit, *, length: float = 1.0, count: int = 8) -> Comparison:
    """Where `fitted` fails: the misfit of each interval of `length` [s], and the `count` largest residuals."""
    tracks = [scene.track for scene in replay_fit(fitted)]
    return Comparison(
        tuple(stretch for track in tracks for stretch in interval_misfits(track, length)),
        largest_residuals(tracks, count, length),
        tuple(test for track in tracks for test in whiteness(track)),
        residual_dependence([track for track in tracks if track.role == "train"]),
    )


def compare_models(
    case: Case,
    kinds: Sequence[str] = ("ideal", "rayleigh", "pacejka"),
    noise: Noise | None = None,
    *,
    structure: str | None = None,
    threshold: float = np.inf,
) -> tuple[ModelScore, ...]:
    """Each kind of model fitted to the same runs, with misfit and rms error on train and held-out runs.

    `noise`: as given, else the case's own, else as the recordings show it; `structure`: that of the case unless given
    ("ideal" has its own); `threshold`: that of Huber's loss [standard deviations].
    **Raises:** `InputError` for an unknown kind; a fit that fails is a row that says why.
    """
    noise = noise or noise_of(case)

    def side(kind: str) -> ModelScore:
        try:
            fitted = fit(starting_model(case, kind, structure), case.runs, noise, threshold=threshold)
        except FitError as error:
            return ModelScore(kind, None, None, str(error))
        return ModelScore(kind, fitted.train_score, fitted.heldout_score, None, fitted.converged)

    return tuple(side(kind) for kind in kinds)
