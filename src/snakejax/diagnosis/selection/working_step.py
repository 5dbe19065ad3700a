"""A step while the selection is under way: its record beside the workspace in which the selection goes on."""

from collections.abc import Sequence
from typing import NamedTuple

from snakejax.core.parameter import parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Delay, Sensor
from snakejax.estimation.fit_workspace import fit_heldout_starts
from snakejax.estimation.fitted_model import FittedModel, fitted_model
from snakejax.estimation.goodness_of_fit import RunScore, Score, pooled_score, run_scores
from snakejax.estimation.initialisation import has_converged, with_true_errors
from snakejax.estimation.problem import Problem, Solution
from snakejax.estimation.uncertainty import Estimate, estimates_of

from .candidates import CandidateFit, CandidateSet
from .ranking import RankedCandidate
from .steps import SWITCH_DESCRIPTION, CandidateScore, SelectionStep


class WorkingStep(NamedTuple):
    """The `record` of a step, and the candidates, the fit, the ranking and the fit of held-out starts it is made of."""

    record: SelectionStep
    candidate_set: CandidateSet
    step: CandidateFit
    ranking: tuple[RankedCandidate, ...]
    judgement: Solution | None


class JudgedRuns(NamedTuple):
    """The scores of `runs`, those of all `train` and of all `heldout` runs, and the fit of the starts of the latter."""

    runs: tuple[RunScore, ...]
    train: Score
    heldout: Score | None
    heldout_fit: Solution | None


def selection_step(
    candidate_set: CandidateSet, change: str, name: str, step: CandidateFit, ranking: Sequence[RankedCandidate] = ()
) -> WorkingStep:
    """Judge `step`: train and held-out scores, estimates."""
    problem, train = candidate_set.problem, candidate_set.train
    judged = judged_runs(problem, step.solution, step.solution.values, train)
    record = SelectionStep(
        change=change,
        name=name,
        effects=(*((LATERAL_SLIP_SWITCH,) if candidate_set.switched else ()), *step.effects),
        fitted=_fitted(candidate_set, step, judged.heldout_fit),
        train=judged.train,
        heldout=judged.heldout,
        runs=judged.runs,
        estimates=estimates_of(problem, with_true_errors(problem, step.solution, train)),
        converged=has_converged(problem, step.solution, train),
        ranking=tuple(candidate_score(candidate_set, candidate) for candidate in ranking),
        left_out=_left_out(candidate_set, step, ranking),
        criteria=candidate_set.criteria,
    )
    return WorkingStep(record, candidate_set, step, tuple(ranking), judged.heldout_fit)


def judged_runs(problem: Problem, solution: Solution, values: dict[str, float], train: Sequence[int]) -> JudgedRuns:
    """The scores of `solution` in the runs numbered `train`, and of its `values` in the held-out runs."""
    runs = run_scores(problem, solution, train)
    heldout = fit_heldout_starts(problem, values)
    unseen = () if heldout is None else run_scores(problem, heldout, problem.run_indices("heldout"))
    return JudgedRuns((*runs, *unseen), pooled_score(runs), pooled_score(unseen) if unseen else None, heldout)


def candidate_score(candidate_set: CandidateSet, ranked: RankedCandidate) -> CandidateScore:
    """The plain data of one candidate."""
    model, score, again = candidate_set.problem.model, ranked.score, ranked.refitted
    effect = model.effects.get(ranked.effect)
    expected: dict[str, Estimate] = {}
    if score is not None:
        units = {name: p.domain.unit for name, p in parameters(model).items()}
        expected = {_last(n): Estimate(v, score.sd[n], units[n], True) for n, v in score.values.items()}
    return CandidateScore(
        effect=ranked.effect,
        description=SWITCH_DESCRIPTION if effect is None else effect.description,
        p_value=None if score is None else score.p_value,
        statistic=None if score is None else score.statistic,
        predicted_misfit=ranked.predicted_misfit,
        misfit_without=None if ranked.prospect is None else ranked.prospect.without,
        windows_chi2=ranked.windows_chi2,
        refit_misfit=ranked.refit_misfit,
        estimate=expected,
        refit_estimate=None if again is None else {_last(name): estimate for name, estimate in again.items()},
        detectable={} if score is None else {_last(name): value for name, value in score.detectable.items()},
        confusable_with=ranked.confusable_with,
        failed=ranked.failed,
        converged=_refit_converged(candidate_set, ranked),
        of_measurement=isinstance(effect, Sensor | Delay),
    )


def _refit_converged(candidate_set: CandidateSet, ranked: RankedCandidate) -> bool | None:
    if ranked.refit is None:
        return None
    if ranked.effect == LATERAL_SLIP_SWITCH:  # a fit of another problem
        return ranked.refit.converged
    return has_converged(candidate_set.problem, ranked.refit, candidate_set.train)


def _fitted(candidate_set: CandidateSet, step: CandidateFit, heldout: Solution | None) -> FittedModel:
    """The fitted model, without the candidates that are not in it."""
    absent = [name for name in candidate_set.candidates if name not in step.effects]
    model = candidate_set.problem.fitted(step.solution).without(*absent)
    return fitted_model(model, candidate_set.problem, step.solution, heldout)


def _left_out(candidate_set: CandidateSet, step: CandidateFit, ranking: Sequence[RankedCandidate]) -> dict[str, str]:
    """The candidates that were not ranked, with the reason."""
    ranked = {candidate.effect for candidate in ranking} | set(step.effects)
    known = candidate_set.problem.model.effects
    silent = {name: known[name].unobservable_because for name in candidate_set.candidates if name not in ranked}
    return candidate_set.left_out | silent


def _last(name: str) -> str:
    return name.rsplit(".", 1)[-1]
