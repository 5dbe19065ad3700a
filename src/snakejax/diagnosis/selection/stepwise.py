"""Adding what helps most, one effect after the other or several at once, and trying to do without each."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initialisation import continue_to_convergence
from snakejax.estimation.problem import Solution

from .acceptance import accept_addition, chi2_threshold, wald_significant
from .beam_search import CandidateSubset, beam_search
from .candidates import CandidateFit, CandidateSet
from .ranking import RankedCandidate, any_refit_consistent, rank, significant, trial_order
from .refit import fresh_fit, no_worse, refit
from .screening import ScreenedCandidate
from .steps import SelectionStep
from .working_step import WorkingStep, selection_step

Show = Callable[[SelectionStep], None]


class PathStep(NamedTuple):
    """One effect of a set that was added together: its name, the fit with it and those before, the ranking there."""

    name: str
    fit: CandidateFit
    ranking: tuple[RankedCandidate, ...]


def stepwise_selection(
    candidate_set: CandidateSet,
    step: CandidateFit,
    ranking: Sequence[RankedCandidate],
    before: Sequence[WorkingStep],
    progress: Progress,
    show: Show,
    few: CandidateSubset | None = None,
) -> list[WorkingStep]:
    """Forward selection with backward elimination: add what helps most, one effect after the other, then try to do
    without each. Returns the steps `before` this selection and its own.

    Far from the recordings a set of effects is searched first (`add_subset`), unless the effects of `few` leave only
    noise of whole runs.
    """
    steps = list(before)

    def record(change: str, name: str, fit: CandidateFit, ranks: Sequence[RankedCandidate] = ()) -> None:
        steps.append(selection_step(candidate_set, change, name, fit, ranks))
        show(steps[-1].record)

    if step.solution.misfit > candidate_set.criteria.linear_misfit and not any_refit_consistent(ranking):
        path, hopeless = add_subset(candidate_set, step, ranking, progress, few)
        for name, fit, ranks in path:
            step, ranking = fit, ranks
            record("added", name, fit, ranks)
        if hopeless:
            # No set of effects explains even the windows: which of them help a little is not worth the time.
            return steps
    for name, fit, ranks in _additions(candidate_set, step, ranking, progress):
        step = fit
        record("added", name, fit, ranks)
    for name, fit in _removals(candidate_set, step, progress):
        record("dropped", name, fit)
    return steps


def _additions(
    candidate_set: CandidateSet, step: CandidateFit, ranking: Sequence[RankedCandidate], progress: Progress
) -> Iterator[PathStep]:
    """The effects that are added to `step` one by one, until only noise is left, or none is accepted."""
    while len(step.effects) < candidate_set.criteria.most_effects:
        if consistent_with_noise(step.solution) and not significant(ranking, candidate_set.criteria):
            return
        accepted = _first_accepted(candidate_set, step, ranking, progress)
        if accepted is None:
            return
        step = refit_to_convergence(candidate_set, accepted, progress)
        ranking = tuple(rank(candidate_set, step, progress=progress))
        yield PathStep(step.effects[-1], step, ranking)


def _first_accepted(
    candidate_set: CandidateSet, step: CandidateFit, ranking: Sequence[RankedCandidate], progress: Progress
) -> CandidateFit | None:
    """`step` with the first candidate, in the order to try them, that predicts runs it was not fitted to."""
    for candidate in trial_order(ranking, candidate_set.criteria):
        assert candidate.refit is not None
        then = CandidateFit((*step.effects, candidate.effect), candidate.refit)
        progress(ProgressEvent(Phase.PREDICTION, f"does {candidate.effect} predict omitted runs?"))
        if accept_addition(candidate_set, step, then):
            return then
    return None


def _removals(
    candidate_set: CandidateSet, step: CandidateFit, progress: Progress
) -> Iterator[tuple[str, CandidateFit]]:
    """The effects of `step` without which chi^2 rises by no more than chance, with the fit without them."""
    for name in step.effects:
        if len(step.effects) < 2 or wald_significant(candidate_set, step, name):
            continue
        progress(ProgressEvent(Phase.ELIMINATION, f"refitting without {name}"))
        rest = tuple(effect for effect in step.effects if effect != name)
        without = CandidateFit(rest, refit_without(candidate_set, step, rest))
        rise = step.solution.samples * (without.solution.misfit - step.solution.misfit)
        freed = len(step.solution.free) - len(without.solution.free)
        if rise / max(1.0, step.solution.misfit) < chi2_threshold(freed, candidate_set.criteria):
            step = without
            yield name, step


def add_subset(
    candidate_set: CandidateSet,
    step: CandidateFit,
    ranking: Sequence[RankedCandidate],
    progress: Progress,
    few: CandidateSubset | None = None,
) -> tuple[list[PathStep], bool]:
    """The steps to the set of effects that explains the windows together and whole runs best, or none; and whether they
    end far from the recordings and no set explains even the windows.

    Far from the recordings whole runs cannot say which of two missing effects comes first; short windows can say which
    pair leaves least.
    """
    criteria = candidate_set.criteria
    by_windows = sorted(ranking, key=lambda r: r.predicted_misfit or np.inf)
    first = [r.prospect for r in by_windows if r.prospect is not None]
    best = None if few is None else _with_few(candidate_set, step, few, first, progress)
    best_on_windows = 1.0
    if best is None:
        sets = beam_search(candidate_set, step, first, len(step.effects) + criteria.most_effects_at_once, progress)
        best_on_windows = sets[0].misfit if sets else np.inf
        best = _best_subset(candidate_set, step, sets, progress)

    def hopeless(last: CandidateFit) -> bool:
        return best_on_windows > criteria.explained_windows_misfit and not last.solution.misfit < criteria.far_misfit

    if best is None or not accept_addition(candidate_set, step, best):
        return [], hopeless(step)
    path, before = [], step
    for count in range(len(step.effects) + 1, len(best.effects)):
        part = best.effects[:count]
        solution = refit(candidate_set, part, best.solution.values, near=False)
        before = CandidateFit(part, no_worse(candidate_set, before, part, solution))
        path.append(PathStep(part[-1], before, ()))
    ranks = () if hopeless(best) else tuple(rank(candidate_set, best, progress=progress))
    path.append(PathStep(best.effects[-1], best, ranks))
    return path, hopeless(best)


def _with_few(
    candidate_set: CandidateSet,
    step: CandidateFit,
    few: CandidateSubset,
    first: Sequence[ScreenedCandidate],
    progress: Progress,
) -> CandidateFit | None:
    """The effects of `few` on whole runs, those of `step` first and the others in the order of `first`; None unless
    only noise is left.

    On windows they settle from where the best one of `first` has, as segments, with a prior, leave the tyre far off.
    """
    if not set(step.effects) < set(few.effects) <= {*step.effects, *candidate_set.candidates}:
        return None
    ranked = [one for one in first if one.score.effect in few.effects]
    if len(ranked) < len(few.effects) - len(step.effects):
        return None
    effects = (*step.effects, *(one.score.effect for one in ranked))
    others = [name for one in ranked[1:] for name in candidate_set.candidates[one.score.effect]]
    begin = ranked[0].values | {name: candidate_set.off_zero(name, few.values[name]) for name in others}
    settled = candidate_set.windows.settle(begin, candidate_set.free(effects), ranked[0].start, rounds=25)
    subset = CandidateSubset(effects, settled.values, few.misfit, settled.start)
    best = _best_subset(candidate_set, step, [subset], progress)
    return best if best is not None and consistent_with_noise(best.solution) else None


def _best_subset(
    candidate_set: CandidateSet, step: CandidateFit, sets: Sequence[CandidateSubset], progress: Progress
) -> CandidateFit | None:
    """The best refit on whole runs among the best of the `sets`: the smallest one that reaches the noise, else the one
    that leaves least; None where none leaves less than `step`.
    """
    criteria = candidate_set.criteria
    best_on_windows = sets[0].misfit if sets else np.inf
    most_excess = criteria.subset_excess_ratio * max(best_on_windows - 1, criteria.smallest_excess)
    tried = [s for s in sets if s.misfit - 1 < most_excess][: criteria.subsets_refitted]
    progress(ProgressEvent(Phase.REFITTING_SETS, f"refitting {len(tried)} sets of effects on whole runs"))
    refits = []
    for subset in tried:
        near = subset.misfit < criteria.close_windows_misfit
        refits.append(CandidateFit(subset.effects, refit(candidate_set, subset.effects, subset.values, near=near)))
    refits = [r for r in refits if r.solution.misfit < step.solution.misfit]
    if not refits:
        return None

    def order(fit: CandidateFit) -> tuple[bool, int, float]:
        only_noise = consistent_with_noise(fit.solution)
        return not only_noise, len(fit.effects) if only_noise else 0, fit.solution.misfit

    best = min(refits, key=order)
    if consistent_with_noise(best.solution):
        solution = continue_to_convergence(candidate_set.problem, best.solution, candidate_set.train)
        best = CandidateFit(best.effects, solution)
    return best


def refit_without(candidate_set: CandidateSet, step: CandidateFit, rest: Sequence[str]) -> Solution:
    """The fit with the effects `rest` alone, from where that of `step` ended; taken up again where it is on its way."""
    solution = refit(candidate_set, rest, step.solution.values, step.solution.start)
    if solution.misfit < candidate_set.criteria.linear_misfit:
        return continue_to_convergence(candidate_set.problem, solution, candidate_set.train)
    return solution


def refit_to_convergence(candidate_set: CandidateSet, step: CandidateFit, progress: Progress) -> CandidateFit:
    """`step`, or a better optimum of the same model where it ended near the noise but not in it, or on the way."""
    if consistent_with_noise(step.solution):
        solution = continue_to_convergence(candidate_set.problem, step.solution, candidate_set.train)
        step = CandidateFit(step.effects, solution)
        if solution.converged and consistent_with_noise(solution):
            return step
    if not step.solution.misfit < candidate_set.criteria.far_misfit:
        return step
    again = fresh_fit(candidate_set, step.effects, step.solution.values, progress)
    return again if again.solution.misfit < step.solution.misfit else step
