"""The ranking: candidates scored on short windows, the best of them refitted on whole runs."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ._bench import CLOSE, HOPELESS, LATERAL_SKID, WORKERS, Bench, Step
from ._misfit import only_noise
from ._prospects import Prospect, prospects
from ._refit import refit
from ._score import ALPHA, Scored, confusable
from ._study import Optimum

REFITTED = 3


class Ranked(NamedTuple):
    """One candidate at the base: the score test, and its refit where it was among the best."""

    effect: str
    score: Scored | None
    predicted_misfit: float | None
    refit: Optimum | None
    confusable_with: tuple[str, ...]
    prospect: Prospect | None = None

    @property
    def refit_misfit(self) -> float | None:
        """Train misfit of the refit on whole runs."""
        return None if self.refit is None else self.refit.misfit


def rank(
    bench: Bench, step: Step, *, refitted: int = REFITTED, progress: Callable[[str], None] = lambda _: None
) -> list[Ranked]:
    """All candidates beside `step`: scored, and the best `refitted` of them refitted on whole runs."""
    progress("scoring candidates")
    found = prospects(bench, step, progress)
    alike = confusable([p.score for p in found])
    sure = [p for p in found if p.score.p_value < ALPHA]
    best = min((p.misfit for p in sure), default=np.inf)
    # One that stays far behind the best on the windows is not worth the time of a refit.
    shortlist = sorted((p for p in sure if p.misfit - 1 < 3 * max(best - 1, 0.02)), key=lambda p: p.misfit)[:refitted]
    progress(f"refitting {len(shortlist)} candidates on whole runs")

    def again(prospect: Prospect) -> Optimum:
        near = prospect.misfit < CLOSE
        return refit(bench, [*step.effects, prospect.score.effect], prospect.values, near=near)

    with ThreadPoolExecutor(WORKERS) as pool:
        refits = dict(zip([p.score.effect for p in shortlist], pool.map(again, shortlist), strict=True))
    ranked = [
        Ranked(p.score.effect, p.score, p.misfit, refits.get(p.score.effect), tuple(alike[p.score.effect]), p)
        for p in found
    ]
    return sorted(ranked, key=_order)


def _order(ranked: Ranked) -> tuple[int, float]:
    if ranked.refit is not None and np.isfinite(ranked.refit.misfit):
        return 0, ranked.refit.misfit
    return 1, -(ranked.score.statistic if ranked.score else 0.0)


def promising(ranking: Sequence[Ranked]) -> list[Ranked]:
    """The refitted candidates in the order to try them: by refit where one comes near, else by the windows.

    Two refits that are both far from the recordings say little about which effect is missing.
    """
    refitted = [r for r in ranking if r.refit is not None and r.effect != LATERAL_SKID]
    if any(r.refit is not None and r.refit.misfit < HOPELESS for r in refitted):
        return refitted
    return sorted(refitted, key=lambda r: np.inf if r.predicted_misfit is None else r.predicted_misfit)


def significant(ranking: Sequence[Ranked]) -> bool:
    return any(r.score is not None and r.score.p_value < ALPHA for r in ranking)


def ends_in_noise(ranking: Sequence[Ranked]) -> bool:
    return any(r.refit is not None and only_noise(r.refit) for r in ranking)


def placed(ranking: Sequence[Ranked], new: Ranked) -> tuple[Ranked, ...]:
    """`ranking` with `new`, which has a refit, in its place."""
    refitted = [(r.refit.misfit, r) for r in (*ranking, new) if r.refit is not None]
    return (*(r for _, r in sorted(refitted, key=lambda pair: pair[0])), *(r for r in ranking if r.refit is None))
