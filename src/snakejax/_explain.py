"""The loop: fit, compare, diagnose, add, refit, until only noise is left or nothing known explains the rest."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Unpack

import equinox as eqx
import numpy as np

from ._acceptance import better_structure, heldout_noise
from ._align import aligned, with_clock_errors, with_logs_told, with_wander
from ._bench import HOPELESS, LATERAL_SKID, NEARLY
from ._diagnose import Diagnosis, Question, diagnose, silent
from ._effect import Effect
from ._errors import FitError
from ._fit import described
from ._follow import follow
from ._log_clocks import STILL, free_clocks
from ._log_noise import is_noisy
from ._misfit import only_noise
from ._missing import Missing, believed
from ._rank import rank, significant
from ._recording import Case, Noise
from ._stage import Stage, stage
from ._starting import starting_model

AGAIN = 2
"""How often recordings whose joint logs have free clocks are explained once more."""


class Explanation(eqx.Module):
    """The whole story: `stages[0]` is the base, the last one the final model.

    `verdict`: "adequate", "explained" or "unexplained". `effects`: what explains the recordings, or of those that stay
    unexplained what survives beside the missing force. `partial`: what helped without explaining. `left_out`:
    candidates that do not apply, with the reason. `missing`: the force that the base lacks, where nothing explains it;
    None where there is but one train run to learn it from.
    """

    case: Case
    noise: Noise
    stages: tuple[Stage, ...]
    verdict: str
    effects: tuple[str, ...]
    partial: tuple[str, ...]
    left_out: dict[str, str]
    missing: Missing | None

    @property
    def base(self) -> Stage:
        """The fit before anything was added."""
        return self.stages[0]

    @property
    def final(self) -> Stage:
        """The fit with all that was added."""
        return self.stages[-1]


def explain(
    case: Case,
    noise: Noise,
    library: Mapping[str, Effect],
    *,
    show: Callable[[Stage], None] = silent,
    **question: Unpack[Question],
) -> Explanation:
    """Find out which effects of `library` the recordings of `case` show beyond the base model.

    The free clocks of joint logs are found with them, and what noise in the logs does: from short windows and the base
    first, then as the final model has them, with which the recordings are explained once more, `AGAIN` times at most.

    **Arguments:** `show` is given each stage; `question`, see `Question`.
    **Raises:** `FitError` where the base cannot be fitted.
    """
    progress = question.get("progress", silent)
    logged = any(free_clocks(run) or is_noisy(run.gait) for run in case.runs)
    if logged:
        model = starting_model(case, question.get("kind", "pacejka"), question.get("skid"))
        case = with_logs_told(model, case, noise, progress)
    tell = silent if logged else show
    found, stages = _followed(case, noise, library, tell, question)
    for _ in range(AGAIN if logged else 0):
        again = _with_logs_of(case, stages[-1], progress)
        if again is None:
            break
        case = again
        found, stages = _followed(case, noise, library, tell, question)
    for one in stages if logged else ():
        show(one)
    return _with_errors(_concluded(case, noise, found, stages, progress), progress)


def _followed(case: Case, noise: Noise, library, show, question: Question) -> tuple[Diagnosis, list[Stage]]:
    """The diagnosis, and all stages from the base on, with the joint logs on the clocks they have."""
    found = diagnose(case, noise, library, **question)
    show(found.base)
    return found, [found.base, *_beyond(found, question.get("progress", silent), show)]


def _with_logs_of(case: Case, last: Stage, progress) -> Case | None:
    """`case` with the clocks of joint logs, and what their noise does, as the `last` model has them; None where it is
    too far off to tell, or nothing changes.
    """
    free = any(free_clocks(run) for run in case.runs)
    untold = any(is_noisy(run.gait) and run.wander is None for run in case.runs)
    if not (free or untold) or not last.step.optimum.misfit < HOPELESS:
        return None
    found = described(last.bench.study, last.step.optimum)
    if free:
        try:
            found = aligned(found, np.inf, progress)
        except FitError:
            return None
    runs = found.study.runs
    stay = all(
        abs(getattr(new.log, name) - getattr(old.log, name)) < STILL * getattr(new.log, f"{name}_sd")
        for new, old in zip(runs, case.runs, strict=True)
        for name in free_clocks(new)
    )
    told = with_wander(found, progress) if untold else None
    return None if stay and told is None else dataclasses.replace(case, runs=runs if told is None else told)


def _with_errors(found: Explanation, progress) -> Explanation:
    """`found`, the estimates of a last stage near the noise with the errors that clocks of joint logs bring."""
    last = found.final
    if all(run.log is None for run in found.case.runs) or not last.step.optimum.misfit < NEARLY:
        return found
    fit = described(last.bench.study, last.step.optimum)
    wider = with_clock_errors(fit, progress)
    if wider is fit:
        return found
    stages = (*found.stages[:-1], last._replace(estimates=wider.estimates))
    return dataclasses.replace(found, stages=stages, case=dataclasses.replace(found.case, runs=wider.study.runs))


def _beyond(found: Diagnosis, progress, show) -> list[Stage]:
    """The stages after the base."""
    base = found.base
    bench, step, ranking = base.bench, base.step, base.ranking
    if only_noise(step.optimum) and not significant(ranking):
        return []
    if found.switched is None:
        return follow(bench, step, ranking, [], progress, show)
    best = min((r.refit_misfit for r in ranking if r.refit is not None), default=np.inf)
    other, there = found.switched

    def on_the_other(show: Callable[[Stage], None]) -> list[Stage]:
        first = stage(other, "added", LATERAL_SKID, there, rank(other, there, progress=progress))
        show(first)
        return follow(other, there, first.ranking, [first], progress, show)

    if there.optimum.misfit <= best and better_structure(step, there):
        return on_the_other(show)
    here = follow(bench, step, ranking, [], progress, silent)
    if not (here and only_noise(here[-1].step.optimum)):
        # This structure does not explain by itself: follow the other one too, and keep what gets further.
        beside = on_the_other(silent)
        reached = here[-1].step.optimum.misfit if here else step.optimum.misfit
        here = beside if beside[-1].step.optimum.misfit < reached else here
    for one in here:
        show(one)
    return here


def _concluded(case: Case, noise: Noise, found: Diagnosis, stages: list[Stage], progress) -> Explanation:
    last = stages[-1]
    clean = only_noise(last.step.optimum) and heldout_noise(last.bench, last.step, last.judgement)
    if clean:
        verdict = "explained" if last.effects else "adequate"
        return Explanation(case, noise, tuple(stages), verdict, last.effects, (), stages[0].left_out, None)
    missing = None
    if len(last.bench.train) > 1:
        # Helpers that do not explain would hide a part of it, so it is counted from the structures on.
        structures = [(found.base.bench, found.base.step), *([found.switched] if found.switched else [])]
        helpers = [name for name in last.step.effects if name not in stages[0].step.effects]
        missing = believed(structures, last.bench, helpers, progress)
    survived = () if missing is None else missing.beside
    partial = tuple(name for name in last.effects if name not in survived)
    # What a fit without the force says of the effects that survive beside it is wrong by what the force does.
    surer = {} if missing is None else {n: e for n, e in missing.estimates.items() if n.split(".")[1] in survived}
    told = (*stages[:-1], last._replace(estimates=last.estimates | surer))
    return Explanation(case, noise, told, "unexplained", survived, partial, stages[0].left_out, missing)
