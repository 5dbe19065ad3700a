"""A proposed law as an effect of the model: fitted to whole train runs, and kept where it predicts runs left out."""

import itertools
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.parameter import parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.law import law_class
from snakejax.dynamics.ports import Effect
from snakejax.estimation.goodness_of_fit import consistent_with_noise, largest_noise_misfit, run_misfits
from snakejax.estimation.initial_model import default_free
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce
from ..selection.acceptance import accept_addition
from ..selection.candidates import BaseFit, CandidateFit, CandidateSet
from ..selection.refit import CRAWL, refit
from ..selection.working_step import WorkingStep
from .regression import FEWEST_CHI2
from .search import ProposedLaw, finer, search, smooth_laws

TRIED = 3
"""So many of the laws that the windows propose are fitted to whole runs."""
SMOOTH_TRIED = 2
"""So many smooth functions, of other variables each, where no formula leaves only noise of whole runs."""
RIVAL = 2.0
"""A law whose excess in the windows is above this multiple of the best one's is not fitted to whole runs."""
SECOND = 0.5
"""A second law is looked for beside the first where it leaves less than this share of the excess of the windows."""
LEAST_EXCESS = 0.02
"""Where the first law leaves less excess than this in the windows, no second one is looked for."""


class AddedLaws(NamedTuple):
    """The `laws` fitted to whole train runs: `fit` in `candidate_set`, and the misfit (R,) that it leaves of each train
    run that was left out; of a fit that leaves only noise, that of its own runs."""

    laws: tuple[ProposedLaw, ...]
    candidate_set: CandidateSet
    fit: CandidateFit
    left_out: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the laws as effects."""
        return self.fit.effects[-len(self.laws) :]

    @property
    def chi2(self) -> float:
        """chi^2 of whole train runs."""
        return self.fit.solution.misfit * self.fit.solution.samples

    @property
    def size(self) -> int:
        """Parameters of the laws."""
        return sum(len(law.parameters) for law in self.laws)

    @property
    def leaves_nothing(self) -> bool:
        """Whether the misfit is that of noise within its standard deviation."""
        return consistent_with_noise(self.fit.solution, sigmas=1.0)


def law_names(count: int, like: CandidateSet) -> tuple[str, ...]:
    """`law_1`, `law_2`, ...: names that no law of the model of `like` has."""
    free = (name for k in itertools.count(1) if (name := f"law_{k}") not in like.problem.model.effects)
    return tuple(itertools.islice(free, count))


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


def fitted_laws(
    case: Case,
    noise: Noise,
    like: CandidateSet,
    effects: Sequence[str],
    missing: LatentForce,
    laws: Sequence[ProposedLaw],
) -> tuple[CandidateSet, CandidateFit]:
    """The model with `effects` and `laws` fitted to whole train runs, from where the windows have it.

    **Raises:** `FitError` where these have more parameters than one fit can free.
    """
    named = dict(zip(law_names(len(laws), like), laws, strict=True))
    built: dict[str, Effect] = {n: law_class(law.expression, law.parameters)() for n, law in named.items()}
    candidate_set = candidate_set_with(case, noise, like, effects, built)
    values, known = candidate_set.problem.values(), parameters(candidate_set.problem.model)
    for (name, estimate), step in zip(missing.estimates.items(), laws[-1].steps, strict=True):
        if name in values:
            domain = known[name].domain
            short = float(np.clip(step, -0.5, 0.5) if domain.multiplicative else step)
            values[name] = domain.moved_inside(estimate.value, short)
    values |= {f"effects.{n}.{part}": value for n, law in named.items() for part, value in law.values.items()}
    names = (*effects, *named)
    if len(candidate_set.free(names)) > candidate_set.problem.width:
        raise FitError(f"The laws {', '.join(named)} and {', '.join(effects)} have too many parameters to fit.")
    solution = refit(candidate_set, names, values)
    if solution.misfit < candidate_set.criteria.linear_misfit:
        solution = continue_to_convergence(candidate_set.problem, solution, candidate_set.train)
    return candidate_set, CandidateFit(names, solution)


def left_out_misfits(candidate_set: CandidateSet, fit: CandidateFit) -> np.ndarray:
    """The misfit (R,) of each train run under parameters fitted to the others; only its start is its own."""
    problem, solution, train = candidate_set.problem, fit.solution, candidate_set.train
    free, misfits = list(solution.free), []
    for run in train:
        others = [k for k in train if k != run]
        apart = problem.fit(solution.values, free, others, solution.start, crawl=CRAWL, most=10)
        misfits.append(problem.fit(apart.values, [], [run], solution.start, most=20).misfit)
    return np.nan_to_num(np.array(misfits), nan=np.inf)


def expected_misfits(candidate_set: CandidateSet, fit: CandidateFit) -> np.ndarray:
    """The misfit (R,) of train runs that were left out; where the fit is far from the recordings, that of its own
    runs, which is smaller."""
    near = fit.solution.misfit < candidate_set.criteria.far_misfit
    return (
        left_out_misfits(candidate_set, fit)
        if near
        else run_misfits(candidate_set.problem, fit.solution, candidate_set.train)
    )


def predicts_better(after: np.ndarray, before: np.ndarray) -> bool:
    """Whether the misfit (R,) of runs left out is lower `after` than `before`, by more than its standard error.

    The mean of ln(before / after) over runs, so that no single run decides, against sd / sqrt(R).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.log(before) - np.log(after)
    return bool(np.isfinite(gain).all() and gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))


def predicting_steps(steps: Sequence[WorkingStep], progress: Progress) -> list[WorkingStep]:
    """The steps up to the one that predicts train runs left out best, so that none is kept that predicts them worse
    than a step before it does."""
    if len(steps) < 2:
        return list(steps)
    progress(ProgressEvent(Phase.PREDICTION, "does each step predict omitted runs?"))
    expected = [expected_misfits(step.candidate_set, step.step).mean() for step in steps]
    return list(steps[: int(np.argmin(expected)) + 1])


def rivals_of(laws: Sequence[ProposedLaw]) -> list[ProposedLaw]:
    """The first few laws that leave nearly as little in the windows as the best does."""
    least = min((law.left_out - 1 for law in laws), default=0.0)
    return [law for law in laws if law.left_out - 1 <= RIVAL * max(least, LEAST_EXCESS)][:TRIED]


def is_needless(law: ProposedLaw, fitted: Sequence[AddedLaws]) -> bool:
    """Whether a `law` need not be fitted, as one of those `fitted` leaves nothing and has no more parameters."""
    return any(one.leaves_nothing and one.size <= len(law.parameters) for one in fitted)


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
        exact = _leaving_only_noise(like, laws, candidate_set, fit)
        if exact is not None:
            return exact
        # Far from the noise a linear model says nothing about runs left out.
        progress(ProgressEvent(Phase.PREDICTION, f"does {texts} predict omitted runs?"))
        return AddedLaws(laws, candidate_set, fit, left_out_misfits(candidate_set, fit))

    trials: list[AddedLaws] = []
    for law in rivals_of(missing.laws):
        if is_needless(law, trials):
            continue
        trial = added((law,))
        if trial is not None:
            trials.append(trial)
    exact = [trial for trial in trials if consistent_with_noise(trial.fit.solution)]
    if exact:
        return [likeliest(exact)]
    smooth = _smooth_trials(missing, added)
    if smooth and consistent_with_noise(smooth[-1].fit.solution):
        return [smooth[-1]]
    trials += smooth
    best = min(trials, key=lambda trial: trial.left_out.mean(), default=None)
    if best is None:
        return []
    second = _second(missing, best.laws[0], progress)
    both = None if second is None else added((best.laws[0], second))
    path = [best] if both is None or not predicts_better(both.left_out, best.left_out) else [best, both]
    rivals = [like] if last is like else [like, last]
    expected = [expected_misfits(step.candidate_set, step.step) for step in rivals]
    return path if all(predicts_better(path[-1].left_out, before) for before in expected) else []


def exact_law(
    case: Case, noise: Noise, like: WorkingStep, missing: LatentForce, progress: Progress
) -> AddedLaws | None:
    """The likeliest law of `missing` with which whole train runs leave only noise, added to `like`; None without one.

    Only laws are fitted that leave only noise in the windows of runs left out.
    """
    if missing.windows is None:
        return None
    exact_laws: list[AddedLaws] = []
    most = largest_noise_misfit(missing.windows.samples)
    for law in [law for law in missing.laws if law.left_out <= most][:TRIED]:
        if is_needless(law, exact_laws):
            continue
        progress(ProgressEvent(Phase.LAW_FIT, f"fitting {law.expression} to whole runs"))
        try:
            candidate_set, fit = fitted_laws(case, noise, like.candidate_set, like.step.effects, missing, (law,))
        except FitError:
            continue
        exact = _leaving_only_noise(like, (law,), candidate_set, fit)
        if exact is not None:
            exact_laws.append(exact)
    return likeliest(exact_laws) if exact_laws else None


def likeliest(exact_laws: Sequence[AddedLaws]) -> AddedLaws:
    """Of laws that leave only noise that with the least chi^2, or the one with the fewest parameters of those that do
    not differ from it by `FEWEST_CHI2`: of many samples noise may vary by more than what tells a law from another."""
    least = min(one.chi2 for one in exact_laws)
    return min((one for one in exact_laws if one.chi2 - least < FEWEST_CHI2), key=lambda one: (one.size, one.chi2))


def exact_smooth_law(
    case: Case, noise: Noise, like: WorkingStep, missing: LatentForce, progress: Progress
) -> AddedLaws | None:
    """A smooth function of one variable or two with which whole train runs leave only noise, added to `like`; None
    without one."""

    def added(laws: tuple[ProposedLaw, ...]) -> AddedLaws | None:
        progress(ProgressEvent(Phase.LAW_FIT, f"fitting {laws[0].expression} to whole runs"))
        try:
            candidate_set, fit = fitted_laws(case, noise, like.candidate_set, like.step.effects, missing, laws)
        except FitError:
            return None
        return AddedLaws(
            laws, candidate_set, fit, run_misfits(candidate_set.problem, fit.solution, candidate_set.train)
        )

    smooth = _smooth_trials(missing, added)
    return _leaving_only_noise(like, smooth[-1].laws, smooth[-1].candidate_set, smooth[-1].fit) if smooth else None


def _smooth_trials(
    missing: LatentForce, added: Callable[[tuple[ProposedLaw, ...]], AddedLaws | None]
) -> list[AddedLaws]:
    """Smooth functions fitted to whole train runs, each through more values as long as they then predict better; the
    last one is the first that leaves only noise, where one does.

    The windows are short, so that a function of few values may leave only noise in them and more in whole runs.
    """
    trials: list[AddedLaws] = []
    if missing.windows is None:
        return trials
    for law in smooth_laws(missing.windows)[:SMOOTH_TRIED]:
        least = np.inf
        for one in (law, *finer(missing.windows, law)):
            trial = added((one,))
            if trial is None or not trial.left_out.mean() < least:
                break
            least = trial.left_out.mean()
            trials.append(trial)
            if consistent_with_noise(trial.fit.solution):
                return trials
    return trials


def _leaving_only_noise(
    like: WorkingStep, laws: tuple[ProposedLaw, ...], candidate_set: CandidateSet, fit: CandidateFit
) -> AddedLaws | None:
    """The `laws` of `fit` where it leaves only noise of whole train runs and is accepted after `like`; else None."""
    if not (consistent_with_noise(fit.solution) and accept_addition(candidate_set, like.step, fit)):
        return None
    return AddedLaws(laws, candidate_set, fit, run_misfits(candidate_set.problem, fit.solution, candidate_set.train))


def _second(missing: LatentForce, first: ProposedLaw, progress: Progress) -> ProposedLaw | None:
    """The law that acts beside the `first`; None where it takes away too little."""
    if missing.windows is None or first.left_out - 1 < LEAST_EXCESS:
        return None
    progress(ProgressEvent(Phase.LAW_SEARCH, "searching for a second law"))
    laws = search(missing.windows, [(first.family, first.shape)])
    return laws[0] if laws and laws[0].left_out - 1 < SECOND * (first.left_out - 1) else None
