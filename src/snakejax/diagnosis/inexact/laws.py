"""A law beside a random force: proposed by the segments, then an effect of the model like any other.

Everything is fitted anew with a law, the random force included. The law must be significant among all forms that were
tried, and must predict omitted train runs better.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.progress import Phase, ProgressEvent
from snakejax.recording.run import Case, Noise

from ..selection.candidates import CandidateSet
from .evidence import model_evidence
from .fitted_law import FittedLaw, Proposal, fit_law, without_idle_terms
from .law_proposals import WEAKER, proposals
from .left_out import Gain, left_out
from .search import Linear, Search

TRIED = 5
"""So many laws are fitted with everything else, at most."""
MOST_LAWS = 2
"""So many laws stand beside each other, at most."""


class LawChoice(NamedTuple):
    """The `law` that is kept, or None; then `undecided` are the formulas of those among which these runs cannot
    choose."""

    law: FittedLaw | None = None
    undecided: tuple[str, ...] = ()


class LawChoices(NamedTuple):
    """The `laws` that are kept, each fitted together with those before it, and the formulas `undecided` among which
    these runs cannot choose another."""

    laws: tuple[FittedLaw, ...] = ()
    undecided: tuple[str, ...] = ()


def choose_laws(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, linear: Linear, base: Sequence[str]
) -> LawChoices:
    """The laws that `choose_law` keeps one after the other, `MOST_LAWS` at most, as long as a random force is left."""
    laws: list[FittedLaw] = []
    while True:
        choice = choose_law(case, noise, candidate_set, search, linear, base)
        if choice.law is None:
            return LawChoices(tuple(laws), choice.undecided)
        laws.append(choice.law)
        candidate_set, search, linear = choice.law.candidate_set, choice.law.search, choice.law.linear
        if len(laws) == MOST_LAWS or not model_evidence(search, linear).has_force:
            return LawChoices(tuple(laws))


def choose_law(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, linear: Linear, base: Sequence[str]
) -> LawChoice:
    """The law that predicts train runs left out best.

    Of laws that do not differ by `distinct_chi2` from the best, see `preferred`. There is none where no law predicts
    them better than `linear` does, each under its own random force, by more than the standard error; or where there is
    but one run; nor where it takes the place of a known effect and these runs cannot distinguish the two. A law that
    raises the error of whole runs left out is not kept: beside a random force it may follow each run better, and lead a
    simulation astray. That error is compared by its logarithm, so that no single run decides: one that alone shows
    where a bump is cannot be predicted without it. Where laws of other variables do as well, it is not known which is
    right, and a wrong one may do harm in other motions: there it must lower that error by more than the standard error.
    A law that cannot explain (`may_explain`) is not fitted, and after one that leaves only noise no other is.
    """
    if len(linear.gram) < 2:
        return LawChoice()
    search.progress(ProgressEvent(Phase.LAW_SEARCH))
    ordered = proposals(search, linear)
    before, effects = left_out(search, linear), linear.point.effects
    whole = np.log(before.mean_square(effects))
    fitted: list[FittedLaw] = []
    for one in (one for one in near(ordered, search.criteria.distinct_chi2) if may_explain(search, linear, one)):
        search.progress(ProgressEvent(Phase.LAW_FIT, f"fitting {one.law.expression} together with a random force"))
        with_one = fit_law(case, noise, candidate_set, search, base, one)
        if with_one is not None and with_one.log_error.sum() < whole.sum():
            fitted.append(with_one)
            if with_one.exact:
                break
    if not fitted:
        return LawChoice()
    most = min(one.deviance.sum() for one in fitted) + search.criteria.distinct_chi2
    as_good = [one for one in fitted if one.deviance.sum() < most]
    best = preferred(as_good)
    gain = Gain(before.deviance(effects) - best.deviance, 0.0)
    displaced = set(effects) - set(best.linear.point.effects)
    if not gain.exceeds_standard_error or (displaced and gain.by_part.sum() < search.criteria.distinct_chi2):
        return LawChoice()
    subject = best.proposal.subject
    rivals = tuple(one.proposal.law for one in as_good if one.proposal.subject != subject)
    if rivals and not Gain(whole - best.log_error, 0.0).exceeds_standard_error:
        return LawChoice(undecided=tuple(law.expression for law in (best.proposal.law, *rivals)))
    best = without_idle_terms(case, noise, candidate_set, search, base, best)
    return LawChoice(best._replace(rivals=rivals))


def preferred(fitted: Sequence[FittedLaw]) -> FittedLaw:
    """The law with the fewest parameters, of as many the best one; another one where that lowers the error of whole
    runs left out by more than the standard error."""
    first, *others = sorted(fitted, key=lambda one: (len(one.proposal.law.parameters), one.deviance.sum()))
    for other in others:
        if Gain(first.log_error - other.log_error, 0.0).exceeds_standard_error:
            first = other
    return first


def near(ordered: Sequence[Proposal], distinct_chi2: float) -> list[Proposal]:
    """The first few proposals that are less than twice `distinct_chi2` above the best: in the segments the shape of a
    law is held, and the random force is one of three."""
    return [one for one in ordered if one.penalised - ordered[0].penalised < 2 * distinct_chi2][:TRIED]


def may_explain(search: Search, linear: Linear, proposal: Proposal) -> bool:
    """Whether the random force beside a law may become as small as that of an explanation: of its square the law takes
    away the share that it takes of the misfit in the segments, where the force is weaker by the first of `WEAKER`."""
    largest = float(np.max(linear.point.discrepancy.force / search.scales.force))
    return WEAKER[0] * largest * np.sqrt(1 - proposal.law.share) <= search.criteria.largest_random_force
