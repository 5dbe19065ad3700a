"""One stage of an explanation: the model after a step, and how it fares."""

from collections.abc import Sequence
from typing import NamedTuple

from ._bench import LATERAL_SKID, Bench, Step
from ._estimates import Estimate, estimated
from ._fit import judged
from ._misfit import RunScore, Score, pooled, run_scores
from ._rank import Ranked
from ._study import Optimum


class Stage(NamedTuple):
    """The loop after one step: what was `added` or `dropped`, the fit, its scores, and the candidates beside it."""

    change: str
    name: str
    bench: Bench
    step: Step
    train: Score
    heldout: Score | None
    runs: tuple[RunScore, ...]
    estimates: dict[str, Estimate]
    ranking: tuple[Ranked, ...]
    judgement: Optimum | None
    """The held-out runs, opened once for this stage."""

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects in the model, `lateral_skid` among them where the structure was changed."""
        switched = (LATERAL_SKID,) if self.bench.switched else ()
        return (*switched, *self.step.effects)

    @property
    def left_out(self) -> dict[str, str]:
        """The candidates that were not ranked, with the reason: they do not apply, or these runs do not show them."""
        ranked = {candidate.effect for candidate in self.ranking} | set(self.step.effects)
        known = self.bench.study.model.effects
        silent = {name: known[name].silent for name in self.bench.candidates if name not in ranked}
        return self.bench.left_out | silent


def stage(bench: Bench, change: str, name: str, step: Step, ranking: Sequence[Ranked] = ()) -> Stage:
    """Judge `step`: train and held-out scores, estimates."""
    runs = run_scores(bench.study, step.optimum, bench.train)
    heldout = judged(bench.study, step.optimum.values)
    unseen = () if heldout is None else run_scores(bench.study, heldout, bench.study.numbered("heldout"))
    return Stage(
        change,
        name,
        bench,
        step,
        pooled(runs),
        pooled(unseen) if unseen else None,
        (*runs, *unseen),
        estimated(bench.study, step.optimum),
        tuple(ranking),
        heldout,
    )
