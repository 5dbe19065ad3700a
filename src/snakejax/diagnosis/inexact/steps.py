"""The steps of an explanation whose model is not exact: whole runs simulated with more and more of the effects."""

import dataclasses
from typing import NamedTuple

import numpy as np

from snakejax.core.parameter import with_parameters
from snakejax.core.progress import Phase, ProgressEvent
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Delay, Sensor
from snakejax.estimation.fitted_model import fitted_model
from snakejax.estimation.problem import Problem, Solution

from ..selection.candidates import CandidateSet
from ..selection.steps import CandidateScore, SelectionStep
from ..selection.working_step import judged_runs
from .assessment import Assessment, estimates_at
from .subsets import addition_gains

CRAWL, MOST = 5e-2, 6
"""The fit of a step that lacks effects stops where a step of it lowers chi^2 by less than this share, and after so many
steps: its error is shown, nothing is decided by it."""


def steps_of(assessment: Assessment) -> list[SelectionStep]:
    """The steps after the base: the change of structure where there was one, then the effects, the surest first.

    The last step has the values of the assessment. Before it effects are lacking: tyre and effects are fitted to whole
    runs from the values of the assessment, and again from those of the step before if they end with a larger error than
    that step. The constants of the vehicle are those of the assessment throughout.
    """
    names: list[tuple[str, tuple[str, ...]]] = []
    candidate_set = assessment.candidate_set
    if candidate_set.switched:
        names.append((LATERAL_SLIP_SWITCH, ()))
    names += [(effect, assessment.effects[: k + 1]) for k, effect in enumerate(assessment.effects)]
    steps: list[SelectionStep] = []
    before: _FittedStep | None = None
    for k, (name, effects) in enumerate(names):
        assessment.search.progress(ProgressEvent(Phase.REFITTING_SETS, done=k + 1, total=len(names)))
        fitted = _fitted(assessment, effects, before)
        before = fitted if fitted.solution.free else None
        steps.append(_step(assessment, name, effects, fitted))
    return steps


def calibrated(assessment: Assessment) -> SelectionStep:
    """The base of `assessment`, to which nothing was added, with the constants of the vehicle as estimated."""
    step = _step(assessment, "", (), _fitted(assessment, (), None))
    return dataclasses.replace(step, change="base")


def beside_stated_constants(assessment: Assessment, effects: tuple[str, ...]) -> SelectionStep:
    """The base with `effects`, and with the constants of the vehicle as stated."""
    model = assessment.search.model
    known = _known(assessment, effects)
    stated = {model.names[k]: float(model.neutral[k]) for k in model.constants}
    free = assessment.candidate_set.free([*assessment.base, *effects])
    return _step(assessment, "", effects, _to_whole_runs(assessment, known | stated, free))


class _FittedStep(NamedTuple):
    """A model with some of the effects in whole train runs, at `known` values of all parameters by name."""

    problem: Problem
    known: dict[str, float]
    solution: Solution
    converged: bool


def _fitted(assessment: Assessment, effects: tuple[str, ...], before: _FittedStep | None) -> _FittedStep:
    candidate_set = assessment.candidate_set
    free = candidate_set.free([*assessment.base, *effects])
    known = _known(assessment, effects)
    if effects == assessment.effects:
        problem = _problem(assessment, known)
        settings = candidate_set.problem.values() | {n: known[n] for n in free}
        return _FittedStep(problem, known, problem.fit(settings, (), candidate_set.train), assessment.converged)
    fitted = _to_whole_runs(assessment, known, free)
    if before is not None and not fitted.solution.misfit < before.solution.misfit:
        # The step before is a special case of this model: from there the error can only fall.
        fitted = _to_whole_runs(assessment, before.known, free)
    return fitted


def _known(assessment: Assessment, effects: tuple[str, ...]) -> dict[str, float]:
    """The values of all parameters by name, the `effects` and the constants of the vehicle as estimated."""
    model, values = assessment.search.model, assessment.values
    for absent in set(model.candidates) - set(effects):
        columns = list(model.candidates[absent])
        values[columns] = model.neutral[columns]
    return dict(zip(model.names, map(float, values), strict=True))


def _to_whole_runs(assessment: Assessment, known: dict[str, float], free: list[str]) -> _FittedStep:
    """The parameters `free` fitted to whole train runs from the values `known`."""
    candidate_set, problem = assessment.candidate_set, _problem(assessment, known)
    settings = candidate_set.problem.values() | {n: candidate_set.off_zero(n, known[n]) for n in free}
    solution = problem.fit(settings, free, candidate_set.train, crawl=CRAWL, most=MOST)
    reached = {n: solution.values.get(n, value) for n, value in known.items()}
    return _FittedStep(problem, reached, solution, solution.converged)


def _step(assessment: Assessment, name: str, effects: tuple[str, ...], fitted_step: _FittedStep) -> SelectionStep:
    base, candidate_set = assessment.base, assessment.candidate_set
    problem, known, solution, converged = fitted_step
    values = np.array(list(known.values()))
    judged = judged_runs(problem, solution, solution.values, candidate_set.train)
    model = problem.fitted(solution).without(*(e for e in candidate_set.candidates if e not in (*base, *effects)))
    best = assessment.wide.with_effects(effects)
    fitted = dataclasses.replace(
        fitted_model(model, problem, solution, judged.heldout_fit),
        loose=tuple(assessment.search.model.names[k] for k in best.free),
        covariance=best.covariance,
        spread=1.0,  # the covariance counts what the model lacks
    )
    return SelectionStep(
        change="added",
        name=name,
        effects=(*((LATERAL_SLIP_SWITCH,) if candidate_set.switched else ()), *base, *effects),
        fitted=fitted,
        train=judged.train,
        heldout=judged.heldout,
        runs=judged.runs,
        estimates=assessment.estimates(effects, values),
        converged=converged,
        ranking=_ranking(assessment, candidate_set, effects),
        left_out=candidate_set.left_out,
        criteria=candidate_set.criteria,
    )


def _problem(assessment: Assessment, known: dict[str, float]) -> Problem:
    """The problem of whole runs with the constants of the vehicle at the values `known`, and room for the parameters of
    all effects: one compiled program serves all steps."""
    constants = {name: np.asarray(value) for name, value in known.items() if name.startswith("board.")}
    problem = assessment.candidate_set.problem
    width = max(problem.width, len(assessment.candidate_set.free([*assessment.base, *assessment.effects])))
    return dataclasses.replace(problem, model=with_parameters(problem.model, constants), width=width)


def _ranking(
    assessment: Assessment, candidate_set: CandidateSet, effects: tuple[str, ...]
) -> tuple[CandidateScore, ...]:
    """The absent candidates by how far each lowers chi^2 beside `effects`."""
    model, linear = assessment.search.model, assessment.linear
    gained = addition_gains(linear.subsets, effects)
    known, rows = candidate_set.problem.model.effects, []
    for effect in sorted(gained, key=lambda e: -gained[e]):
        columns = model.candidates[effect]
        best = linear.subsets.with_effects([*effects, effect])
        values = assessment.search.segments.moved(linear.point.values, best.step)
        expected = estimates_at(assessment.search, best, values, columns)
        p = linear.subsets.p_value(effect, gained[effect])
        rows.append(
            CandidateScore(
                effect=effect,
                description=known[effect].description,
                p_value=min(1.0, p * len(model.candidates)),
                statistic=max(0.0, gained[effect]),
                estimate={name.rsplit(".", 1)[-1]: one for name, one in expected.items()},
                of_measurement=isinstance(known[effect], Sensor | Delay),
            )
        )
    return tuple(rows)
