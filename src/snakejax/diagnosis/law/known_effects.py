"""Known effects beside a law: where a law leaves more than noise, the library is searched again beside it, and then the
law beside what was found."""

import dataclasses
from typing import NamedTuple

from snakejax.core.progress import Progress, no_progress
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce, estimate_latent_force
from ..selection.candidates import CandidateFit, CandidateSet
from ..selection.ranking import rank
from ..selection.refit import refit
from ..selection.stepwise import stepwise_selection
from ..selection.working_step import WorkingStep, selection_step
from .adding import best_laws
from .fitting import AddedLaws, candidate_set_with, fitted_laws, left_out_misfits, predicts_better


def known_effects_beside(
    case: Case, noise: Noise, like: CandidateSet, laws: AddedLaws, progress: Progress
) -> list[WorkingStep]:
    """The steps from the model with `laws` to that with known effects too: the candidates of `like`, added and dropped
    as beside any base. None where nothing is added, or train runs left out are not predicted better."""
    built = {name: laws.candidate_set.problem.model.effects[name] for name in laws.names}
    candidate_set = candidate_set_with(case, noise, like, tuple(like.candidates), built)
    values = {name: laws.fit.solution.values.get(name, value) for name, value in candidate_set.problem.values().items()}
    step = CandidateFit(laws.fit.effects, refit(candidate_set, laws.fit.effects, values))
    ranking = rank(candidate_set, step, progress=progress)
    steps = stepwise_selection(candidate_set, step, ranking, [], progress, no_progress)
    if steps and not consistent_with_noise(steps[-1].step.solution):
        steps[-1] = _converged(steps[-1])
    if not steps or not predicts_better(left_out_misfits(candidate_set, steps[-1].step), laws.left_out):
        return []
    return steps


def _converged(last: WorkingStep) -> WorkingStep:
    """The `last` step fitted on until it converges: the amplitude of a law and what is inside it trade off along a
    curved valley, in which the fits of a selection stop."""
    problem, train = last.candidate_set.problem, last.candidate_set.train
    end = last.step._replace(solution=continue_to_convergence(problem, last.step.solution, train))
    return selection_step(last.candidate_set, last.record.change, last.record.name, end, last.ranking)


class LawBesideEffects(NamedTuple):
    """The `steps` to a law and to the known effects beside it, and the `force` in which the law was found."""

    steps: list[WorkingStep]
    force: LatentForce


def law_beside_effects(
    case: Case, noise: Noise, like: WorkingStep, last: WorkingStep, laws: AddedLaws, progress: Progress
) -> LawBesideEffects | None:
    """The law that is found once the known effects of the `last` step are in the model of `like`.

    Without them the force also held what they do, so that `laws` may have the wrong form. None where the new law does
    not predict train runs left out better than these.
    """
    effects = tuple(name for name in last.step.effects if name not in (*laws.names, *like.step.effects))
    if not effects:
        return None
    known = like.candidate_set.problem.values()
    near = {name: value for name, value in last.step.solution.values.items() if name in known}
    solution = like.step.solution._replace(values=known | near, misfit=last.step.solution.misfit)
    start = CandidateFit((*like.step.effects, *effects), solution)
    force = estimate_latent_force(like.candidate_set, start, progress).with_laws()
    force = dataclasses.replace(force, beside=effects)
    better = best_laws(case, noise, like, like, force, progress)
    if len(better) != 1:
        return None
    (added,) = better
    if not predicts_better(added.left_out, left_out_misfits(last.candidate_set, last.step)):
        return None
    steps = []
    for count, name in enumerate((*added.names, *effects[:-1])):
        some = (*like.step.effects, *effects[:count])
        candidate_set, fit = fitted_laws(case, noise, like.candidate_set, some, force, added.laws)
        steps.append(selection_step(candidate_set, "added", name, fit))
    return LawBesideEffects([*steps, selection_step(added.candidate_set, "added", effects[-1], added.fit)], force)
