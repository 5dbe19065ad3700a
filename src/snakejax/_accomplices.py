"""Effects that act together: sets of candidates, searched on short windows."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ._bench import WORKERS, Bench, Step
from ._prospects import Prospect, sight
from ._score import Scored
from ._sight import tested

FAR = 1.1
"""Above this misfit of the windows, they are searched for a further effect before whole runs are believed."""
BEAM = 3
GAIN = 0.9
"""A further effect must lower the excess of the windows' misfit over noise to this share, or the search ends."""


class Suspects(NamedTuple):
    """A set of effects that together explain the windows, with the values found there and the misfit they leave."""

    effects: tuple[str, ...]
    values: dict[str, float]
    misfit: float
    start: np.ndarray | None


def accomplices(
    bench: Bench, step: Step, first: Sequence[Prospect], most: int, progress: Callable[[str], None] = lambda _: None
) -> list[Suspects]:
    """Sets of effects, searched on the windows alone: the best few of each size, until one leaves little.

    An effect that comes first by itself need not belong to the best pair, so several are followed.
    """
    beam = [Suspects((*step.effects, p.score.effect), p.values, p.misfit, p.start) for p in first[:BEAM]]
    everything = list(beam)
    while beam and beam[0].misfit > FAR and len(beam[0].effects) < most:
        grown: list[Suspects] = []
        for suspects in beam:
            progress(f"who acts beside {' and '.join(suspects.effects)}?")
            grown += _grown(bench, suspects, {frozenset(g.effects) for g in grown})
        grown = sorted(grown, key=lambda g: g.misfit)[:BEAM]
        if not grown or grown[0].misfit - 1 > GAIN * (beam[0].misfit - 1):
            break
        beam = grown
        everything += beam
    return sorted(everything, key=lambda g: g.misfit)


def _grown(bench: Bench, suspects: Suspects, known: set[frozenset[str]]) -> list[Suspects]:
    """`suspects` and one more, for the few that promise most."""
    free = bench.free(suspects.effects)
    settled = bench.windows.settle(suspects.values, free, suspects.start, rounds=12)
    remaining = {n: parts for n, parts in bench.candidates.items() if n not in suspects.effects}
    scores, _, dof = tested(sight(bench, settled.values, settled.start, True), free, remaining, bench.probes())
    new = [s for s in scores if frozenset((*suspects.effects, s.effect)) not in known][:BEAM]

    def settle(s: Scored) -> Suspects:
        begin = {**settled.values, **{n: bench.off_zero(n, settled.values[n]) for n in s.values}}
        best = bench.windows.settle(begin, [*free, *remaining[s.effect]], settled.start, rounds=25)
        return Suspects((*suspects.effects, s.effect), best.values, best.cost / dof, best.start)

    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(settle, new))
