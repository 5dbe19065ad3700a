"""The law with which whole train runs leave only noise: by a formula, or a smooth function."""

from collections.abc import Callable, Sequence

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.estimation.goodness_of_fit import consistent_with_noise, largest_noise_misfit, run_misfits
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce
from ..selection.acceptance import accept_addition
from ..selection.candidates import CandidateFit, CandidateSet
from ..selection.working_step import WorkingStep
from .fitting import AddedLaws, fitted_laws
from .regression import FEWEST_CHI2
from .search import ProposedLaw, finer, smooth_laws, wider
from .windows import ForceWindows

TRIED = 3
"""So many of the laws that the windows propose are fitted to whole runs."""
SMOOTH_TRIED = 2
"""So many smooth functions, of other variables each, where no formula leaves only noise of whole runs."""


def is_needless(law: ProposedLaw, fitted: Sequence[AddedLaws]) -> bool:
    """Whether a `law` need not be fitted, as one of those `fitted` leaves nothing, has no more parameters, and is
    better in the windows too, by `FEWEST_CHI2`: of forms that are alike there whole runs tell which it is."""
    return any(
        one.leaves_nothing and one.size <= len(law.parameters) and law.score - one.laws[0].score > FEWEST_CHI2
        for one in fitted
    )


def exact_law(
    case: Case, noise: Noise, like: WorkingStep, missing: LatentForce, progress: Progress
) -> AddedLaws | None:
    """The likeliest law of `missing` with which whole train runs leave only noise, added to `like`; None without one.

    Only laws are fitted that leave only noise in the windows of runs left out. After one that leaves nothing the others
    are fitted once each, and only as long as they may be likelier.
    """
    if missing.windows is None:
        return None
    exact_laws: list[AddedLaws] = []

    def fitted(law: ProposedLaw) -> AddedLaws | None:
        goal = misfit_to_reach(law, exact_laws, like.step.solution.samples)
        return _fitted(case, noise, like, missing, law, goal, progress)

    for law in _leaving_only_noise_of(missing.windows, missing.laws)[:TRIED]:
        if is_needless(law, exact_laws):
            continue
        once = any(one.leaves_nothing for one in exact_laws)
        trial = fitted(law) if once else _fitted_from_widths(missing.windows, law, fitted)
        if trial is not None and explains_train_runs(like, trial.candidate_set, trial.fit):
            exact_laws.append(trial)
    return likeliest(exact_laws) if exact_laws else None


def exact_smooth_law(
    case: Case, noise: Noise, like: WorkingStep, missing: LatentForce, progress: Progress
) -> AddedLaws | None:
    """A smooth function with which whole train runs leave only noise, added to `like`; None without one.

    Only functions are fitted that leave only noise in the windows of runs left out, and predict these better than every
    formula does.
    """
    if missing.windows is None:
        return None
    formulas = min((law.score for law in missing.laws if not law.family.together), default=np.inf)
    better = [law for law in smooth_laws(missing.windows) if law.score < formulas]
    laws = _leaving_only_noise_of(missing.windows, better)
    goal = largest_noise_misfit(like.step.solution.samples)
    trials = smooth_trials(missing.windows, laws, lambda law: _fitted(case, noise, like, missing, law, goal, progress))
    explains = bool(trials) and explains_train_runs(like, trials[-1].candidate_set, trials[-1].fit)
    return trials[-1] if explains else None


def _fitted_from_widths(
    windows: ForceWindows, law: ProposedLaw, fitted: Callable[[ProposedLaw], AddedLaws | None]
) -> AddedLaws | None:
    """A `law` as it is `fitted` to whole train runs; where it leaves more than noise, from larger widths too, as long
    as that comes nearer.

    In short windows a narrow bump and a wide one are alike, and the fit to whole runs may not find from one to the
    other.
    """
    best = fitted(law)
    if best is None or best.leaves_only_noise:
        return best
    for one in wider(windows, law):
        trial = fitted(one)
        if trial is None or not best.chi2 - trial.chi2 > FEWEST_CHI2:
            break
        best = trial
        if best.leaves_only_noise:
            break
    return best


def _leaving_only_noise_of(windows: ForceWindows, laws: Sequence[ProposedLaw]) -> list[ProposedLaw]:
    """Those of the `laws` that leave only noise in the `windows` of runs left out."""
    return [law for law in laws if law.left_out <= largest_noise_misfit(windows.samples)]


def misfit_to_reach(law: ProposedLaw, fitted: Sequence[AddedLaws], samples: int) -> float:
    """The misfit above which a `law` is of no use: that of noise, or that with which it is no likelier than the
    `likeliest` of those `fitted`."""
    noise = largest_noise_misfit(samples)
    if not fitted:
        return noise
    best = likeliest(fitted)
    return min(noise, (best.chi2 + FEWEST_CHI2 * (best.size - len(law.parameters))) / samples)


def _fitted(
    case: Case,
    noise: Noise,
    like: WorkingStep,
    missing: LatentForce,
    law: ProposedLaw,
    goal: float,
    progress: Progress,
) -> AddedLaws | None:
    """The model of `like` with a `law`, and the misfits of its own train runs; None where it cannot be fitted. `goal`:
    the misfit above which the fit is of no use."""
    progress(ProgressEvent(Phase.LAW_FIT, f"fitting {law.expression} to whole runs"))
    try:
        effects = like.step.effects
        candidate_set, fit = fitted_laws(case, noise, like.candidate_set, effects, missing, (law,), goal)
    except FitError:
        return None
    own = run_misfits(candidate_set.problem, fit.solution, candidate_set.train)
    return AddedLaws((law,), candidate_set, fit, own)


def smooth_trials(
    windows: ForceWindows, laws: Sequence[ProposedLaw], fitted: Callable[[ProposedLaw], AddedLaws | None]
) -> list[AddedLaws]:
    """The first smooth functions of `laws` as they are `fitted` to whole train runs, each through more values as long
    as it is then better; no further one after one that leaves only noise, which is the last.

    The windows are short, so that a function of few values may leave only noise in them and more in whole runs.
    """
    trials: list[AddedLaws] = []
    for law in laws[:SMOOTH_TRIED]:
        last = None
        for one in (law, *finer(windows, law)):
            trial = fitted(one)
            if trial is None or (last is not None and not _better_through_more(trial, last)):
                break
            last = trial
            trials.append(trial)
        if last is not None and last.leaves_only_noise:
            break
    return trials


def _better_through_more(trial: AddedLaws, last: AddedLaws) -> bool:
    """Whether a function through more values than that of `last` predicts better, and lowers chi^2 by more than
    `FEWEST_CHI2` beside the 1 that each value fits by chance."""
    falls = last.chi2 - trial.chi2 > FEWEST_CHI2 + trial.size - last.size
    return bool(falls and trial.left_out.mean() < last.left_out.mean())


def likeliest(exact_laws: Sequence[AddedLaws]) -> AddedLaws:
    """Of laws that leave only noise that with the least chi^2, where each parameter costs `FEWEST_CHI2`: nearly ln N of
    some ten thousand samples N, as in the evidence of Schwarz (1978)."""
    return min(exact_laws, key=lambda one: one.chi2 + FEWEST_CHI2 * one.size)


def explains_train_runs(like: WorkingStep, candidate_set: CandidateSet, fit: CandidateFit) -> bool:
    """Whether a `fit` with laws leaves only noise of whole train runs and is accepted after `like`."""
    return consistent_with_noise(fit.solution) and accept_addition(candidate_set, like.step, fit)
