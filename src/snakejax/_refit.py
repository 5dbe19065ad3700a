"""Fits of the base and of models with more effects, from windows to whole train runs."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ._approach import approach, followed, least, require_sensitive, require_sound, settled
from ._bench import CLOSE, HOPELESS, Bench
from ._misfit import only_noise
from ._study import Optimum

CRAWL = 2e-3
"""A model that is not the truth is fitted no further where a step lowers its misfit by less than this share."""


def base_fit(bench: Bench, effects: Sequence[str] = (), progress: Callable[[str], None] = lambda _: None) -> Optimum:
    """The base: the tyre, and `effects` put in from the start, fitted to windows and then to whole train runs."""
    require_sensitive(bench.study, bench.study.values(), bench.tyre, bench.train)
    return require_sound(bench.study, fresh_fit(bench, effects, bench.study.values(), progress), bench.train)


def fresh_fit(
    bench: Bench, effects: Sequence[str], values: Mapping[str, float], progress: Callable[[str], None] = lambda _: None
) -> Optimum:
    """The tyre fitted from where it began, and `effects` from `values`, to windows and then to whole train runs.

    Windows settle from two sizes of the tyre force. Where the fit ends near the noise but not in it, or not at all, the
    growing horizon is tried too: it may have missed the optimum, which must not be taken for a missing effect.
    """
    study, train, free = bench.study, bench.train, bench.free(effects)
    progress("fitting windows")
    began = {name: study.values()[name] for name in bench.tyre}
    values = {name: bench.off_zero(name, value) if name in free else value for name, value in values.items()} | began
    best = settled(bench.windows, values, free)
    progress("fitting whole runs")
    misfit = best.cost / max(best.found.residual.size, 1)
    found = refit(bench, effects, best.values, near=misfit < CLOSE)
    if (only_noise(found) and found.converged) or not found.misfit < HOPELESS:
        return found
    first = approach(study, values, free, train, progress)
    found = least(found, study.fit(first.values, free, train, first.start, crawl=CRAWL, most=30))
    return followed(study, found, train) if only_noise(found) else found


def refit(
    bench: Bench,
    effects: Sequence[str],
    values: Mapping[str, float],
    start: np.ndarray | None = None,
    *,
    near: bool = True,
) -> Optimum:
    """Fit a model with `effects` to whole train runs from `values`, and from `start` where it is known.

    Where windows leave little, the values there are `near` the optimum. Else the fit goes over a growing horizon, and
    stops early while the model stays far off: polishing it would only make its parameters absurd.
    """
    free, train = bench.free(effects), bench.train
    neutral = bench.study.values()
    known = {name: (values[name] if name in free else neutral[name]) for name in bench.study.names}
    known = {name: bench.off_zero(name, value) if name in free else value for name, value in known.items()}
    if near:
        found = bench.study.fit(known, free, train, start, crawl=CRAWL, most=30)
        if found.misfit < HOPELESS:
            return found
    first = bench.study.fit(known, free, train, until=4.0, enough=1.0, weak_prior=True, most=6)
    rough = bench.study.fit(first.values, free, train, first.start, enough=1.0, weak_prior=True, most=4)
    if not rough.misfit < HOPELESS:
        return rough
    return bench.study.fit(rough.values, free, train, rough.start, crawl=CRAWL, most=30)
