"""The steps of an explanation whose model is not exact: whole runs simulated with more and more of the effects."""

import dataclasses

import numpy as np

from snakejax.core.parameter import with_parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Delay, Sensor
from snakejax.estimation.fitted_model import fitted_model
from snakejax.estimation.problem import Problem

from ..selection.candidates import CandidateSet
from ..selection.steps import CandidateScore, SelectionStep
from ..selection.working_step import judged_runs
from .assessment import Assessment, estimates_at
from .subsets import gains

CRAWL, MOST = 5e-2, 6
"""The fit of a step that lacks effects stops where a step of it lowers chi^2 by less than this share, and after so many
steps: its error is shown, nothing is decided by it."""


def steps_of(assessment: Assessment) -> list[SelectionStep]:
    """The steps after the base: the change of structure where there was one, then the effects, the strongest first.

    The last step has the values of the assessment. Before it effects are lacking, and beside a random force that stands
    for them a fit need not lower the error of whole runs: there these are fitted.
    """
    names: list[tuple[str, tuple[str, ...]]] = []
    candidate_set = assessment.candidate_set
    if candidate_set.switched:
        names.append((LATERAL_SLIP_SWITCH, ()))
    names += [(effect, assessment.effects[: k + 1]) for k, effect in enumerate(assessment.effects)]
    return [_step(assessment, name, effects) for name, effects in names]


def _step(assessment: Assessment, name: str, effects: tuple[str, ...]) -> SelectionStep:
    base, candidate_set = assessment.base, assessment.candidate_set
    values, converged = assessment.fit_with(effects)
    known = dict(zip(assessment.search.model.names, values, strict=True))
    problem = _problem(candidate_set, known)
    neutral = candidate_set.problem.values()
    free = candidate_set.free([*base, *effects])
    settings = neutral | {n: float(known[n]) for n in free}
    if effects == assessment.effects or len(free) > problem.width:
        solution = problem.fit(settings, (), candidate_set.train)
    else:
        solution = problem.fit(settings, free, candidate_set.train, crawl=CRAWL, most=MOST)
        values, converged = np.array([solution.values.get(n, v) for n, v in known.items()]), solution.converged
    judged = judged_runs(problem, solution, solution.values, candidate_set.train)
    model = problem.fitted(solution).without(*(e for e in candidate_set.candidates if e not in (*base, *effects)))
    best = assessment.wide.with_effects(effects)
    fitted = dataclasses.replace(
        fitted_model(model, problem, solution, judged.heldout_fit),
        loose=tuple(assessment.search.model.names[k] for k in best.free),
        covariance=best.covariance,
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


def _problem(candidate_set: CandidateSet, known: dict[str, float]) -> Problem:
    """The problem of whole runs with the constants of the vehicle at the values `known`."""
    constants = {name: np.asarray(value) for name, value in known.items() if name.startswith("board.")}
    problem = candidate_set.problem
    return dataclasses.replace(problem, model=with_parameters(problem.model, constants))


def _ranking(
    assessment: Assessment, candidate_set: CandidateSet, effects: tuple[str, ...]
) -> tuple[CandidateScore, ...]:
    """The absent candidates by how far each lowers chi^2 beside `effects`."""
    model, linear = assessment.search.model, assessment.linear
    gained = gains(linear.subsets, effects)
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
