"""Which effects are there, from Gram matrices alone: pruning, forward selection, exchange, runs left out."""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.estimation.discrepancy.least_squares import Optimum, Prior, optimum, quadratic

from ..selection.criteria import CRITERIA, SelectionCriteria

MOST_CHANGES = 10
"""Rounds in which effects are put back and pruned again, at most."""


class Subsets(NamedTuple):
    """The linear problem of which effects to take.

    `gram` (P + 1, P + 1); the parameters that are `always` free and those of each of the `candidates`; their `prior`,
    whose mean is the step to the neutral value; the steps (P,) to the lowest and to the highest value. `trials`: of how
    many forms a law is the best, by its name; a known effect is the only one.
    """

    gram: np.ndarray
    always: tuple[int, ...]
    candidates: OrderedDict[str, tuple[int, ...]]
    prior: Prior
    low: np.ndarray
    high: np.ndarray
    criteria: SelectionCriteria = CRITERIA
    trials: Mapping[str, int] = {}

    def with_effects(self, effects: Iterable[str], gram: np.ndarray | None = None) -> Optimum:
        """The optimum with `effects`, all other candidates at their neutral value."""
        effects = list(effects)
        fixed = np.zeros(len(self.low))
        for effect, columns in self.candidates.items():
            if effect not in effects:
                fixed[list(columns)] = self.prior.mean[list(columns)]
        free = [*self.always, *(k for effect in effects for k in self.candidates[effect])]
        return optimum(self.gram if gram is None else gram, free, self.prior, fixed, self.low, self.high)

    def unbounded(self, columns: Iterable[int]) -> "Subsets":
        """The problem without bounds of the parameters numbered `columns`."""
        low, high = self.low.copy(), self.high.copy()
        low[list(columns)], high[list(columns)] = -np.inf, np.inf
        return self._replace(low=low, high=high)

    def split(self, effect: str, column: int) -> tuple["Subsets", str]:
        """The problem with the parameter numbered `column` of an `effect` as a candidate of its own, and its name."""
        part, rest = f"{effect}.{column}", tuple(k for k in self.candidates[effect] if k != column)
        candidates = OrderedDict(self.candidates) | {effect: rest, part: (column,)}
        return self._replace(candidates=candidates), part

    def without(self, effects: Iterable[str]) -> "Subsets":
        """The problem without some of its candidates."""
        barred = set(effects)
        kept = OrderedDict((effect, columns) for effect, columns in self.candidates.items() if effect not in barred)
        return self._replace(candidates=kept)

    def threshold(self, effect: str) -> float:
        """The fall of chi^2 that an effect brings by chance at the level of the criteria over all candidates."""
        level = self.criteria.significance_level / self.criteria.nominal_candidates / self.trials.get(effect, 1)
        return float(stats.chi2.isf(level, len(self.candidates[effect])))

    def p_value(self, effect: str, fall: float) -> float:
        """The probability of such a `fall` of chi^2 by chance, for one candidate; 1 where it is not a number. That of a
        law is counted once for each form that was tried (Bonferroni)."""
        if not np.isfinite(fall):
            return 1.0
        return min(1.0, self.trials.get(effect, 1) * float(stats.chi2.sf(max(fall, 0.0), len(self.candidates[effect]))))

    def penalised(self, effects: Iterable[str]) -> float:
        """chi^2 with `effects` plus the threshold of each."""
        effects = list(effects)
        return self.with_effects(effects).chi2 + sum(self.threshold(effect) for effect in effects)


def removal_costs(problem: Subsets, effects: Iterable[str]) -> dict[str, float]:
    """By how much chi^2 rises where each of `effects` is taken out and all else is fitted again."""
    effects = list(effects)
    full = problem.with_effects(effects).chi2
    return {e: problem.with_effects([other for other in effects if other != e]).chi2 - full for e in effects}


def addition_gains(problem: Subsets, effects: Iterable[str]) -> dict[str, float]:
    """By how much chi^2 falls where each absent candidate is added to `effects`."""
    effects = list(effects)
    chi2 = problem.with_effects(effects).chi2
    return {e: chi2 - problem.with_effects([*effects, e]).chi2 for e in problem.candidates if e not in effects}


def prune(problem: Subsets, effects: Iterable[str]) -> list[str]:
    """Backward elimination: the effect of least evidence is dropped until each is above its threshold."""
    effects = list(effects)
    while effects:
        lost = removal_costs(problem, effects)
        worst = max(effects, key=lambda effect: (problem.p_value(effect, lost[effect]), -lost[effect]))
        if lost[worst] >= problem.threshold(worst):
            break
        effects.remove(worst)
    return effects


def choose(problem: Subsets, start: Iterable[str]) -> list[str]:
    """`start` pruned; then the best absent candidate is added and the set pruned again, until nothing changes."""
    effects = prune(problem, start)
    for _ in range(MOST_CHANGES):
        gained = addition_gains(problem, effects)
        best = min(gained, key=lambda effect: (problem.p_value(effect, gained[effect]), -gained[effect]), default=None)
        if best is None or not gained[best] >= problem.threshold(best):
            return effects
        changed = prune(problem, [*effects, best])
        if set(changed) == set(effects):
            return effects
        effects = changed
    return effects


def best_subset(problem: Subsets, last: Iterable[str], *, all_at_once: bool) -> list[str]:
    """The best of three searches: forward from nothing, the `last` set, and `all_at_once` every candidate pruned.

    Far from the optimum all candidates together lead astray; near it forward selection alone misses effects that act
    together.
    """
    searches = [choose(problem, []), choose(problem, last)]
    if all_at_once:
        searches.append(choose(problem, problem.candidates))
    return min(searches, key=problem.penalised)


def substitutes(problem: Subsets, effects: Iterable[str], effect: str) -> dict[str, float]:
    """By how much chi^2 rises where each absent candidate takes the place of `effect`."""
    effects = list(effects)
    now, rest = problem.with_effects(effects).chi2, [other for other in effects if other != effect]
    absent = [name for name in problem.candidates if name not in effects]
    return {other: problem.with_effects([*rest, other]).chi2 - now for other in absent}


def left_out_errors(problem: Subsets, fitted: np.ndarray, judged: np.ndarray, effects: Iterable[str]) -> np.ndarray:
    """The squared error (R,) of each run under parameters from the other runs.

    `fitted` (R, P + 1, P + 1) are the Gram matrices of which the parameters are estimated, `judged` those in which the
    error is measured.
    """
    effects, total = list(effects), fitted.sum(axis=0)
    steps = [problem.with_effects(effects, total - one).step for one in fitted]
    return np.array([quadratic(gram, step) for gram, step in zip(judged, steps, strict=True)])


def left_out_deviances(
    problem: Subsets, blocks: np.ndarray, logs: np.ndarray, effects: Iterable[str]
) -> Float[np.ndarray, "R B"]:
    """-2 log density (R, B) of the blocks of each run as the other runs, and the blocks before it, predict it.

    `blocks` (R, B, P + 1, P + 1) and `logs` (R, B): their Gram matrices and log determinants. The constant ln 2 pi of
    each sample is left out. At the optimum of what came before, whose parameters have the covariance C, a block has the
    residual r and its derivatives D in units of noise and random force, and r ~ N(0, 1 + D C D^T) has the density
    ln |1 + C D^T D| + r^T r - g^T (D^T D + C^-1)^-1 g, g = D^T r. Without C, what the others do not determine would be
    held against an effect. The sum over the blocks of a run is the density of the run.
    """
    effects = list(effects)
    total, deviances = blocks.sum(axis=(0, 1)), np.zeros(logs.shape)
    for r, run in enumerate(blocks):
        known = total - run.sum(axis=0)
        for b, one in enumerate(run):
            others = problem.with_effects(effects, known)
            rows = np.array(others.free, int) + 1
            gradient = one[rows] @ np.concatenate([[1.0], -others.step])
            information, C = one[np.ix_(rows, rows)], others.covariance
            # (D^T D + C^-1)^-1 = (1 + C D^T D)^-1 C needs no inverse of C, which a bound may leave near singular.
            spread = np.eye(len(rows)) + C @ information
            deviances[r, b] = np.linalg.slogdet(spread)[1] + quadratic(one, others.step)
            deviances[r, b] -= gradient @ np.linalg.solve(spread, C @ gradient)
            known = known + one
    return deviances + logs
