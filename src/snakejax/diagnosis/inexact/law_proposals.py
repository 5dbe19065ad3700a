"""The laws that the segments of an inexact model propose, and how well each does beside the known effects it needs.

A random force that is as strong as a law explains the same motion, so a law is hardly significant beside the force that
was estimated without it. The search therefore assumes a weaker force.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.estimation.discrepancy.kalman import gram_matrices
from snakejax.estimation.discrepancy.least_squares import Prior

from ..law.passivity import is_passive
from ..law.regression import named
from ..law.search import ProposedLaw, choices, with_amplitudes
from ..law.search import search as search_laws
from ..law.windows import ForceWindows
from .confidence import beside_unknown
from .fitted_law import Proposal
from .search import Linear, Search, slopeless
from .segment_force import force_windows
from .subsets import Subsets, choose, prune

WEAKER = (1 / 3, 1 / 10, 1 / 30)
"""A law is looked for beside the first of these shares of the random force: a tenth of its power, so that the law is
taken for the rest. Laws are compared each beside that one of them with which it is likeliest."""
COMPARED = 30
"""So many laws beside each set of effects are compared, at most."""
RIDGE, TINY = 1e-6, 1e-12
"""Precision of the prior of an amplitude, as a share of what the runs say of it alone, and in its unit."""
LAW = "a law"
"""The name of a law among the candidates while it is compared with others; no effect can be called so."""


class Beside(NamedTuple):
    """A weaker random force: the `windows` of all parameters, the problem of the `known` effects, and the log
    determinant `log` of the samples."""

    windows: ForceWindows
    known: Subsets
    log: float


def proposals(search: Search, linear: Linear) -> list[Proposal]:
    """The laws that the segments propose, the best first, each form once: beside those effects with which it is
    best."""
    of_form: dict[object, Proposal] = {}
    every = [one for beside in bases(search, linear) for one in proposed(search, beside)]
    for one in sorted(every, key=lambda one: one.penalised):
        of_form.setdefault(one.law.form, one)
    return list(of_form.values())


def bases(search: Search, linear: Linear) -> list[Linear]:
    """Beside which effects a law is looked for, each set with a random force that was estimated with it or a part of
    it: those of `linear`, those of them that are needed (`with_needed_effects`), and those that are significant beside
    a weaker force. Some of the known effects are there, and some stand in for the law; which, is not known before."""
    sets: dict[tuple[str, ...], Linear] = {}
    for one in (linear, with_needed_effects(search, linear)):
        own = one.point.effects
        for effects in (own, choose(beside_weaker_force(search, one, WEAKER[0]).subsets, own)):
            key = tuple(sorted(effects))
            sets.setdefault(key, _with_effects(one, key))
    return list(sets.values())


def with_needed_effects(search: Search, linear: Linear) -> Linear:
    """The fit with only those effects of `linear` that are needed even if a share `cautious_force` of the forces had
    another cause: the others may stand in for the law, which then cannot be seen beside them."""
    effects = linear.point.effects
    needed = prune(beside_unknown(search, linear, search.criteria.cautious_force, exact=False), effects)
    return linear if set(needed) == set(effects) else search.refit(linear.point, needed)


def beside_weaker_force(search: Search, linear: Linear, share: float) -> Linear:
    """`linear` with this `share` of its random force."""
    point = linear.point
    weaker = point.discrepancy.without_force(np.maximum(share * point.discrepancy.force, search.scales.least_force))
    return linear._replace(point=point._replace(discrepancy=weaker), subsets=linear.under(weaker))


def proposed(search: Search, linear: Linear) -> list[Proposal]:
    """The laws that the segments propose beside the effects of `linear`; those that are needed beside each law are
    chosen again with it. A resistance that drives the vehicle is none (`is_passive`)."""
    weaker = [beside_weaker_force(search, linear, share) for share in WEAKER]
    unfit = slopeless(search, linear.point)
    beside = [Beside(force_windows(search, one), one.subsets.without(unfit), log_determinant(one)) for one in weaker]
    proposed_laws, free = [], search.model.free(linear.point.effects)
    for law in search_laws(beside[0].windows.keeping(free), most=COMPARED):
        compared = [chosen_beside(one, law, linear.point.effects) for one in beside]
        penalised, effects, step = min(compared, key=lambda one: one[0])
        if LAW not in effects:
            continue
        others = tuple(effect for effect in effects if effect != LAW)
        parameters = len(search.model.names)
        fitted = with_amplitudes(law, step[parameters:], step[search.model.free(others)])
        values = search.segments.moved(linear.point.values, step[:parameters])
        if is_passive(beside[0].windows, fitted, dict(zip(search.model.names, values, strict=True))):
            proposed_laws.append(Proposal(_with_effects(weaker[0], others), fitted, penalised))
    return proposed_laws


def chosen_beside(beside: Beside, law: ProposedLaw, start: Sequence[str]) -> tuple[float, list[str], np.ndarray]:
    """-2 log likelihood with the `law` and the known effects that are needed with it, and what all of them cost (the
    threshold of each, that of the law counting all forms that were tried); these effects, from those of `start` on; and
    the steps of the parameters and the amplitudes of the law.

    A larger random force hides more, so that chi^2 alone would prefer it.
    """
    problem = with_law(beside, law)
    effects = choose(problem, [*start, LAW])
    return problem.penalised(effects) + beside.log, effects, problem.with_effects(effects).step


def with_law(beside: Beside, law: ProposedLaw) -> Subsets:
    """The problem of the known effects with the amplitudes of the `law` as one more candidate, its shape held."""
    windows, known = beside.windows, beside.known
    matrix, right = windows.normal(windows.histories(law.family, named(law.family, law.shape[None])))
    A, b = matrix.sum(axis=0)[0], right.sum(axis=0)[0]
    P, T = len(windows.prior_mean), len(law.family.terms)
    return known._replace(
        gram=np.block([[windows.square.sum(), b[None]], [b[:, None], A]]),
        candidates=OrderedDict(known.candidates) | {LAW: tuple(range(P, P + T))},
        prior=Prior(
            np.append(known.prior.mean, np.zeros(T)), np.append(known.prior.precision, RIDGE * np.diag(A)[P:] + TINY)
        ),
        low=np.append(known.low, np.full(T, -np.inf)),
        high=np.append(known.high, np.full(T, np.inf)),
        trials={**known.trials, LAW: choices(law.family, law.forms)},
    )


def log_determinant(linear: Linear) -> float:
    """ln |V| of all samples, V their covariance by noise and random force."""
    _, logs = gram_matrices(linear.data.keeping(np.array([], int)), linear.point.discrepancy)
    return float(logs.sum())


def _with_effects(linear: Linear, effects: tuple[str, ...]) -> Linear:
    return linear._replace(point=linear.point._replace(effects=effects))
