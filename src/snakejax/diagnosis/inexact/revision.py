"""The effects that a search has chosen, revised where they are fitted to the end."""

from collections.abc import Sequence

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, ProgressEvent
from snakejax.estimation.discrepancy.kalman import Discrepancy, gram_matrices
from snakejax.estimation.discrepancy.strength import estimate_discrepancy

from .search import ROUGH, Linear, Point, Search, probed, rounds, slopeless, value_beside
from .subsets import addition_gains, choose, prune

REVISIONS = 10
"""How often a set that was fitted to the end is chosen again, at most."""
FURTHER = 2.0
"""Multiple of the value of an effect without a slope at neutral from which it is fitted once more."""
MASKED = 3
"""So many absent effects, the best, are tried in place of a part of the random force."""


def search_effects(search: Search) -> Linear:
    """The set of effects that the recordings need, fitted to the end.

    The rounds in which effects are chosen take whole steps of the linear problem, which may lead astray. Where the fit
    after them does not converge, or ends less likely than the model without effects at which they began, effects are
    chosen there, and every step from there on has to raise the likelihood; of both ends the likelier is kept.
    """
    search.progress(ProgressEvent(Phase.TYRE_BESIDE_FORCE))
    first = search.linearise(search.begin())
    linear = revised(search, rounds(search, first))
    if linear.has_converged and _penalised(linear) < _deviance(first, first.point.discrepancy, ()):
        return linear
    effects = choose(first.subsets.without(slopeless(search, first.point)), ())
    other = revised(search, first.point._replace(effects=tuple(effects)))
    return min(linear, other, key=_penalised)


def revised(search: Search, point: Point) -> Linear:
    """The effects of `point` fitted to the end, and chosen again there until nothing changes.

    At its neutral value an effect without a slope there can never be chosen: at the end each is tried beside it, once.
    Those that are chosen begin at a small value, and a likelier one may be further away.
    """
    added: list[str] = []
    fitted: list[set[str]] = []
    for _ in range(REVISIONS):
        search.progress(ProgressEvent(Phase.FITTING_EFFECTS))
        linear = search.refit(point, point.effects)
        fitted.append(set(point.effects))
        again = choose(linear.subsets.without(slopeless(search, linear.point)), linear.point.effects)
        if set(again) == set(linear.point.effects):
            again += masked_by_force(search, linear)
        if set(again) != set(linear.point.effects):
            if set(again) in fitted:
                return linear
            point = linear.point._replace(effects=tuple(again))
            continue
        with_one = with_slopeless_effect(search, linear, added)
        if with_one is not None:
            point = with_one
            added.append(point.effects[-1])
            continue
        further = from_further_values(search, linear)
        if further is None:
            return linear
        # From the likelier optimum a set that was fitted before may end elsewhere.
        point, fitted = further.point, []
    return search.refit(point, point.effects)


def from_further_values(search: Search, linear: Linear) -> Linear | None:
    """The likeliest of the fits that begin at `FURTHER` times the value of one effect without a slope at neutral, where
    it is likelier than that of `linear`; else None.

    At a fine noise a tyre that relaxes over 4.2 mm has a second optimum at 2.9 mm, to which every start below leads.
    """
    point, fits = linear.point, []
    for effect in point.effects:
        columns = [k for k in search.model.candidates.get(effect, ()) if k in search.model.probes]
        if not columns:
            continue
        values = point.values.copy()
        values[columns] *= FURTHER
        z = search.segments.with_steady_memories(values, point.z, effect)
        try:
            fits.append(search.refit(point._replace(values=values, z=z), point.effects))
        except FitError:
            continue
    best = min(fits, key=_penalised, default=linear)
    return best if _penalised(best) < _penalised(linear) - search.criteria.distinct_chi2 else None


def with_slopeless_effect(search: Search, linear: Linear, tried: Sequence[str]) -> Point | None:
    """The point of `linear` with one more effect, of those without a slope at their neutral value that were not
    `tried`: the one with which -2 log likelihood falls most, the random force estimated again with it, if by its
    threshold; else None."""
    effects, point = linear.point.effects, linear.point
    before, best, most = _deviance(linear, point.discrepancy, effects), None, 0.0
    for effect in (one for one in slopeless(search, point) if one not in tried):
        try:
            beside = probed(search, linear, effect)
        except FitError:
            continue
        own = _estimated(search, beside, [*effects, effect])
        fall = before - _deviance(beside, own, [*effects, effect])
        if fall >= beside.subsets.threshold(effect) and fall > most:
            under = beside._replace(subsets=beside.under(own))
            values = point.values.copy()
            values[list(search.model.candidates[effect])] = value_beside(search, under, effects, effect)
            z = search.segments.with_steady_memories(values, point.z, effect)
            best, most = Point(values, z, own, (*effects, effect)), fall
    return best


def masked_by_force(search: Search, linear: Linear) -> list[str]:
    """The absent effect whose place the random force of `linear` has taken, or the effects together; empty where there
    are none.

    A random force that was estimated without an effect is as large as that effect, and beside it the effect brings
    little. Candidates are ranked under the force that is left where all are free. The force is then estimated again
    with each of the best, and -2 log likelihood, ln |V| + chi^2, has to fall by the threshold of the effect. Of several
    effects none may bring it down alone: those that are left of all under the least force are tried together.
    """
    effects, point = list(linear.point.effects), linear.point
    absent = linear.subsets.without(slopeless(search, point))
    least = _estimated(search, linear, list(absent.candidates))
    problem = linear.under(least).without(set(linear.subsets.candidates) - set(absent.candidates))
    gained = addition_gains(problem, effects)
    ranked = sorted(gained, key=lambda effect: (problem.p_value(effect, gained[effect]), -gained[effect]))
    before = _deviance(linear, point.discrepancy, effects)

    def are_masked(added: list[str]) -> bool:
        own = _estimated(search, linear, [*effects, *added])
        return before - _deviance(linear, own, [*effects, *added]) >= sum(map(problem.threshold, added))

    for effect in ranked[:MASKED]:
        if not gained[effect] >= problem.threshold(effect):
            break
        if are_masked([effect]):
            return [effect]
    together = [effect for effect in prune(problem, problem.candidates) if effect not in effects]
    return together if len(together) > 1 and are_masked(together) else []


def _estimated(search: Search, linear: Linear, effects: Sequence[str]) -> Discrepancy:
    """The discrepancy where the parameters of `effects` are free."""
    free, prior = search.model.free(effects), search.prior_at(linear.point.values)
    return estimate_discrepancy(linear.data, linear.point.discrepancy, free, prior, search.scales, ROUGH)[0]


def _penalised(linear: Linear) -> float:
    """-2 log likelihood with the effects of `linear`, and the threshold of each."""
    effects = linear.point.effects
    return _deviance(linear, linear.point.discrepancy, effects) + sum(map(linear.subsets.threshold, effects))


def _deviance(linear: Linear, discrepancy: Discrepancy, effects: Sequence[str]) -> float:
    """-2 log likelihood with the best parameters of `effects`, their prior counted."""
    _, logs = gram_matrices(linear.data, discrepancy)
    return float(np.sum(logs)) + linear.under(discrepancy).with_effects(effects).chi2
