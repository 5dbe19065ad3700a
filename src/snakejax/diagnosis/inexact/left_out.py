"""What effects are worth on runs left out: each train run predicted with parameters from the others."""

from collections.abc import Iterable, Sequence
from itertools import islice, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.estimation.discrepancy.kalman import block_gram_matrices, gram_matrices
from snakejax.estimation.discrepancy.least_squares import quadratic
from snakejax.estimation.discrepancy.open_loop import open_loop

from .search import Linear, Search
from .subsets import left_out_deviances, left_out_errors

BLOCK = 8
"""Segments of a block (2 s). What a run gains is the sum of what its blocks gain, and a few runs have enough of them to
tell by how much that sum varies: runs are unlike, so that of four of them one may hold most of the evidence."""

MOST_ORDERS = 121
"""Contributions are averaged over all orders of up to five effects, and over so many drawn orders of more."""


class Gain(NamedTuple):
    """What an effect is worth on data left out.

    `by_part` (N,): the gain of each part, of which `exceeds_standard_error` takes the standard error. `share`: the fall
    of the squared error of whole runs, of that without any effect.
    """

    by_part: Float[np.ndarray, " N"]
    share: float

    @property
    def exceeds_standard_error(self) -> bool:
        """Whether the gain is above its standard error, or there is one in every part: the standard error of a few
        parts counts how unlike they are, and alone would refuse the strongest effect."""
        gained = self.by_part
        error = np.sqrt(len(gained)) * gained.std(ddof=1) if len(gained) > 1 else 0.0
        return bool(gained.sum() > error or (gained > 0).all())


class LeftOut(NamedTuple):
    """Runs predicted from the others, for the problem `linear`.

    `open_loop_grams` (R, P + 1, P + 1): the Gram matrices of whole runs without any force beside the model; `blocks`
    (R, B, P + 1, P + 1) and `logs` (R, B): Gram matrices and log determinants of blocks, with noise and random force;
    `present` (R, B): which of them have samples; `samples`: of all runs together.
    """

    linear: Linear
    open_loop_grams: np.ndarray
    blocks: np.ndarray
    logs: np.ndarray
    present: np.ndarray
    samples: int

    def error(self, effects: Iterable[str]) -> np.ndarray:
        """The squared error (R,) of each run with `effects`, in units of the noise."""
        if len(self.open_loop_grams) < 2:  # a single run judges itself
            step = self.linear.subsets.with_effects(effects).step
            return np.array([quadratic(gram, step) for gram in self.open_loop_grams])
        return left_out_errors(self.linear.subsets, self.linear.gram, self.open_loop_grams, effects)

    def mean_square(self, effects: Iterable[str]) -> Float[np.ndarray, " R"]:
        """The mean square error of each run with `effects`, in units of the noise, where it is predicted from its start
        and no measurement corrects it."""
        point, subsets, gram = self.linear.point, self.linear.subsets, self.linear.gram
        free = subsets.with_effects(effects).free
        others = [subsets.gram - one for one in gram] if len(gram) > 1 else [subsets.gram]
        steps = np.array([subsets.with_effects(effects, other).step[list(free)] for other in others])
        residual, _ = open_loop(self.linear.data, point.discrepancy, free).predicted(steps)
        noise = np.hypot(point.discrepancy.white, point.discrepancy.wander)
        samples = np.maximum(np.isfinite(residual).sum(axis=(1, 2)), 1)
        return np.nansum((residual / noise) ** 2, axis=(1, 2)) / samples

    def gain(self, effects: Iterable[str], effect: str) -> Gain:
        """What `effect` is worth beside the others of `effects`: the fall of -2 log density of each block."""
        rest = [other for other in effects if other != effect]
        return Gain(self.deviance(rest) - self.deviance([*rest, effect]), self.share(rest, effect))

    def share(self, effects: Sequence[str], effect: str) -> float:
        """The fall of the squared error of whole runs with `effect` beside `effects`, of the error without any."""
        return float((self.error(effects) - self.error([*effects, effect])).sum() / self.error([]).sum())

    def contributions(self, effects: Sequence[str]) -> dict[str, float]:
        """The part of the fall of the squared error of whole runs that is due to each of `effects`: the fall with it of
        ln error, summed over the runs so that none of them decides, and averaged over the orders in which the effects
        may be added (Shapley value; Lindeman, Merenda and Gold 1980). In the order in which they happen to be taken,
        the first is credited with what it shares with later ones.
        """
        orders = list(islice(permutations(effects), MOST_ORDERS))
        if len(orders) == MOST_ORDERS:
            random = np.random.default_rng(0)
            orders = [tuple(random.permutation(list(effects)).tolist()) for _ in orders]
        errors = {s: np.log(self.error(s)).sum() for s in {frozenset(o[:k]) for o in orders for k in range(len(o) + 1)}}
        contributions = dict.fromkeys(effects, 0.0)
        for order in orders:
            for k, effect in enumerate(order):
                fall = errors[frozenset(order[:k])] - errors[frozenset(order[: k + 1])]
                contributions[effect] += float(fall) / len(orders)
        return contributions

    def deviance(self, effects: Iterable[str]) -> Float[np.ndarray, " N"]:
        """-2 log density of each block that has samples with `effects`, as the other runs and the blocks before it
        predict it; a single run judges itself."""
        if len(self.blocks) < 2:
            step = self.linear.subsets.with_effects(effects).step
            return np.array([quadratic(gram, step) for gram in self.blocks[self.present]]) + self.logs[self.present]
        return left_out_deviances(self.linear.subsets, self.blocks, self.logs, effects)[self.present]

    def predicting(self, effects: Iterable[str]) -> list[str]:
        """Those of `effects` with which runs left out are predicted better, each beside the others that stay.

        Backward elimination: the effect of the smallest gain goes first.
        """
        kept = list(effects)
        while kept:
            gains = {effect: self.gain(kept, effect) for effect in kept}
            idle = [effect for effect in kept if not gains[effect].exceeds_standard_error]
            if not idle:
                break
            kept.remove(min(idle, key=lambda effect: gains[effect].by_part.sum()))
        return kept


def with_predicting_effects(search: Search, linear: Linear) -> Linear:
    """The problem with those effects that predict runs left out better, fitted to the end; a single run judges itself
    and keeps all."""
    effects = linear.point.effects
    kept = left_out(search, linear).predicting(effects) if len(linear.gram) > 1 else effects
    return linear if set(kept) == set(effects) else search.refit(linear.point, kept)


def left_out(search: Search, linear: Linear) -> LeftOut:
    """Runs left out of the problem `linear`."""
    alone = linear.point.discrepancy.without_force(search.scales.least_force)
    open_loop_grams, _ = gram_matrices(linear.data, alone)
    blocks, logs = block_gram_matrices(linear.data, linear.point.discrepancy, BLOCK)
    counts = linear.data.present.sum(axis=(2, 3))
    counts = np.pad(counts, [(0, 0), (0, -counts.shape[1] % BLOCK)]).reshape(*logs.shape, BLOCK).sum(axis=2)
    return LeftOut(linear, open_loop_grams, blocks, logs, counts > 0, int(linear.data.present.sum()))
