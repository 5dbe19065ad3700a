"""The laws that are added to a model: those that predict runs left out best, one or two."""

from collections.abc import Sequence

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.estimation.goodness_of_fit import run_misfits
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce
from ..selection.working_step import WorkingStep
from .exact_laws import TRIED, explains_train_runs, is_needless, likeliest, smooth_trials
from .fitting import AddedLaws, fitted_laws, left_out_misfits, predicts_better
from .search import ProposedLaw, search

RIVAL = 2.0
"""A law whose excess in the windows is above this multiple of the best one's is not fitted to whole runs."""
SECOND = 0.5
"""A second law is looked for beside the first where it leaves less than this share of the excess of the windows."""
LEAST_EXCESS = 0.02
"""Where the first law leaves less excess than this in the windows, no second one is looked for."""


def rivals_of(laws: Sequence[ProposedLaw]) -> list[ProposedLaw]:
    """The first few laws that leave nearly as little in the windows as the best does."""
    least = min((law.left_out - 1 for law in laws), default=0.0)
    return [law for law in laws if law.left_out - 1 <= RIVAL * max(least, LEAST_EXCESS)][:TRIED]


def best_laws(
    case: Case, noise: Noise, like: WorkingStep, last: WorkingStep, missing: LatentForce, progress: Progress
) -> list[AddedLaws]:
    """The best of the first few laws of `missing` on whole train runs, added to `like` with the effects that stay
    significant together with the force; then also with a second law, if it improves the prediction of omitted train
    runs.

    Empty if no law predicts them better than `like` and `last`.
    """
    beside = tuple(name for name in missing.beside if name != LATERAL_SLIP_SWITCH)
    effects = tuple(dict.fromkeys((*like.step.effects, *beside)))

    def added(laws: tuple[ProposedLaw, ...]) -> AddedLaws | None:
        texts = " and ".join(law.expression for law in laws)
        progress(ProgressEvent(Phase.LAW_FIT, f"fitting {texts} to whole runs"))
        try:
            candidate_set, fit = fitted_laws(case, noise, like.candidate_set, effects, missing, laws)
        except FitError:
            return None
        if not fit.solution.misfit < like.step.solution.misfit:
            return None
        if explains_train_runs(like, candidate_set, fit):
            own = run_misfits(candidate_set.problem, fit.solution, candidate_set.train)
            return AddedLaws(laws, candidate_set, fit, own)
        progress(ProgressEvent(Phase.PREDICTION, f"does {texts} predict omitted runs?"))
        return AddedLaws(laws, candidate_set, fit, left_out_misfits(candidate_set, fit))

    trials: list[AddedLaws] = []
    for law in rivals_of(missing.laws):
        if law.family.together or is_needless(law, trials):
            continue
        trial = added((law,))
        if trial is not None:
            trials.append(trial)
    exact = [trial for trial in trials if trial.leaves_only_noise]
    if exact:
        return [likeliest(exact)]
    smooth: list[AddedLaws] = []
    if missing.windows is not None:
        proposed = [law for law in missing.laws if law.family.together]
        smooth = smooth_trials(missing.windows, proposed, lambda law: added((law,)))
    if smooth and smooth[-1].leaves_only_noise:
        return [smooth[-1]]
    trials += smooth
    best = min(trials, key=lambda trial: trial.left_out.mean(), default=None)
    if best is None:
        return []
    second = _second(missing, best.laws[0], progress)
    both = None if second is None else added((best.laws[0], second))
    path = [best] if both is None or not predicts_better(both.left_out, best.left_out) else [best, both]
    rivals = [like] if last is like else [like, last]
    expected = [left_out_misfits(step.candidate_set, step.step) for step in rivals]
    return path if all(predicts_better(path[-1].left_out, before) for before in expected) else []


def _second(missing: LatentForce, first: ProposedLaw, progress: Progress) -> ProposedLaw | None:
    """The law that acts beside the `first`; None where it takes away too little."""
    if missing.windows is None or first.left_out - 1 < LEAST_EXCESS:
        return None
    progress(ProgressEvent(Phase.LAW_SEARCH, "searching for a second law"))
    laws = search(missing.windows, [(first.family, first.shape)])
    return laws[0] if laws and laws[0].left_out - 1 < SECOND * (first.left_out - 1) else None
