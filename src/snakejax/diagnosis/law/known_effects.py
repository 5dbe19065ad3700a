"""Known effects beside a law: where a law leaves more than noise, the library is searched again beside it."""

from snakejax.core.progress import Progress, no_progress
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.recording.run import Case, Noise

from ..selection.candidates import CandidateFit, CandidateSet
from ..selection.ranking import rank
from ..selection.refit import refit
from ..selection.stepwise import stepwise_selection
from ..selection.working_step import WorkingStep, selection_step
from .adding import AddedLaws, candidate_set_with, expected_misfits, predicts_better


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
    if not steps or not predicts_better(expected_misfits(candidate_set, steps[-1].step), laws.left_out):
        return []
    return steps


def _converged(last: WorkingStep) -> WorkingStep:
    """The `last` step fitted on until it converges: the amplitude of a law and what is inside it trade off along a
    curved valley, in which the fits of a selection stop."""
    candidate_set, (effects, solution) = last.candidate_set, last.step
    end = CandidateFit(effects, continue_to_convergence(candidate_set.problem, solution, candidate_set.train))
    return selection_step(candidate_set, last.record.change, last.record.name, end, last.ranking)
