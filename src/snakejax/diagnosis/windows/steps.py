"""The steps of an explanation by windows: the model, its scores in all windows, its estimates and candidates."""

import dataclasses

from scipy import stats

from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Delay, Sensor
from snakejax.estimation.fitted_model import fitted_model
from snakejax.estimation.uncertainty import Estimate, estimate_of

from ..selection.candidates import CandidateSet
from ..selection.steps import CandidateScore, SelectionStep
from ..selection.working_step import judged_runs
from .search import Candidate, SearchState, WindowSearch, larger_sd, twins


def step_of(
    search: WindowSearch, candidate_set: CandidateSet, state: SearchState, name: str, with_: tuple[str, ...]
) -> SelectionStep:
    """The step to `state`: `name` says what was added, by default the last of its effects; the base has neither."""
    change = "dropped" if state.dropped else "added"
    name = state.dropped or name or (state.effects[-1] if state.effects else "")
    problem, values = search.problem, state.linear.point.values
    train = list(search.windows)
    solution = problem.fit(values, (), train, state.linear.point.start)
    judged = judged_runs(problem, solution, values, train)
    present = (*with_, *state.effects)
    model = problem.fitted(solution).without(*(e for e in candidate_set.candidates if e not in present))
    optimum = state.linear.subsets.with_effects(state.effects)
    fitted = dataclasses.replace(
        fitted_model(model, problem, solution, judged.heldout_fit),
        loose=tuple(search.model.names[k] for k in optimum.free),
        covariance=optimum.covariance,
        spread=1.0,
    )
    return SelectionStep(
        change=change if name else "base",
        name=name,
        effects=(*((LATERAL_SLIP_SWITCH,) if candidate_set.switched else ()), *present),
        fitted=fitted,
        train=judged.train,
        heldout=judged.heldout,
        runs=judged.runs,
        estimates=estimates_of_state(search, state),
        converged=state.linear.point.converged,
        ranking=_ranking(search, state, judged.train.misfit),
        left_out=candidate_set.left_out,
        criteria=candidate_set.criteria,
    )


def estimates_of_state(search: WindowSearch, state: SearchState) -> dict[str, Estimate]:
    """Value and standard error of each free parameter, by name.

    The standard error is the larger one of two: that of windows that count as one pose each, and that of the jackknife
    over recordings.
    """
    linear, model = state.linear, search.model
    free = model.free(state.effects)
    optimum, covariance = linear.jackknife(state.effects, free)
    sds = larger_sd(optimum, covariance, free)
    domains = search.prior.domains(search.problem, [model.names[k] for k in free])
    estimates = {}
    for k, (name, domain), step in zip(free, domains.items(), map(float, sds), strict=True):
        estimates[name] = estimate_of(linear.point.values[name], step, domain, k not in optimum.free)
    return estimates


def _ranking(search: WindowSearch, state: SearchState, misfit: float) -> tuple[CandidateScore, ...]:
    """The candidates beside a state, the one that recordings left out gain most by first; `misfit`: that of the train
    windows without them."""
    known, model, rows = search.problem.model.effects, search.model, []
    family = len(model.candidates)
    without = state.linear.subsets.with_effects(state.effects).chi2
    # With fewer recordings a larger value is needed for the same level.
    reach = float(stats.t.isf(search.criteria.significance_level / 2, max(len(state.linear.recording_grams) - 1, 1)))
    for one in state.candidates:
        columns = model.candidates[one.effect]
        names = [model.names[k] for k in columns]
        optimum = state.linear.subsets.with_effects([*state.effects, one.effect])
        domains = search.prior.domains(search.problem, names)
        expected = {}
        for (name, domain), value, sd in zip(domains.items(), one.values, map(float, one.sd), strict=True):
            expected[name.rsplit(".", 1)[-1]] = Estimate(value, sd, domain.unit, not one.at_bound)
        rows.append(
            CandidateScore(
                effect=one.effect,
                description=known[one.effect].description,
                p_value=min(1.0, one.p_value * family),
                statistic=max(0.0, float(one.gain.by_part.sum())),
                predicted_misfit=misfit * optimum.chi2 / without,
                misfit_without=misfit,
                estimate=expected,
                detectable={part: reach * (e.sd or 0.0) for part, e in expected.items()},
                of_measurement=isinstance(known[one.effect], Sensor | Delay),
                confusable_with=_confusable(search, state, one),
            )
        )
    return tuple(rows)


def _confusable(search: WindowSearch, state: SearchState, one: Candidate) -> tuple[str, ...]:
    """The other candidates that these recordings cannot tell from `one`, where it does anything."""
    if not one.gain.by_part.sum() > 0:
        return ()
    with_it = state.linear._replace(effects=(*state.effects, one.effect))
    return twins(search, state._replace(linear=with_it), one.effect)
