"""Effects that act together: sets of candidates, searched on short windows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.parallel import in_threads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress

from .candidates import CandidateFit, CandidateSet
from .score_test import ScoreTest, tested
from .screening import ScreenedCandidate, window_sensitivities


class CandidateSubset(NamedTuple):
    """A set of effects that together explain the windows, with the values found there and the misfit they leave, that
    of noise unless stated."""

    effects: tuple[str, ...]
    values: dict[str, float]
    misfit: float = 1.0
    start: np.ndarray | None = None


def beam_search(
    candidate_set: CandidateSet,
    step: CandidateFit,
    first: Sequence[ScreenedCandidate],
    most: int,
    progress: Progress = no_progress,
) -> list[CandidateSubset]:
    """Sets of effects, searched on the windows alone: the best few of each size, until one leaves little.

    An effect that comes first by itself need not belong to the best pair, so several are followed.
    """
    criteria = candidate_set.criteria
    width = criteria.beam_width
    beam = [CandidateSubset((*step.effects, p.score.effect), p.values, p.misfit, p.start) for p in first[:width]]
    subsets = list(beam)
    while beam and beam[0].misfit > criteria.explained_windows_misfit and len(beam[0].effects) < most:
        extended: list[CandidateSubset] = []
        for subset in beam:
            progress(
                ProgressEvent(Phase.BEAM_SEARCH, f"which effect acts together with {' and '.join(subset.effects)}?")
            )
            extended += _extended(candidate_set, subset, {frozenset(g.effects) for g in extended})
        extended = sorted(extended, key=lambda g: g.misfit)[:width]
        if not extended or extended[0].misfit - 1 > criteria.further_excess_ratio * (beam[0].misfit - 1):
            break
        beam = extended
        subsets += beam
    return sorted(subsets, key=lambda g: g.misfit)


def _extended(
    candidate_set: CandidateSet, subset: CandidateSubset, known: set[frozenset[str]]
) -> list[CandidateSubset]:
    """`subset` and one more, for the few that promise most."""
    free = candidate_set.free(subset.effects)
    settled = candidate_set.windows.settle(subset.values, free, subset.start, rounds=12)
    remaining = {n: parts for n, parts in candidate_set.candidates.items() if n not in subset.effects}
    scores, _, dof = tested(
        window_sensitivities(candidate_set, settled.values, settled.start, True),
        free,
        remaining,
        candidate_set.probes(),
        candidate_set.criteria,
    )
    new = [s for s in scores if frozenset((*subset.effects, s.effect)) not in known][
        : candidate_set.criteria.beam_width
    ]

    def settle(s: ScoreTest) -> CandidateSubset:
        begin = {**settled.values, **{n: candidate_set.off_zero(n, settled.values[n]) for n in s.values}}
        best = candidate_set.windows.settle(begin, [*free, *remaining[s.effect]], settled.start, rounds=25)
        return CandidateSubset((*subset.effects, s.effect), best.values, best.cost / dof, best.start)

    return in_threads(settle, new)
