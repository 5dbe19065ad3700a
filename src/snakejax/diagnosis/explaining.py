"""The loop: fit, compare, diagnose, add, refit, until only noise is left or nothing known explains the rest."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Unpack

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Progress, no_progress
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Effect
from snakejax.estimation.fit_workspace import fit_workspace
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.joint_logs.clocks import STILL, free_clocks
from snakejax.estimation.joint_logs.fitting import (
    with_aligned_logs,
    with_clock_errors,
    with_estimated_logs,
    with_log_noise,
)
from snakejax.estimation.joint_logs.log_noise import is_noisy
from snakejax.estimation.problem import Solution
from snakejax.recording.run import Case, Noise

from .all_effects_at_once import choose_effects_at_once, explain_inexact
from .diagnosing import BaseDiagnosis, DiagnosisOptions, diagnose_base, start_of
from .effect_or_odd_run import AgainstOddRuns, against_odd_runs
from .exact_checks import compile_later_programs, constants_explain
from .exact_explanation import exact_explanation, leaves_only_noise
from .explaining_by_law import by_exact_law_beside, conclude_with_law, latent_force_of, with_laws
from .explanation import Explanation
from .law.fitting import predicting_steps
from .selection.acceptance import accept_structure
from .selection.beam_search import CandidateSubset
from .selection.candidates import CandidateFit, CandidateSet
from .selection.ranking import rank, significant
from .selection.steps import SelectionStep
from .selection.stepwise import stepwise_selection
from .selection.working_step import WorkingStep, selection_step
from .windows import explaining as windows

Show = Callable[[SelectionStep], None]


def explain(
    case: Case,
    noise: Noise,
    library: Mapping[str, Effect],
    *,
    show: Show = no_progress,
    **question: Unpack[DiagnosisOptions],
) -> Explanation:
    """Find out which effects of `library` the recordings of `case` show beyond the base model.

    The free clocks of joint logs are found with them, and what noise in the logs does: from short windows and the base
    first, then as the final model has them, with which the recordings are explained once more, at most
    `log_clock_rounds` times.

    **Arguments:** `show` is given each step; `question`, see `DiagnosisOptions`.
    **Raises:** `FitError` where the base cannot be fitted.
    """
    progress = question.get("progress", no_progress)
    if windows.supports(case):
        explanation = windows.explain_windows(case, noise, library, **question)
        for step in explanation.steps:
            show(step)
        return explanation
    logged = any(free_clocks(run) or is_noisy(run.gait) for run in case.runs)
    if logged:
        case = with_estimated_logs(start_of(case, question), case, noise, progress)
    # Steps on clocks that are still to be improved are shown to nobody.
    show_now = no_progress if logged else show
    programs = functools.partial(compile_later_programs, effects=question.get("with_", ()), stated=case.constant_sd)
    diagnosis = diagnose_base(case, noise, library, programs, **question)
    show_now(diagnosis.base.record)
    # Clocks of short windows are too coarse to tell whether one effect leaves only noise.
    for _ in range(diagnosis.base.candidate_set.criteria.log_clock_rounds if logged else 0):
        improved = _with_logs_of(case, *_nearest(diagnosis), progress)
        if improved is None:
            break
        case = improved
        diagnosis = diagnose_base(case, noise, library, **question)
    explanation, working_steps, law_was_sought = _explanation_or_steps(case, noise, diagnosis, progress, show_now)
    if explanation is not None:
        for step in explanation.steps if logged else explanation.steps[1:]:
            show(step)
        return explanation
    for _ in range(diagnosis.base.candidate_set.criteria.log_clock_rounds if logged else 0):
        last = working_steps[-1]
        improved = _with_logs_of(case, last.candidate_set, last.step.solution, progress)
        if improved is None:
            break
        case = improved
        diagnosis, working_steps = _select(case, noise, library, question)
        law_was_sought = False
    for working_step in working_steps if logged else ():
        show(working_step.record)
    judged = against_odd_runs(working_steps, show)
    explanation = _conclude(case, noise, diagnosis, judged, law_was_sought, progress)
    return _with_clock_errors(explanation, judged.steps[-1], progress)


def _explanation_or_steps(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, progress: Progress, show: Show
) -> tuple[Explanation | None, list[WorkingStep], bool]:
    """The explanation where the model is not exact, or by a law; else None, all steps of a search on whole runs, and
    whether a law that leaves only noise was sought in vain.

    A law can follow the motion that two known effects cause. Where one is suspected and effects were chosen under
    another structure than that of the base, those under its own are therefore tried first.
    """
    base = diagnosis.base
    explains = _one_effect_explains(diagnosis, case)
    at_once = None if explains else choose_effects_at_once(case, noise, diagnosis, progress)
    if at_once is None or at_once.few is not None:
        few = None if at_once is None else at_once.few
        return None, [base, *_steps_beyond_base(diagnosis, few, progress, show)], False
    suspected = at_once.evidence.suggests_law
    try_known = suspected and diagnosis.switched is not None
    first = _under_first_structure(diagnosis, None, progress, no_progress) if try_known else None
    steps = first if first and leaves_only_noise(first[-1]) else None
    law_was_sought = suspected and steps is None
    if steps is None:
        explanation = explain_inexact(case, noise, diagnosis, at_once, progress)
        if explanation is not None:
            return explanation, [], False
        steps = _steps_beyond_base(diagnosis, None, progress, no_progress, first)
    for step in steps:
        show(step.record)
    return None, [base, *steps], law_was_sought


def _select(
    case: Case, noise: Noise, library: Mapping[str, Effect], question: DiagnosisOptions
) -> tuple[BaseDiagnosis, list[WorkingStep]]:
    """The diagnosis, and all steps from the base on, with the joint logs on the clocks they have; nothing is shown."""
    diagnosis = diagnose_base(case, noise, library, **question)
    steps = _steps_beyond_base(diagnosis, None, question.get("progress", no_progress), no_progress)
    return diagnosis, [diagnosis.base, *steps]


def _one_effect_explains(diagnosis: BaseDiagnosis, case: Case) -> bool:
    """Whether the base, or the base and one effect, leaves only noise: such a model is exact.

    An effect counts that is the same as a constant (`equivalent_constant`). Any other does not where constants within
    their uncertainty explain as well as it.
    """
    base = diagnosis.base
    if consistent_with_noise(base.step.solution) and not significant(base.ranking, base.candidate_set.criteria):
        return True
    if diagnosis.switched is not None and consistent_with_noise(diagnosis.switched[1].solution):
        return True
    refitted = [row for row in base.ranking if row.refit is not None and not row.failed]
    explaining = [row.effect for row in refitted if row.refit is not None and consistent_with_noise(row.refit)]
    known = base.candidate_set.problem.model.effects
    if not explaining or any(known[effect].equivalent_constant for effect in explaining):
        return bool(explaining)
    return not constants_explain(base.candidate_set, base.step, case.constant_sd)


def _with_one_effect(diagnosis: BaseDiagnosis) -> list[tuple[CandidateSet, Solution]]:
    """The models of the base and one effect, each with the candidates that it is one of."""
    base = diagnosis.base
    switched = [] if diagnosis.switched is None else [(diagnosis.switched[0], diagnosis.switched[1].solution)]
    refits = [row.refit for row in base.ranking if row.refit is not None and not row.failed]
    return [*((base.candidate_set, fit) for fit in refits), *switched]


def _nearest(diagnosis: BaseDiagnosis) -> tuple[CandidateSet, Solution]:
    """Of the base and the models of it and one effect, the one that leaves least."""
    base = (diagnosis.base.candidate_set, diagnosis.base.step.solution)
    return min((base, *_with_one_effect(diagnosis)), key=lambda one: one[1].misfit)


def _with_logs_of(case: Case, candidate_set: CandidateSet, solution: Solution, progress: Progress) -> Case | None:
    """`case` with the clocks of joint logs, and what their noise does, as a model has them at its `solution`; None
    where it is too far off to tell, or nothing changes.
    """
    free = any(free_clocks(run) for run in case.runs)
    noisy = any(is_noisy(run.gait) and run.wander is None for run in case.runs)
    if not (free or noisy) or not solution.misfit < candidate_set.criteria.far_misfit:
        return None
    fit = fit_workspace(candidate_set.problem, solution)
    if free:
        try:
            fit = with_aligned_logs(fit, fit.problem.threshold, progress)
        except FitError:
            return None
    runs = fit.problem.runs
    clocks_stay = all(
        abs(getattr(new.log, name) - getattr(old.log, name)) < STILL * getattr(new.log, f"{name}_sd")
        for new, old in zip(runs, case.runs, strict=True)
        for name in free_clocks(new)
    )
    with_noise = with_log_noise(fit, progress) if noisy else None
    if clocks_stay and with_noise is None:
        return None
    return dataclasses.replace(case, runs=runs if with_noise is None else with_noise)


def _with_clock_errors(explanation: Explanation, last: WorkingStep, progress: Progress) -> Explanation:
    """`explanation`, where its `last` step is near the noise with the errors that clocks of joint logs bring to it."""
    case = explanation.case
    near = last.step.solution.misfit < last.candidate_set.criteria.linear_misfit
    if not near or all(run.log is None for run in case.runs):
        return explanation
    fit = fit_workspace(last.candidate_set.problem, last.step.solution)
    wider = with_clock_errors(fit, progress)
    if wider is fit:
        return explanation
    final = dataclasses.replace(explanation.final, estimates=wider.result().estimates)
    case = dataclasses.replace(case, runs=wider.problem.runs)
    return dataclasses.replace(explanation, steps=(*explanation.steps[:-1], final), case=case)


def _steps_beyond_base(
    diagnosis: BaseDiagnosis,
    few: CandidateSubset | None,
    progress: Progress,
    show: Show,
    first: Sequence[WorkingStep] | None = None,
) -> list[WorkingStep]:
    """The steps after the base, under the structure with which the recordings are explained better.

    `few`: effects that may explain them, under the other structure where there is one. `first`: the steps of
    `_under_first_structure`, if they are known.
    """
    base = diagnosis.base
    if consistent_with_noise(base.step.solution) and not significant(base.ranking, base.candidate_set.criteria):
        return []
    both = diagnosis.switched is not None and not _is_relaxed_first(diagnosis)
    steps = _under_first_structure(diagnosis, few, progress, no_progress if both else show) if first is None else first
    if diagnosis.switched is None or not both:
        return list(steps)
    if not (steps and consistent_with_noise(steps[-1].step.solution)):
        # This structure does not explain by itself: select under the other one too, and keep what gets further.
        others = _relaxed_steps(*diagnosis.switched, few, progress, no_progress)
        reached = (steps[-1].step if steps else base.step).solution.misfit
        steps = others if others[-1].step.solution.misfit < reached else steps
    for one in steps:
        show(one.record)
    return list(steps)


def _is_relaxed_first(diagnosis: BaseDiagnosis) -> bool:
    """Whether the change of structure explains the recordings better than any one effect under that of the base."""
    if diagnosis.switched is None:
        return False
    base, relaxed = diagnosis.base, diagnosis.switched[1]
    best_refit = min((r.refit_misfit for r in base.ranking if r.refit is not None), default=np.inf)
    criteria = base.candidate_set.criteria
    return relaxed.solution.misfit <= best_refit and accept_structure(base.step, relaxed, criteria)


def _under_first_structure(
    diagnosis: BaseDiagnosis, few: CandidateSubset | None, progress: Progress, show: Show
) -> list[WorkingStep]:
    """The steps after the base under its structure, or under the other one, see `_is_relaxed_first`."""
    base, switched = diagnosis.base, diagnosis.switched
    if switched is not None and _is_relaxed_first(diagnosis):
        return _relaxed_steps(*switched, few, progress, show)
    own = few if switched is None else None
    return stepwise_selection(base.candidate_set, base.step, base.ranking, [], progress, show, own)


def _relaxed_steps(
    candidate_set: CandidateSet, step: CandidateFit, few: CandidateSubset | None, progress: Progress, show: Show
) -> list[WorkingStep]:
    """The change of structure, to the fit `step` under it, and the steps after it; `few`, see `_steps_beyond_base`."""
    ranking = rank(candidate_set, step, progress=progress)
    first = selection_step(candidate_set, "added", LATERAL_SLIP_SWITCH, step, ranking)
    show(first.record)
    return stepwise_selection(candidate_set, step, first.ranking, [first], progress, show, few)


def _conclude(
    case: Case,
    noise: Noise,
    diagnosis: BaseDiagnosis,
    judged: AgainstOddRuns,
    law_was_sought: bool,
    progress: Progress,
) -> Explanation:
    """The verdict on the last of the `judged` steps, and what is missing where it leaves more than noise.

    `law_was_sought`: no law explains beside the known effects that lower the misfit most.
    """
    working_steps: Sequence[WorkingStep] = judged.steps
    last, steps = working_steps[-1], tuple(step.record for step in working_steps)
    final, left_out = steps[-1], steps[0].left_out
    if leaves_only_noise(last):
        return exact_explanation(case, noise, last, steps, instead=judged.instead)
    missing = None
    if len(last.candidate_set.train) > 1:
        missing = latent_force_of(diagnosis, last, progress)
        steps_with_laws, force = with_laws(case, noise, diagnosis, last, missing, progress)
        by_laws = conclude_with_law(case, noise, diagnosis, steps_with_laws, force) if steps_with_laws else None
        is_exact = bool(steps_with_laws) and consistent_with_noise(steps_with_laws[-1].step.solution)
        if not (law_was_sought or is_exact):
            by_laws = by_exact_law_beside(case, noise, diagnosis, progress) or by_laws
        if by_laws is not None:
            return by_laws
        working_steps = predicting_steps(working_steps, progress)
        last, steps = working_steps[-1], tuple(step.record for step in working_steps)
        final = steps[-1]
    coexisting = () if missing is None else missing.beside
    partial = tuple(name for name in final.effects if name not in coexisting)
    # A fit without the force gives the effects that act beside it values that are wrong by what the force does.
    known = {} if missing is None else missing.estimates
    estimates = final.estimates | {name: e for name, e in known.items() if name.split(".")[1] in coexisting}
    steps = (*steps[:-1], dataclasses.replace(final, estimates=estimates))
    return Explanation(case, noise, steps, "unexplained", coexisting, partial, left_out, missing)
