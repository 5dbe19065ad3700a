"""Adding what helps most, one effect after the other or several at once, and trying to do without each."""

from collections.abc import Sequence

import numpy as np

from ._acceptance import better, by_chance, certain
from ._accomplices import FAR, accomplices
from ._approach import followed, least
from ._bench import CLOSE, HOPELESS, NEARLY, Bench, Step
from ._misfit import only_noise
from ._rank import Ranked, ends_in_noise, promising, rank, significant
from ._refit import CRAWL, fresh_fit, refit
from ._stage import Stage, stage
from ._study import Optimum

MOST_EFFECTS = 4


def follow(bench, step, ranking, before, progress, show) -> list[Stage]:
    """Add what helps most, one effect after the other, then try to do without each."""
    stages = list(before)
    if step.optimum.misfit > NEARLY and not ends_in_noise(ranking):
        path, hopeless = _together(bench, step, ranking, progress)
        for name, then, ranks in path:
            step, ranking = then, ranks
            stages.append(stage(bench, "added", name, step, ranking))
            show(stages[-1])
        if hopeless:
            # No set of effects explains even the windows: which of them help a little is not worth the time.
            return stages
    while len(step.effects) < MOST_EFFECTS and not (only_noise(step.optimum) and not significant(ranking)):
        found = None
        for candidate in promising(ranking):
            then = Step((*step.effects, candidate.effect), candidate.refit)
            progress(f"does {candidate.effect} predict runs it has not seen?")
            if better(bench, step, then):
                found = (candidate.effect, then)
                break
        if found is None:
            break
        name, step = found[0], _polished(bench, found[1], progress)
        ranking = tuple(rank(bench, step, progress=progress))
        stages.append(stage(bench, "added", name, step, ranking))
        show(stages[-1])
    for name in step.effects:
        if len(step.effects) < 2 or certain(bench, step, name):
            continue
        progress(f"can the model do without {name}?")
        rest = tuple(effect for effect in step.effects if effect != name)
        without = Step(rest, _settled_without(bench, step, rest))
        lost = step.optimum.samples * (without.optimum.misfit - step.optimum.misfit)
        freed = len(step.optimum.free) - len(without.optimum.free)
        if lost / max(1.0, step.optimum.misfit) < by_chance(freed):
            step = without
            stages.append(stage(bench, "dropped", name, step))
            show(stages[-1])
    return stages


def _together(bench, step, ranking, progress) -> tuple[list[tuple[str, Step, tuple[Ranked, ...]]], bool]:
    """The steps to the set of effects that explains the windows together and whole runs best, or none; and whether they
    end far from the recordings and no set explains even the windows.

    Far from the recordings whole runs cannot say which of two missing effects comes first; short windows can say which
    pair leaves least.
    """
    first = [r.prospect for r in sorted(ranking, key=lambda r: r.predicted_misfit or np.inf) if r.prospect is not None]
    sets = accomplices(bench, step, first, len(step.effects) + 3, progress)
    best_on_windows = sets[0].misfit if sets else np.inf

    def hopeless(last: Step) -> bool:
        return best_on_windows > FAR and not last.optimum.misfit < HOPELESS

    tried = [s for s in sets if s.misfit - 1 < 2 * max(best_on_windows - 1, 0.02)][:3]
    progress(f"refitting {len(tried)} sets of effects on whole runs")
    refits = [Step(s.effects, refit(bench, s.effects, s.values, near=s.misfit < CLOSE)) for s in tried]
    refits = [r for r in refits if r.optimum.misfit < step.optimum.misfit]
    if not refits:
        return [], hopeless(step)
    best = min(
        refits,
        key=lambda r: (not only_noise(r.optimum), len(r.effects) if only_noise(r.optimum) else 0, r.optimum.misfit),
    )
    if only_noise(best.optimum):
        best = Step(best.effects, followed(bench.study, best.optimum, bench.train))
    if not better(bench, step, best):
        return [], hopeless(step)
    path, before = [], step
    for count in range(len(step.effects) + 1, len(best.effects)):
        part = best.effects[:count]
        before = Step(part, _no_worse(bench, before, part, refit(bench, part, best.optimum.values, near=False)))
        path.append((part[-1], before, ()))
    ranks = () if hopeless(best) else tuple(rank(bench, best, progress=progress))
    path.append((best.effects[-1], best, ranks))
    return path, hopeless(best)


def _no_worse(bench: Bench, before: Step, effects: Sequence[str], found: Optimum) -> Optimum:
    """The fit with `effects`, which hold those of `before`: as it was `found`, or from where that step ended."""
    if found.misfit <= before.optimum.misfit:
        return found
    values = {n: bench.off_zero(n, v) if n in bench.free(effects) else v for n, v in before.optimum.values.items()}
    return least(found, bench.study.fit(values, bench.free(effects), bench.train, before.optimum.start, crawl=CRAWL))


def _settled_without(bench: Bench, step: Step, rest: Sequence[str]) -> Optimum:
    """The fit with the effects `rest` alone, from where that of `step` ended; taken up again where it is on its way."""
    found = refit(bench, rest, step.optimum.values, step.optimum.start)
    return followed(bench.study, found, bench.train) if found.misfit < NEARLY else found


def _polished(bench: Bench, step: Step, progress) -> Step:
    """`step`, or a better optimum of the same model where it ended near the noise but not in it, or on the way."""
    if only_noise(step.optimum):
        step = Step(step.effects, followed(bench.study, step.optimum, bench.train))
    if (only_noise(step.optimum) and step.optimum.converged) or not step.optimum.misfit < HOPELESS:
        return step
    again = fresh_fit(bench, step.effects, step.optimum.values, progress)
    return Step(step.effects, least(step.optimum, again))
