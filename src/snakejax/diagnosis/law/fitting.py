"""Proposed laws as effects of the model, fitted to whole train runs, and how these predict runs left out."""

import itertools
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.parameter import parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.law import law_class
from snakejax.dynamics.ports import Effect
from snakejax.estimation.goodness_of_fit import consistent_with_noise, run_misfits
from snakejax.estimation.initial_model import default_free
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.recording.run import Case, Noise

from ..latent_force.missing_force import LatentForce
from ..selection.candidates import BaseFit, CandidateFit, CandidateSet
from ..selection.refit import CRAWL, refit
from ..selection.working_step import WorkingStep
from .search import ProposedLaw


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
    def leaves_only_noise(self) -> bool:
        """Whether the misfit may be that of noise."""
        return consistent_with_noise(self.fit.solution)

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
    goal: float = np.inf,
) -> tuple[CandidateSet, CandidateFit]:
    """The model with `effects` and `laws` fitted to whole train runs, from where the windows have it. `goal`: the
    misfit above which the fit is of no use.

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
        solution = continue_to_convergence(candidate_set.problem, solution, candidate_set.train, goal=goal)
    return candidate_set, CandidateFit(names, solution)


def left_out_misfits(candidate_set: CandidateSet, fit: CandidateFit) -> np.ndarray:
    """The misfit (R,) of each train run under parameters fitted to the others; only its start is its own. Where there
    is but one run, that of the fit."""
    problem, solution, train = candidate_set.problem, fit.solution, candidate_set.train
    if len(train) == 1:
        return run_misfits(problem, solution, train)
    free, misfits = list(solution.free), []
    for run in train:
        others = [k for k in train if k != run]
        apart = problem.fit(solution.values, free, others, solution.start, crawl=CRAWL, most=10)
        misfits.append(problem.fit(apart.values, [], [run], solution.start, most=20).misfit)
    return np.nan_to_num(np.array(misfits), nan=np.inf)


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
    expected = [left_out_misfits(step.candidate_set, step.step).mean() for step in steps]
    return list(steps[: int(np.argmin(expected)) + 1])
