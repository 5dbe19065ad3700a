"""The way to the optimum: over the first seconds or windows of the runs, from several starts."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ._errors import FitError
from ._least_squares import domains_of, starts_removed
from ._study import Optimum, Study
from ._windows import LENGTH, Settled, Windows

TOLD, LONGEST = 3.0, 0.01
"""A step that tells whether derivatives hold moves all residuals by so many standard deviations; and its longest."""
WEAKER = 0.25
"""The second size of the tyre force from which windows settle."""
HORIZONS = (1.5, 4.0)
"""The first seconds [s] on which a fit finds its way before it takes whole runs: errors have not grown there yet."""
GOOD_START = 1.1
ROUNDS, WORTHWHILE = 8, 0.5
"""A fit that has not converged is taken up so many times, while that lowers chi^2 by more than this."""


def approach(
    study: Study,
    values: Mapping[str, float],
    free: Sequence[str],
    runs: Sequence[int],
    progress: Callable[[str], None] = lambda _: None,
) -> Optimum:
    """Find the way to the optimum over the first seconds of the runs, from several starts where the first fails."""

    def first(candidate: Mapping[str, float]) -> Optimum:
        return study.fit(candidate, free, runs, until=HORIZONS[0], enough=2.0, weak_prior=True, most=10)

    progress("first seconds")
    require_sensitive(study, values, free, runs)
    best = first(values)
    if not best.misfit < GOOD_START:
        others = other_starts(study, values, free)
        costs = [_cost(study, other, runs, HORIZONS[0]) for other in others]
        for k in np.argsort(costs)[:2]:
            best = min(best, first(others[k]), key=study.plausibility)
    for until in HORIZONS[1:]:
        progress(f"first {until:g} seconds")
        best = study.fit(best.values, free, runs, best.start, until=until, enough=1.0, weak_prior=True, most=10)
    return best


def other_starts(study: Study, values: Mapping[str, float], free: Sequence[str]) -> list[dict[str, float]]:
    """Starts around `values`: its multiplicative tyre parameters without a typical value, times and over 3 and 9."""
    domains = dict(zip(free, domains_of(study.model, free), strict=True))
    wide = [n for n in free if n.startswith("tyre.") and domains[n].multiplicative and domains[n].typical is None]
    factors = itertools.product((1 / 3, 1.0, 3.0) if len(wide) > 1 else (1 / 9, 1 / 3, 3.0, 9.0), repeat=len(wide))
    return [
        {**values, **{n: values[n] * f for n, f in zip(wide, combination, strict=True)}}
        for combination in factors
        if any(f != 1.0 for f in combination)
    ]


def _cost(study: Study, values: Mapping[str, float], runs: Sequence[int], until: float) -> float:
    residual = study.evaluate(study.at(values, ()), runs, until).residual[list(runs)]
    cost = float((residual**2).sum())
    return cost if np.isfinite(cost) else np.inf


def shot(study: Study, free: Sequence[str], runs: Sequence[int], threshold: float, progress) -> Optimum:
    """The fit that short windows lead to, each with a start of its own: whole runs of a model that lacks something say
    little about its parameters.
    """
    progress("fitting windows")
    pieces = [study.runs[k] for k in runs]
    windows = Windows.of(study.model, pieces, study.noise, study.names, study.width, LENGTH)
    found = settled(windows, study.values(), free)
    progress("fitting whole runs")
    return study.fit(found.values, free, runs, threshold=threshold)


def settled(windows: Windows, values: Mapping[str, float], free: Sequence[str]) -> Settled:
    """`windows` settled from `values`, and from a weaker tyre force where it is free: the better of both."""
    weaker = {n: v * WEAKER if n in free and n in ("tyre.D", "tyre.k_s") else v for n, v in values.items()}
    with ThreadPoolExecutor() as pool:
        return min(pool.map(lambda start: windows.settle(start, free), (values, weaker)), key=lambda s: s.cost)


def followed(study: Study, optimum: Optimum, runs: Sequence[int], threshold: float = np.inf) -> Optimum:
    """`optimum` taken up again until it converges, or gets no further: along a narrow valley that bends each step is
    short, and a fit that stops on the way has errors that know nothing of the rest.
    """
    for _ in range(ROUNDS):
        if optimum.converged:
            break
        further = study.fit(optimum.values, optimum.free, runs, optimum.start, threshold=threshold)
        gained = optimum.samples * (optimum.misfit - further.misfit)
        optimum = least(optimum, further)
        if not gained > WORTHWHILE:
            break
    return optimum


def arrived(study: Study, optimum: Optimum, runs: Sequence[int]) -> bool:
    """Whether a fit has converged, or has stopped where a whole step promises less than 1 in chi^2, so that no value
    would move by a standard error.
    """
    if optimum.converged:
        return True
    columns = [optimum.free.index(name) for name in optimum.loose]
    free_start = np.asarray(study.batch.free_start)
    parts = [starts_removed(optimum.linearised, k, study.width, free_start) for k in runs]
    slope = sum((J[:, columns].T @ r for r, J in parts), np.zeros(len(columns)))
    return bool(slope @ optimum.covariance @ slope < 1.0)


def least(*optima: Optimum) -> Optimum:
    """The one of least misfit; one that is not finite only where none is."""
    return min(optima, key=lambda one: one.misfit if np.isfinite(one.misfit) else np.inf)


def require_sensitive(study: Study, values: Mapping[str, float], free: Sequence[str], runs: Sequence[int]) -> None:
    """**Raises:** `FitError` where the simulation fails at the start, or a free parameter moves nothing."""
    found = study.evaluate(study.at(values, free), runs, HORIZONS[0])
    for k in runs:
        if not np.isfinite(found.residual[k]).all():
            raise FitError(
                f"The simulation of run `{study.runs[k].name}` fails in its first {HORIZONS[0]:g} s "
                "at the start values: check the board and the start."
            )
    sizes = np.sqrt((found.jacobian[list(runs)][..., : len(free)] ** 2).sum(axis=(0, 1, 2)))
    for name, size in zip(free, sizes, strict=True):
        if not size > 1e-9:
            raise FitError(f"Parameter `{name}` moves nothing in these runs, so it cannot be fitted: leave it fixed.")


def unsound(study: Study, optimum: Optimum, runs: Sequence[int]) -> str | None:
    """A parameter by which the derivatives are not those of the simulation, if there is one.

    Where a stiff simulation steps at the limit of its stability it is right, but its derivatives may grow without
    bound, and a fit would seem as sure. So a step that should move the residuals by `TOLD` is taken, and must do so.
    """
    before = optimum.linearised.residual[list(runs)]
    for row, (name, domain) in enumerate(zip(optimum.free, domains_of(study.model, optimum.free), strict=True)):
        if name in optimum.held:
            continue
        column = optimum.linearised.jacobian[list(runs)][..., row]
        step = TOLD / max(float(np.sqrt((column**2).sum())), TOLD / LONGEST)
        value = optimum.values[name]
        step = step if domain.low <= domain.moved(value, step) <= domain.high else -step
        at = study.at({**optimum.values, name: domain.moved(value, step)}, (), optimum.start)
        change = study.evaluate(at, runs).residual[list(runs)] - before
        if not np.sqrt(((change - step * column) ** 2).sum()) < TOLD / 2:
            return name
    return None


def require_sound(study: Study, optimum: Optimum, runs: Sequence[int]) -> Optimum:
    """`optimum`. **Raises:** `FitError` where it is not finite, with the run that fails."""
    for k in runs:
        if not np.isfinite(optimum.linearised.residual[k]).all():
            raise FitError(f"The simulation of run `{study.runs[k].name}` diverges: fix a parameter or the start.")
    return optimum
