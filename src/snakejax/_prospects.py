"""What each candidate promises, by its score and on short windows."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy import stats

from ._bench import CLOSE, NEARLY, WORKERS, Bench, Step
from ._score import ALPHA, Scored
from ._sight import Sight, tested
from ._study import DEPENDENT
from ._windows import Settled, linearised

SETTLED = 4


class Prospect(NamedTuple):
    """A candidate as its score sees it: where to start its refit, and the misfit to expect once it is in.

    `start`: where the windows start with it, if they have settled.
    """

    score: Scored
    values: dict[str, float]
    misfit: float
    start: np.ndarray | None = None


def sight(bench: Bench, values: Mapping[str, float], start: np.ndarray, windows: bool) -> Sight:
    """Every candidate beside the model at `values`, on `windows` or on whole train runs."""
    study = bench.windows.study if windows else bench.study
    runs = tuple(range(len(study.runs)) if windows else bench.train)
    return Sight(study, runs, values, start, linearised(study, values, start, runs))


def prospects(bench: Bench, step: Step, progress: Callable[[str], None] = lambda _: None) -> list[Prospect]:
    """The candidates beside `step`, the most promising first.

    Near the noise whole runs are scored. Further off windows are, after the fitted parameters have settled on them; and
    the best few candidates settle there too, each with its own parameters free, so that their order does not rest on a
    linear model.
    """
    remaining = {name: parts for name, parts in bench.candidates.items() if name not in step.effects}
    fitted = [name for name in bench.free(step.effects) if name not in step.optimum.held]
    near = step.optimum.misfit < NEARLY
    if near:
        values, start = step.optimum.values, step.optimum.start
    else:
        progress("settling on windows")
        settled = _settled(bench, step, fitted)
        values, start = settled.values, settled.start
    scores, chi2, dof = tested(sight(bench, values, start, not near), fitted, remaining, bench.probes())
    found = [Prospect(s, {**values, **s.values}, max(chi2 - s.reduction, 0.0) / dof) for s in scores]
    if near:
        return found
    return _settle_all(bench, found, remaining, fitted, values, start, chi2 / dof, dof, progress)


def _settled(bench: Bench, step: Step, fitted: Sequence[str]) -> Settled:
    """The fitted parameters on the windows, from where they are and from where the tyre began."""
    fresh = {**step.optimum.values, **{n: bench.study.values()[n] for n in bench.tyre}}
    with ThreadPoolExecutor(WORKERS) as pool:
        both = pool.map(lambda values: bench.windows.settle(values, fitted, rounds=15), (step.optimum.values, fresh))
    return min(both, key=lambda s: s.cost)


def _settle_all(bench, found, remaining, fitted, values, start, misfit, dof, progress) -> list[Prospect]:
    """The best of `found`, and those without a derivative at zero, settled on the windows; they come first."""
    close = [p for p in found if p.score.effect in _probed(bench)]
    close += [p for p in found if p not in close and p.score.p_value < ALPHA][:SETTLED]
    progress(f"settling {len(close)} candidates on windows")

    def beside(prospect: Prospect) -> dict[str, float]:
        # From where the others have settled, so that all move together; only what has no slope at zero starts off it.
        parts = remaining[prospect.score.effect]
        return {n: bench.off_zero(n, values[n]) if n in parts else values[n] for n in prospect.values}

    def settle(prospect: Prospect) -> Prospect:
        parts = remaining[prospect.score.effect]
        best = bench.windows.settle(beside(prospect), [*fitted, *parts], start, rounds=25)
        if best.cost / dof > misfit:
            return prospect._replace(misfit=misfit)
        changed = prospect.score._replace(values={n: best.values[n] for n in parts})
        if prospect.score.effect in _probed(bench):
            changed = _surer(changed, (misfit * dof - best.cost), best.cost / dof, len(parts), len(found))
        return Prospect(changed, best.values, best.cost / dof, best.start)

    with ThreadPoolExecutor(WORKERS) as pool:
        close = sorted(pool.map(settle, close), key=lambda p: p.misfit)
    done = {p.score.effect for p in close}
    return [*close, *(p for p in found if p.score.effect not in done)]


def _surer(scored: Scored, fall: float, left: float, count: int, family: int) -> Scored:
    """`scored` with the evidence of a settled fit, where it is the stronger: a candidate without a slope at its neutral
    value has no score there. Errors that are more than noise depend on each other.
    """
    statistic = fall / (max(left, 1.0) * (1.0 if left < CLOSE else DEPENDENT))
    if statistic <= scored.statistic:
        return scored
    p_value = min(1.0, family * float(stats.chi2.sf(statistic, count)))
    return scored._replace(statistic=statistic, p_value=min(p_value, scored.p_value))


def _probed(bench: Bench) -> set[str]:
    return {name.split(".")[1] for name in bench.probes()}
