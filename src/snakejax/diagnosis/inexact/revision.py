"""The effects that a search has chosen, revised where they are fitted to the end."""

from collections.abc import Sequence

import numpy as np

from snakejax.core.progress import Phase, ProgressEvent
from snakejax.estimation.discrepancy.kalman import Discrepancy, gram_matrices
from snakejax.estimation.discrepancy.strength import estimate_discrepancy

from .search import ROUGH, Linear, Point, Search, rounds, slopeless
from .subsets import addition_gains, choose

REVISIONS = 4
"""How often a set that was fitted to the end is chosen again, at most."""
MASKED = 3
"""So many absent effects, the best, are tried in place of a part of the random force."""


def search_effects(search: Search) -> Linear:
    """The set of effects that the recordings need, fitted to the end."""
    search.progress(ProgressEvent(Phase.TYRE_BESIDE_FORCE))
    return revised(search, rounds(search, search.begin()))


def revised(search: Search, point: Point) -> Linear:
    """The effects of `point` fitted to the end, and chosen again there until nothing changes."""
    for _ in range(REVISIONS):
        search.progress(ProgressEvent(Phase.FITTING_EFFECTS))
        linear = search.refit(point, point.effects)
        again = choose(linear.subsets.without(slopeless(search, linear.point)), linear.point.effects)
        if set(again) == set(linear.point.effects):
            again += masked_by_force(search, linear)
        if set(again) == set(linear.point.effects):
            return linear
        point = linear.point._replace(effects=tuple(again))
    return search.refit(point, point.effects)


def masked_by_force(search: Search, linear: Linear) -> list[str]:
    """The absent effect whose place the random force of `linear` has taken; empty where there is none.

    A random force that was estimated without an effect is as large as that effect, and beside it the effect brings
    little. Candidates are ranked under the force that is left where all are free. The force is then estimated again
    with each of the best, and -2 log likelihood, ln |V| + chi^2, has to fall by the threshold of the effect.
    """
    effects, point = list(linear.point.effects), linear.point
    absent = linear.subsets.without(slopeless(search, point))
    least = _estimated(search, linear, list(absent.candidates))
    problem = linear.under(least).without(set(linear.subsets.candidates) - set(absent.candidates))
    gained = addition_gains(problem, effects)
    ranked = sorted(gained, key=lambda effect: (problem.p_value(effect, gained[effect]), -gained[effect]))
    before = _deviance(linear, point.discrepancy, effects)
    for effect in ranked[:MASKED]:
        if not gained[effect] >= problem.threshold(effect):
            break
        own = _estimated(search, linear, [*effects, effect])
        if before - _deviance(linear, own, [*effects, effect]) >= problem.threshold(effect):
            return [effect]
    return []


def _estimated(search: Search, linear: Linear, effects: Sequence[str]) -> Discrepancy:
    """The discrepancy where the parameters of `effects` are free."""
    free, prior = search.model.free(effects), search.prior_at(linear.point.values)
    return estimate_discrepancy(linear.data, linear.point.discrepancy, free, prior, search.scales, ROUGH)[0]


def _deviance(linear: Linear, discrepancy: Discrepancy, effects: Sequence[str]) -> float:
    """-2 log likelihood with the best parameters of `effects`, their prior counted."""
    _, logs = gram_matrices(linear.data, discrepancy)
    return float(np.sum(logs)) + linear.under(discrepancy).with_effects(effects).chi2
