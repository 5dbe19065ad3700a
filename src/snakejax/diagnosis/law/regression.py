"""The regression of a form of law on windows of a free force: at the starts of its shape, then with the shape refined,
then without the terms that predict nothing.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.formula import parsed
from snakejax.core.parallel import in_threads

from .terms import Family
from .windows import Calls, ForceWindows

ROUNDS = 12
"""Levenberg-Marquardt steps of a refinement, at most."""
PENALTIES = (0.0, 1e-4, 1e-2, 1.0)
"""Weights of the curvature of a smooth function: multiples of what one of its values alone adds to chi^2."""
BLOCK = 64
"""Values of a shape that are fitted at a time."""
FEWEST_CHI2 = 9.0
"""A term is left out where that raises chi^2 on runs left out by less than this: a likelihood ratio of exp(9 / 2)."""


class Trial(NamedTuple):
    """A form at one `shape`: its amplitudes, the steps of the other parameters, chi^2 of all runs, and that of each run
    under the fit to the others, summed."""

    family: Family
    shape: np.ndarray
    amplitudes: np.ndarray
    steps: np.ndarray
    chi2: float
    left_out: float


def named(family: Family, grid: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of `grid` (G, S), values of the shape of `family`, by name."""
    return {part.name: grid[:, k] for k, part in enumerate(family.shape)}


def form_at(
    windows: ForceWindows, family: Family, grid: np.ndarray, given: Sequence[np.ndarray], calls: Calls | None = None
) -> list[Trial]:
    """The fits of `family` at each row of `grid` (G, S) of its shape; a smooth function has none, and one fit, with the
    one of `PENALTIES` that predicts runs left out best. `calls`, see `ForceWindows.histories`."""
    own = windows.histories(family, named(family, grid), calls)
    penalty = None
    if family.curvature is not None:
        grid, beside = np.zeros((len(PENALTIES), 0)), sum(one.shape[1] for one in given)
        penalty = np.array(PENALTIES)[:, None, None] * np.pad(family.curvature, (0, beside))
    own = np.broadcast_to(own, (len(grid), *own.shape[1:]))
    others = [np.broadcast_to(one, (len(grid), *one.shape[1:])) for one in given]
    fit = windows.fitted(np.concatenate([own, *others], axis=1), penalty)
    T = len(family.terms)
    trials = [
        Trial(family, grid[g], fit.amplitudes[g, :T], fit.steps[g], float(fit.chi2[g]), float(fit.left_out[g]))
        for g in range(len(grid))
    ]
    return trials if penalty is None else [min(trials, key=lambda trial: trial.left_out)]


def on_grids(windows: ForceWindows, forms: Sequence[Family], given: Sequence[np.ndarray]) -> list[Trial]:
    """Of each form the best of the starts of its shape."""
    # Python 3.11 cannot parse in two threads: all formulas are read before.
    for family in forms:
        for _, formula in [*family.together, *(one for term in family.terms for one in term.formulas)]:
            parsed(formula or "1")
    # Forms of one shape, which differ in what acts, share the functions of it.
    alike: dict[tuple, list[Family]] = {}
    for family in forms:
        starts = tuple((part.name, part.starts) for part in family.shape)
        alike.setdefault((starts, family.also), []).append(family)
    trials = in_threads(lambda group: on_grid(windows, group, given), alike.values())
    return [best for group in trials for best in group]


def on_grid(windows: ForceWindows, alike: Sequence[Family], given: Sequence[np.ndarray]) -> list[Trial]:
    """Of each of the forms `alike`, whose shapes have the same starts, the one that predicts runs left out best. Beside
    a random force also the one that is nearest to all runs, if it is another: where one run alone shows a bump, the
    others do not predict it."""
    grid = alike[0].starts
    trials: list[list[Trial]] = [[] for _ in alike]
    for k in range(0, len(grid), BLOCK):
        calls: Calls = ({}, {})
        for family, own in zip(alike, trials, strict=True):
            own += form_at(windows, family, grid[k : k + BLOCK], given, calls)
    finite = [[trial for trial in own if np.isfinite(trial.left_out)] for own in trials]
    best = [min(own, key=lambda trial: trial.left_out) for own in finite if own]
    if windows.beside:
        nearest = [min(own, key=lambda trial: trial.chi2) for own in finite if own]
        best += [one for one, other in zip(nearest, best, strict=True) if one is not other]
    return best


def refined(windows: ForceWindows, trial: Trial, given: Sequence[np.ndarray]) -> Trial:
    """`trial` with its shape moved to the least chi^2 by Levenberg-Marquardt steps."""
    family, S, damping = trial.family, len(trial.family.shape), 1e-3
    if not S:
        return trial
    low, high = (np.array([getattr(part, side) for part in family.shape]) for side in ("low", "high"))
    T, P = len(family.terms), len(windows.prior_mean)
    for _ in range(ROUNDS):
        reach = 1e-4 * np.maximum(np.abs(trial.shape), 1e-3)
        grid = np.concatenate([trial.shape[None], trial.shape + np.diag(reach)])
        near = windows.histories(family, named(family, grid))
        slopes = np.einsum("t,stwk->swk", trial.amplitudes, near[1:] - near[:1]) / reach[:, None, None]
        matrix, right = windows.normal(np.concatenate([near[:1], slopes[None], *given], axis=1))
        A, b = matrix.sum(axis=0)[0], right.sum(axis=0)[0]
        A[range(P), range(P)] += windows.precision
        b[:P] += windows.precision * windows.prior_mean
        now = np.concatenate([trial.steps, trial.amplitudes, np.zeros(len(b) - P - T)])
        size = np.sqrt(np.maximum(np.diag(A), 1e-30))
        scaled = A / np.outer(size, size)
        step = np.linalg.lstsq(scaled + damping * np.eye(len(b)), (b - A @ now) / size, rcond=1e-12)[0] / size
        shape = np.clip(trial.shape + step[P + T : P + T + S], low, high)
        then = form_at(windows, family, shape[None], given)[0]
        if not then.chi2 < trial.chi2:
            damping *= 10
            if damping > 1e3:
                break
            continue
        gain, trial, damping = trial.chi2 - then.chi2, then, max(damping / 10, 1e-9)
        if gain < 0.1 + 1e-5 * trial.chi2:
            break
    return trial


def pruned(windows: ForceWindows, trial: Trial, given: Sequence[np.ndarray]) -> Trial:
    """`trial` without the terms that predict nothing on runs left out."""
    while len(trial.family.terms) > 1 and not trial.family.whole:
        worth = max(FEWEST_CHI2, 0.02 * (trial.left_out - windows.samples))
        terms = trial.family.terms
        fewer = [trial.family._replace(terms=(*terms[:k], *terms[k + 1 :])) for k in range(len(terms))]
        shorter = [form_at(windows, family, trial.shape[None], given)[0] for family in fewer]
        best = min(shorter, key=lambda one: one.left_out)
        if best.left_out > trial.left_out + worth:
            break
        trial = refined(windows, best, given)
    return trial


def with_positive_amplitude(windows: ForceWindows, trial: Trial) -> Trial:
    """`trial`, whose first amplitude is not negative where one of its angles turns its sign: a sin(k x + q) is
    -a sin(k x + q + pi)."""
    if not trial.amplitudes.size or trial.amplitudes[0] >= 0:
        return trial
    for k, part in enumerate(trial.family.shape):
        if part.unit == {"rad": 1}:
            turned = trial.shape.copy()
            turned[k] = (turned[k] + np.pi) % (2 * np.pi)
            now, opposite = windows.histories(trial.family, named(trial.family, np.stack([trial.shape, turned])))
            if np.allclose(now, -opposite, rtol=0, atol=1e-9 * np.abs(now).max()):
                return trial._replace(shape=turned, amplitudes=-trial.amplitudes)
    return trial
