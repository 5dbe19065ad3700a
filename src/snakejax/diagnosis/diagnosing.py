"""Diagnosis: which effect is missing?"""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np

from snakejax.core.parallel import ContextThreads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.core.tabular import Tabular
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initial_model import starting_model
from snakejax.recording.run import Case, Noise

from .selection.candidates import BaseFit, CandidateFit, CandidateSet, structures
from .selection.criteria import SelectionCriteria
from .selection.ranking import RankedCandidate, insert_by_refit, rank
from .selection.refit import base_fit
from .selection.steps import SelectionStep
from .selection.working_step import WorkingStep, selection_step


class DiagnosisOptions(TypedDict, total=False):
    """What `diagnose` and `explain` can be given beyond the recordings and the candidates.

    `kind`: the tyre law of the base, "pacejka" (default) or "rayleigh"; `constraint`: its structure (default: the
    case's); `start`: the base before it is fitted, in place of both; `held`: names of parameters of tyre or effects
    that are not estimated; `with_`: effects in the base from the start; `switch`: whether the change of structure from
    coupled to free is a candidate (default True); `threshold`: that of Huber's loss in the fits of whole runs [standard
    deviations] (default: none); `criteria`: the thresholds of every decision (default: `CRITERIA` and `[search]` of
    the case); `progress` is called with each `ProgressEvent`.
    """

    kind: str
    constraint: str | None
    start: Model
    held: Collection[str]
    with_: Sequence[str]
    switch: bool
    threshold: float
    criteria: SelectionCriteria
    progress: Progress


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Tabular):
    """What is missing: the fit of the `base` model to the runs of `case`, with its candidates ranked."""

    case: Case
    noise: Noise
    base: SelectionStep

    def headline(self) -> str:
        """The error of the base and the best candidate beside it."""
        return f"{self.base.headline()}; {self.base.fitted.runs_text}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each candidate, the best first."""
        return self.base.columns()


class BaseDiagnosis(NamedTuple):
    """The workspace of a diagnosis: the base, and the other skid structure beside it where there is one."""

    base: WorkingStep
    switched: tuple[CandidateSet, CandidateFit] | None


def diagnose(
    case: Case, noise: Noise, library: Mapping[str, Effect], **question: Unpack[DiagnosisOptions]
) -> Diagnosis:
    """Rank the effects of `library` by how much of the error of the base model in the train runs each would explain.

    Nothing is added: all candidates are scored at the base fit, the best few refitted beside it.

    **Arguments:** `question`, see `DiagnosisOptions`. **Raises:** `FitError` where the base cannot be fitted.
    """
    return Diagnosis(case, noise, diagnose_base(case, noise, library, **question).base.record)


def start_of(case: Case, question: DiagnosisOptions) -> Model:
    """The base before it is fitted."""
    if "start" in question:
        return question["start"]
    return starting_model(case, question.get("kind", "pacejka"), question.get("constraint"))


def diagnose_base(
    case: Case,
    noise: Noise,
    library: Mapping[str, Effect],
    meanwhile: Callable[[CandidateSet], None] = lambda _: None,
    **question: Unpack[DiagnosisOptions],
) -> BaseDiagnosis:
    """`diagnose`, with the workspace in which an explanation goes on.

    The other structure is fitted on another core. Where there is none, `meanwhile` is called there with the candidates,
    to make what follows quicker; an error of it is met where it matters.
    """
    criteria = question.get("criteria") or SelectionCriteria.of(case)
    with_, progress = question.get("with_", ()), question.get("progress", no_progress)
    options = structures(case, "", None, start_of(case, question))[: 2 if question.get("switch", True) else 1]
    how = BaseFit(frozenset(question.get("held", ())), question.get("threshold", np.inf))

    def candidates(model: Model, switched: bool) -> CandidateSet:
        return CandidateSet.of(model, case, noise, library, switched=switched, criteria=criteria, how=how)

    def fitted(model: Model) -> tuple[CandidateSet, CandidateFit]:
        switched = candidates(model, True)
        return switched, base_fit(switched, with_, no_progress)

    candidate_set = candidates(options[0], False)
    with ContextThreads(1) as beside:
        other = [beside.submit(fitted, model) for model in options[1:]]
        if not other:
            beside.submit(meanwhile, candidate_set)
        step = base_fit(candidate_set, with_, progress)

        def explained() -> bool:
            return any(consistent_with_noise(fit.result()[1].solution) for fit in other)

        ranking = tuple(rank(candidate_set, step, explained=explained, progress=progress))
        if other:
            progress(ProgressEvent(Phase.REFITTING_OTHER_STRUCTURE, f"refitting with {LATERAL_SLIP_SWITCH}"))
        switched = other[0].result() if other else None
    if switched is not None:
        solution = switched[1].solution
        ranking = insert_by_refit(ranking, RankedCandidate(LATERAL_SLIP_SWITCH, None, None, solution, (), None))
    return BaseDiagnosis(selection_step(candidate_set, "base", "", step, ranking), switched)
