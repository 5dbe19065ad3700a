"""How sure an effect is: sure, likely, one of several, or in place of something else."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .evidence import largest_force
from .left_out import LeftOut
from .search import Linear, Search
from .subsets import Subsets, removal_costs, substitutes

WORDS = SURE, LIKELY, AMBIGUOUS, STAND_IN = "sure", "likely", "ambiguous", "stand_in"
"""How sure an effect is, the surest first."""
RELEVANT = 0.05
"""Where no model is exact, an effect that takes away less than this share of the squared error of unseen runs is not
sure: what no candidate describes may be as large."""


class Confidence(NamedTuple):
    """How sure one effect is.

    `word`: "ambiguous" where another candidate does nearly as well in its place (`twins`); "sure" where chi^2 rises by
    more than `threshold` without it, even if a share `largest_random_force` of the forces were something else; "likely"
    where it rises by so much under the estimated discrepancy, by half of it with a share `cautious_force` unknown, and
    the effect predicts runs left out; else "stand_in": it lowers the error, but something else may be the cause. A law,
    whose threshold counts all forms that were tried, is likely without the half: a law is often weaker than the
    cautious force. `fall`, `cautious_fall`, `sure_fall`: those rises, the last beside the larger force. `instead`: the
    candidates that could take its place.
    """

    word: str
    fall: float
    cautious_fall: float
    sure_fall: float
    threshold: float
    instead: tuple[str, ...]


def beside_unknown(search: Search, linear: Linear, share: float, exact: bool) -> Subsets:
    """The problem at `linear` with a `share` of the forces that move the vehicle unknown; where the model is exact,
    with the largest that the recordings do not exclude, if that is less.

    Where it is not, the recordings exclude a random force only: an unknown force that depends on the motion may act
    like one of the effects, and then leaves nothing to be seen.
    """
    criteria, scales = search.criteria, search.scales
    share = largest_force(search, linear, share) if exact else share
    return linear.under(linear.point.discrepancy.enlarged(share * scales.force, criteria.shortest_force))


def confidence(
    search: Search, linear: Linear, predicted: LeftOut, laws: Mapping[str, tuple[str, ...]], exact: bool
) -> dict[str, Confidence]:
    """How sure each effect of the point of `linear` is; `laws`: those that are laws, with others that do as well;
    `exact`: whether white noise and the model with the stated constants, without a law, are all that there is."""
    effects, criteria = linear.point.effects, search.criteria
    wide = beside_unknown(search, linear, criteria.cautious_force, exact)
    widest = beside_unknown(search, linear, criteria.largest_random_force, exact)
    costs, wide_costs, widest_costs = (removal_costs(each, effects) for each in (linear.subsets, wide, widest))
    sure = {}
    for effect, fall in costs.items():
        law = effect in laws
        instead = twins(search, linear.subsets if law else wide, effects, effect)
        instead += laws[effect] if law else twins_of_parts(search, wide, effects, effect)
        predicts = predicted.gain(effects, effect).exceeds_standard_error
        falls = fall, wide_costs[effect], widest_costs[effect]
        sure[effect] = _confidence(linear.subsets.threshold(effect), predicts, law, falls, instead)
    return sure


def _confidence(
    threshold: float, predicts: bool, law: bool, falls: tuple[float, float, float], instead: tuple[str, ...]
) -> Confidence:
    fall, cautious_fall, sure_fall = falls
    if instead:
        word = AMBIGUOUS
    elif sure_fall >= threshold:
        word = SURE
    elif fall >= threshold and (law or cautious_fall >= threshold / 2) and predicts:
        word = LIKELY
    else:
        word = STAND_IN
    return Confidence(word, *falls, threshold, instead)


def twins(search: Search, problem: Subsets, effects: Iterable[str], effect: str) -> tuple[str, ...]:
    """The candidates that take the place of `effect`, the best first: chi^2 rises by less than `distinct_chi2`, and by
    less than half of what it rises by where nothing takes its place."""
    costs = substitutes(problem, effects, effect)
    most = min(search.criteria.distinct_chi2, 0.5 * removal_costs(problem, effects)[effect])
    near = [other for other, cost in costs.items() if cost < most]
    return tuple(sorted(near, key=lambda other: costs[other] if np.isfinite(costs[other]) else np.inf))


def twins_of_parts(search: Search, problem: Subsets, effects: Sequence[str], effect: str) -> tuple[str, ...]:
    """The candidates that take the place of one parameter of an `effect` that has several, of those parameters that are
    significant by themselves. A marker ahead of the centre of mass and a centre of mass behind the middle look alike:
    that a marker is to the left of it does not tell which it is."""
    columns, others = problem.candidates[effect], []
    for column in columns if len(columns) > 1 else ():
        split, part = problem.split(effect, column)
        whole = [*effects, part]
        if removal_costs(split, whole)[part] >= split.threshold(part):
            others += [other for other in twins(search, split, whole, part) if other not in others]
    return tuple(others)
