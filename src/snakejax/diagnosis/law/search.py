"""A sparse search for the law of a free force: every form of the grammar is fitted on the windows of some runs and
tested on those of the other runs.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from snakejax.dynamics.law import LawParameter

from .grammar import Family, families
from .units import unit_text
from .windows import ForceWindows

REFINED = 40
"""So many forms have the parameters of their shape refined."""
ROUNDS = 12
"""Levenberg-Marquardt steps of such a refinement, at most."""
BLOCK = 64
"""Values of a shape that are fitted at a time."""
FEWEST_CHI2 = 9.0
"""A term is left out where that raises chi^2 on runs left out by less than this: a likelihood ratio of exp(9 / 2)."""
KEPT = 6
"""The largest number of proposed laws."""


GENERAL = {
    **{"x": "world_position", "y": "world_position", "u": "speed", "w": "speed", "theta": "heading"},
    **{"slip_speed": "slip", "slip_angle": "slip"},
}
"""How results name a variable of the grammar, where they do not name it as the grammar does."""
UNNAMED = ("r",)


class ProposedLaw(NamedTuple):
    """A law that the windows propose: `expression` with `parameters`, its default values those found.

    `left_out`: the misfit that it leaves on runs it was not fitted to; `score`: chi^2 there and what its parameters and
    the choice among all forms cost; `steps` (P,): how the other parameters move with it; `share`: of what is above the
    noise there without a law, the part that it takes away.
    """

    expression: str
    parameters: tuple[LawParameter, ...]
    values: dict[str, float]
    family: Family
    shape: np.ndarray
    left_out: float
    score: float
    steps: np.ndarray
    share: float = 1.0

    @property
    def variables(self) -> tuple[str, ...]:
        """The variables on which it depends, as results name them; none for those that have no such name."""
        return tuple(dict.fromkeys(GENERAL.get(name, name) for name in self.family.variables if name not in UNNAMED))


class _Trial(NamedTuple):
    family: Family
    shape: np.ndarray
    amplitudes: np.ndarray
    steps: np.ndarray
    chi2: float
    left_out: float


NO_LAW = Family("nothing", "", (), ())


def search(windows: ForceWindows, beside: Sequence[tuple[Family, np.ndarray]] = ()) -> tuple[ProposedLaw, ...]:
    """The laws that predict runs left out best, the best first; none where no law predicts them better than nothing.

    Of laws that do not differ by `FEWEST_CHI2` from the best, the one with the fewest parameters is first.
    `beside`: forms, with the values of their shape, that are in the regression whatever else is.
    """
    given = [windows.histories(family, _named(family, shape[None])) for family, shape in beside]
    forms = list(families(windows.ranges(), windows.wheel))
    trials = [best for family in forms if (best := _on_grid(windows, family, given)) is not None]
    trials.sort(key=lambda trial: trial.left_out)
    refined = [_pruned(windows, _refined(windows, trial, given), given) for trial in trials[:REFINED]]
    nothing = _at(windows, NO_LAW, np.zeros((1, 0)), given)[0]
    laws: dict[str, ProposedLaw] = {}
    for trial in refined:
        variance = max(1.0, trial.left_out / windows.samples)
        score = trial.left_out + variance * chance(trial.family, len(forms))
        if score < nothing.left_out:
            excess = max(nothing.left_out - windows.samples, 1e-9)
            share = float(np.clip((nothing.left_out - trial.left_out) / excess, 0.0, 1.0))
            law = _proposed(trial, windows.samples, score)._replace(share=share)
            if law.expression not in laws or score < laws[law.expression].score:
                laws[law.expression] = law
    return tuple(_simplest_first(sorted(laws.values(), key=lambda law: law.score))[:KEPT])


def _simplest_first(ordered: list[ProposedLaw]) -> list[ProposedLaw]:
    """`ordered` by score, but for the one in front: that with the fewest parameters of all that do as well."""
    as_good = [law for law in ordered if law.score - ordered[0].score < FEWEST_CHI2]
    simplest = min(as_good, key=lambda law: len(law.parameters), default=None)
    return ordered if simplest is None else [simplest, *(law for law in ordered if law is not simplest)]


def chance(family: Family, forms: int) -> float:
    """What the best of so many `forms` gains in chi^2 on runs left out by chance, with the terms of `family`.

    chi^2 of T amplitudes exceeds its quantile at 1 - 1 / N in one of N trials. Each start of the shape is a trial, and
    an amplitude that fits chance costs 1 on runs left out.
    """
    trials = forms * np.prod([len(part.starts) for part in family.shape])
    return float(stats.chi2.isf(1.0 / trials, len(family.terms)) - len(family.terms))


def _named(family: Family, grid: np.ndarray) -> dict[str, np.ndarray]:
    return {part.name: grid[:, k] for k, part in enumerate(family.shape)}


def _at(windows: ForceWindows, family: Family, grid: np.ndarray, given: Sequence[np.ndarray]) -> list[_Trial]:
    """The fits of `family` at each row of `grid` (G, S) of its shape."""
    own = windows.histories(family, _named(family, grid))
    own = np.broadcast_to(own, (len(grid), *own.shape[1:]))
    others = [np.broadcast_to(one, (len(grid), *one.shape[1:])) for one in given]
    fit = windows.fitted(np.concatenate([own, *others], axis=1))
    T = len(family.terms)
    return [
        _Trial(family, grid[g], fit.amplitudes[g, :T], fit.steps[g], float(fit.chi2[g]), float(fit.left_out[g]))
        for g in range(len(grid))
    ]


def _on_grid(windows: ForceWindows, family: Family, given: Sequence[np.ndarray]) -> _Trial | None:
    """The best of the starts of the shape of `family`."""
    rows = list(itertools.product(*(part.starts for part in family.shape)))
    grid = np.array(rows, float).reshape(len(rows), len(family.shape))
    blocks = [grid[k : k + BLOCK] for k in range(0, len(grid), BLOCK)]
    trials = [trial for block in blocks for trial in _at(windows, family, block, given)]
    trials = [trial for trial in trials if np.isfinite(trial.left_out)]
    return min(trials, key=lambda trial: trial.left_out, default=None)


def _refined(windows: ForceWindows, trial: _Trial, given: Sequence[np.ndarray]) -> _Trial:
    """`trial` with its shape moved to the least chi^2 by Levenberg-Marquardt steps."""
    family, S, damping = trial.family, len(trial.family.shape), 1e-3
    if not S:
        return trial
    low, high = (np.array([getattr(part, side) for part in family.shape]) for side in ("low", "high"))
    T, P = len(family.terms), len(windows.prior_mean)
    for _ in range(ROUNDS):
        reach = 1e-4 * np.maximum(np.abs(trial.shape), 1e-3)
        grid = np.concatenate([trial.shape[None], trial.shape + np.diag(reach)])
        near = windows.histories(family, _named(family, grid))
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
        then = _at(windows, family, shape[None], given)[0]
        if not then.chi2 < trial.chi2:
            damping *= 10
            if damping > 1e3:
                break
            continue
        gain, trial, damping = trial.chi2 - then.chi2, then, max(damping / 10, 1e-9)
        if gain < 0.1 + 1e-5 * trial.chi2:
            break
    return trial


def _pruned(windows: ForceWindows, trial: _Trial, given: Sequence[np.ndarray]) -> _Trial:
    """`trial` without the terms that predict nothing on runs left out."""
    while len(trial.family.terms) > 1 and not trial.family.whole:
        worth = max(FEWEST_CHI2, 0.02 * (trial.left_out - windows.samples))
        terms = trial.family.terms
        fewer = [trial.family._replace(terms=(*terms[:k], *terms[k + 1 :])) for k in range(len(terms))]
        shorter = [_at(windows, family, trial.shape[None], given)[0] for family in fewer]
        best = min(shorter, key=lambda one: one.left_out)
        if best.left_out > trial.left_out + worth:
            break
        trial = _refined(windows, best, given)
    return trial


def _proposed(trial: _Trial, samples: int, score: float) -> ProposedLaw:
    """The law of `trial`, with its amplitudes neutral at zero."""
    family = trial.family
    values = {term.amplitude: float(a) for term, a in zip(family.terms, trial.amplitudes, strict=True)}
    parameters = [LawParameter(term.amplitude, unit_text(term.unit)) for term in family.terms]
    expression = family.expression()
    if family.name == "spring" and abs(values["k"]) > 0:
        k = values["k"]
        values = {"k": k, "x0": values["a"] / k, "y0": values["b"] / k}
        expression = "east = k * (x0 - x); north = k * (y0 - y)"
        parameters = [parameters[0], *(LawParameter(n, "m", values[n]) for n in ("x0", "y0"))]
    for part, value in zip(family.shape, trial.shape, strict=True):
        parameters.append(LawParameter(part.name, unit_text(part.unit), float(value), part.low, part.high))
        values[part.name] = float(value)
    return ProposedLaw(
        expression, tuple(parameters), values, family, trial.shape, trial.left_out / samples, score, trial.steps
    )
