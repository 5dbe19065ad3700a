"""A proposed law as an effect of the model: fitted to whole train runs, and kept where it predicts runs left out."""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.parameter import parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.law import law_class
from snakejax.dynamics.ports import Effect
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initial_model import default_free
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce
from ..selection.acceptance import accept_addition
from ..selection.candidates import BaseFit, CandidateFit, CandidateSet
from ..selection.refit import CRAWL, refit
from ..selection.working_step import WorkingStep
from .search import ProposedLaw

FIRST_LAW = "law_1"
TRIED = 3
"""So many of the laws that the windows propose are fitted to whole runs."""


def candidate_set_with(
    case: Case, noise: Noise, like: CandidateSet, effects: Sequence[str], laws: dict[str, Effect]
) -> CandidateSet:
    """The candidates `effects` of `like` and `laws`, compiled anew, under the same structure and criteria."""
    full = like.problem.model
    library = OrderedDict((name, full.effects[name]) for name in effects)
    library.update(laws)
    fixed = {name: effect for name, effect in full.effects.items() if name not in like.candidates}
    model = full.without(*full.effects).add(**fixed)
    free = [*like.tyre, *(part for parts in like.candidates.values() for part in parts)]
    known = [*default_free(model), *(f"effects.{n}.{part}" for n in effects for part in parameters(full.effects[n]))]
    how = BaseFit(frozenset(name for name in known if name not in free), like.problem.threshold)
    return CandidateSet.of(model, case, noise, library, like.switched, like.criteria, how)


def fitted_law(
    case: Case, noise: Noise, like: CandidateSet, effects: Sequence[str], missing: LatentForce, law: ProposedLaw
) -> tuple[CandidateSet, CandidateFit]:
    """The model with `effects` and `law` fitted to whole train runs, from where the windows have it."""
    effect = law_class(law.expression, law.parameters)()
    candidate_set = candidate_set_with(case, noise, like, effects, {FIRST_LAW: effect})
    values = candidate_set.problem.values()
    known = parameters(candidate_set.problem.model)
    for (name, estimate), step in zip(missing.estimates.items(), law.steps, strict=True):
        if name in values:
            domain = known[name].domain
            moved = domain.moved(
                estimate.value, float(np.clip(step, -0.5, 0.5)) if domain.multiplicative else float(step)
            )
            values[name] = float(np.clip(moved, domain.low, domain.high))
    values |= {f"effects.{FIRST_LAW}.{name}": value for name, value in law.values.items()}
    names = (*effects, FIRST_LAW)
    solution = refit(candidate_set, names, values)
    if solution.misfit < candidate_set.criteria.linear_misfit:
        solution = continue_to_convergence(candidate_set.problem, solution, candidate_set.train)
    return candidate_set, CandidateFit(names, solution)


def left_out_misfit(candidate_set: CandidateSet, fit: CandidateFit) -> float:
    """The misfit of each train run under parameters fitted to the others; only its start is its own."""
    problem, solution, train = candidate_set.problem, fit.solution, candidate_set.train
    free, square = list(solution.free), 0.0
    for run in train:
        others = [k for k in train if k != run]
        apart = problem.fit(solution.values, free, others, solution.start, crawl=CRAWL, most=10)
        judged = problem.fit(apart.values, [], [run], solution.start, most=20)
        square += judged.misfit * judged.samples
    misfit = square / solution.samples
    return misfit if np.isfinite(misfit) else np.inf


def expected_misfit(candidate_set: CandidateSet, fit: CandidateFit) -> float:
    """The misfit of train runs that were left out; where the fit is far from the recordings, that of its own runs."""
    near = fit.solution.misfit < candidate_set.criteria.far_misfit
    return left_out_misfit(candidate_set, fit) if near else fit.solution.misfit


def predicting_steps(steps: Sequence[WorkingStep], progress: Progress) -> list[WorkingStep]:
    """The steps up to the one that predicts train runs left out best, so that none is kept that predicts them worse
    than a step before it does."""
    if len(steps) < 2:
        return list(steps)
    progress(ProgressEvent(Phase.PREDICTION, "does each step predict runs that were left out?"))
    expected = [expected_misfit(step.candidate_set, step.step) for step in steps]
    return list(steps[: int(np.argmin(expected)) + 1])


def best_law(
    case: Case,
    noise: Noise,
    like: CandidateSet,
    base: CandidateFit,
    missing: LatentForce,
    progress: Progress,
) -> tuple[CandidateSet, CandidateFit] | None:
    """The best of the first few laws of `missing` on whole train runs, beside the effects that survive beside the
    force; None where none predicts train runs it has not seen better than `base` does."""
    beside = tuple(name for name in missing.beside if name != LATERAL_SLIP_SWITCH)
    effects = tuple(dict.fromkeys((*base.effects, *beside)))
    best: tuple[CandidateSet, CandidateFit] | None = None
    least = None
    for law in missing.laws[:TRIED]:
        if len(base.solution.free) + len(beside) + len(law.parameters) > like.problem.width:
            continue
        progress(ProgressEvent(Phase.LAW_FIT, f"fitting {law.expression} to whole runs"))
        try:
            candidate_set, fit = fitted_law(case, noise, like, effects, missing, law)
        except FitError:
            continue
        if not fit.solution.misfit < base.solution.misfit:
            continue
        if consistent_with_noise(fit.solution) and accept_addition(candidate_set, base, fit):
            return candidate_set, fit
        # Far from the noise a linear model says nothing about runs left out.
        progress(ProgressEvent(Phase.PREDICTION, f"does {law.expression} predict runs that were left out?"))
        if least is None:
            least = expected_misfit(like, base)
        left = left_out_misfit(candidate_set, fit)
        if left < least:
            best, least = (candidate_set, fit), left
    return best
