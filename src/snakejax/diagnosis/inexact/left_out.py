"""What effects are worth on runs left out: each train run predicted with parameters from the others."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.estimation.discrepancy.kalman import gram_matrices
from snakejax.estimation.discrepancy.least_squares import quadratic

from .search import FINE, Linear, Search
from .subsets import left_out_errors


class Gain(NamedTuple):
    """What an effect is worth on runs left out.

    `by_run` (R,): the fall of chi^2 of each run against noise and random force, under the parameters of the others.
    `share`: the fall of the squared error of whole runs, of that without any effect.
    """

    by_run: Float[np.ndarray, " R"]
    share: float

    @property
    def predicts(self) -> bool:
        """Whether the gain is above its standard error, or there is one in every run: the standard error of a few runs
        counts how unlike they are, and alone would refuse the strongest effect."""
        gained = self.by_run
        error = np.sqrt(len(gained)) * gained.std(ddof=1) if len(gained) > 1 else 0.0
        return bool(gained.sum() > error or (gained > 0).all())


class LeftOut(NamedTuple):
    """Whole runs predicted from the others: the problem is `linear`, and `judged` (R, P + 1, P + 1) are the Gram
    matrices of whole runs without any force beside the model."""

    linear: Linear
    judged: np.ndarray
    samples: int

    def error(self, effects: Iterable[str]) -> np.ndarray:
        """The squared error (R,) of each run with `effects`, in units of the noise."""
        if len(self.judged) < 2:  # a single run judges itself
            step = self.linear.subsets.with_effects(effects).step
            return np.array([quadratic(gram, step) for gram in self.judged])
        return left_out_errors(self.linear.subsets, self.linear.gram, self.judged, effects)

    def gain(self, effects: Iterable[str], effect: str) -> Gain:
        """What `effect` is worth beside the others of `effects`."""
        rest = [other for other in effects if other != effect]
        share = (self.error(rest) - self.error([*rest, effect])).sum() / self.error([]).sum()
        return Gain(self._chi2(rest) - self._chi2([*rest, effect]), float(share))

    def _chi2(self, effects: Iterable[str]) -> np.ndarray:
        """chi^2 (R,) of each run against noise and random force, with `effects`."""
        if len(self.linear.gram) < 2:
            step = self.linear.subsets.with_effects(effects).step
            return np.array([quadratic(gram, step) for gram in self.linear.gram])
        return left_out_errors(self.linear.subsets, self.linear.gram, self.linear.gram, effects)

    def explained_share(self, effects: Iterable[str]) -> float:
        """The share of the squared error that all `effects` take away."""
        return float(1.0 - self.error(effects).sum() / self.error([]).sum())

    def predicting(self, effects: Iterable[str]) -> list[str]:
        """Those of `effects` with which runs left out are predicted better, each beside the others that stay.

        Backward elimination: the effect of the smallest gain goes first.
        """
        kept = list(effects)
        while kept:
            gains = {effect: self.gain(kept, effect) for effect in kept}
            idle = [effect for effect in kept if not gains[effect].predicts]
            if not idle:
                break
            kept.remove(min(idle, key=lambda effect: gains[effect].share))
        return kept


def with_predicting_effects(search: Search, linear: Linear) -> Linear:
    """The problem with those effects that predict runs left out better, fitted to the end; a single run judges itself
    and keeps all."""
    effects = linear.point.effects
    kept = left_out(search, linear).predicting(effects) if len(linear.gram) > 1 else effects
    return linear if set(kept) == set(effects) else search.refit(linear.point, kept, most=FINE)


def left_out(search: Search, linear: Linear) -> LeftOut:
    """Runs left out of the problem `linear`."""
    alone = linear.point.discrepancy.without_force(search.scales.least_force)
    judged, _ = gram_matrices(linear.data, alone)
    return LeftOut(linear, judged, int(linear.data.present.sum()))
