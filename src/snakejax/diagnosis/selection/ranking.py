"""The ranking: candidates scored on short windows, the best of them refitted on whole runs."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.parallel import in_threads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.problem import Solution
from snakejax.estimation.uncertainty import Estimate, estimates_of

from .candidates import CandidateFit, CandidateSet
from .criteria import CRITERIA, SelectionCriteria
from .refit import is_worse, no_worse, refit
from .score_test import ScoreTest, confusable
from .screening import ScreenedCandidate, screen_candidates


class RankedCandidate(NamedTuple):
    """One candidate at the base: the score test, and its refit where it was among the best.

    `failed`: the refit ended further off than the base, which it contains, and says nothing. `refitted`: the parameters
    of the candidate where its refit ended.
    """

    effect: str
    score: ScoreTest | None
    predicted_misfit: float | None
    refit: Solution | None
    confusable_with: tuple[str, ...]
    prospect: ScreenedCandidate | None = None
    failed: bool = False
    refitted: dict[str, Estimate] | None = None

    @property
    def refit_misfit(self) -> float | None:
        """Train misfit of the refit on whole runs."""
        return None if self.refit is None else self.refit.misfit

    @property
    def windows_chi2(self) -> float | None:
        """chi^2 of windows to which the candidate was fitted; None where it was scored alone."""
        return self.prospect.chi2 if self.prospect is not None and self.prospect.is_fitted else None


def rank(
    candidate_set: CandidateSet,
    step: CandidateFit,
    *,
    refitted: int | None = None,
    explained: Callable[[], bool] = lambda: False,
    progress: Progress = no_progress,
) -> list[RankedCandidate]:
    """All candidates beside `step`: scored, the best `refitted` (`candidates_refitted`) also refitted on whole runs.

    Not refitted is what can no longer be the explanation: where a model leaves only noise of whole runs, the best
    candidate or one of another structure (`explained`), a candidate that windows distinguish from it.
    """
    criteria = candidate_set.criteria
    most = criteria.candidates_refitted if refitted is None else refitted
    progress(ProgressEvent(Phase.SCORE_TESTS))
    screened = screen_candidates(candidate_set, step, progress)
    alike = confusable([p.score for p in screened], criteria)
    sure = [p for p in screened if p.score.p_value < criteria.significance_level]
    best = min((p.misfit for p in sure), default=np.inf)
    # One that stays far behind the best on the windows is not worth the time of a refit.
    most_excess = criteria.candidate_excess_ratio * max(best - 1, criteria.smallest_excess)
    shortlist = sorted((p for p in sure if p.misfit - 1 < most_excess), key=lambda p: p.misfit)[:most]
    progress(ProgressEvent(Phase.REFITTING_CANDIDATES, f"refitting {len(shortlist)} candidates on whole runs"))

    refits = _refits(candidate_set, step, shortlist, explained)

    def ranked(p: ScreenedCandidate) -> RankedCandidate:
        effect, fit = p.score.effect, refits.get(p.score.effect)
        one = RankedCandidate(effect, p.score, p.misfit, fit, tuple(alike[effect]), p)
        if fit is None:
            return one
        if is_worse(fit, step.solution, criteria):
            return one._replace(refit=None, failed=True)
        return one._replace(
            refitted={n: e for n, e in estimates_of(candidate_set.problem, fit).items() if n in p.score.values}
        )

    return sorted(map(ranked, screened), key=_order)


def _refits(
    candidate_set: CandidateSet,
    step: CandidateFit,
    shortlist: Sequence[ScreenedCandidate],
    explained: Callable[[], bool],
) -> dict[str, Solution]:
    """The fits to whole runs of those in `shortlist` that may be the explanation, by effect; see `rank`."""
    criteria = candidate_set.criteria

    def again(candidate: ScreenedCandidate) -> Solution:
        effects, near = [*step.effects, candidate.score.effect], candidate.misfit < criteria.close_windows_misfit
        solution = refit(candidate_set, effects, candidate.values, near=near)
        return no_worse(candidate_set, step, effects, solution)

    refits: dict[str, Solution] = {}
    if shortlist and shortlist[0].leaves_only_noise:
        first, *others = shortlist
        refits[first.score.effect] = again(first)
        if consistent_with_noise(refits[first.score.effect]):
            others = [c for c in others if not c.is_fitted or c.chi2 - first.chi2 < criteria.distinct_chi2]
    else:
        others = list(shortlist)
        if others and explained():
            others = [c for c in others if c.leaves_only_noise]
    return refits | dict(zip([c.score.effect for c in others], in_threads(again, others), strict=True))


def _order(ranked: RankedCandidate) -> tuple[int, float]:
    if ranked.refit is not None and np.isfinite(ranked.refit.misfit):
        return 0, ranked.refit.misfit
    return 1, -(ranked.score.statistic if ranked.score else 0.0)


def trial_order(ranking: Sequence[RankedCandidate], criteria: SelectionCriteria = CRITERIA) -> list[RankedCandidate]:
    """The refitted candidates in the order to try them: by refit where one comes near, else by the windows.

    Two refits that are both far from the recordings say little about which effect is missing.
    """
    refitted = [r for r in ranking if r.refit is not None and r.effect != LATERAL_SLIP_SWITCH]
    if any(r.refit is not None and r.refit.misfit < criteria.far_misfit for r in refitted):
        return refitted
    return sorted(refitted, key=lambda r: np.inf if r.predicted_misfit is None else r.predicted_misfit)


def significant(ranking: Sequence[RankedCandidate], criteria: SelectionCriteria = CRITERIA) -> bool:
    return any(r.score is not None and r.score.p_value < criteria.significance_level for r in ranking)


def any_refit_consistent(ranking: Sequence[RankedCandidate]) -> bool:
    return any(r.refit is not None and consistent_with_noise(r.refit) for r in ranking)


def insert_by_refit(ranking: Sequence[RankedCandidate], new: RankedCandidate) -> tuple[RankedCandidate, ...]:
    """`ranking` with `new`, which has a refit, in its place."""
    refitted = [(r.refit.misfit, r) for r in (*ranking, new) if r.refit is not None]
    return (*(r for _, r in sorted(refitted, key=lambda pair: pair[0])), *(r for r in ranking if r.refit is None))
