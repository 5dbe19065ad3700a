"""A law of the segments as an effect of the model, fitted together with everything else."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.dynamics.law import law_class
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.recording.run import Case, Noise

from ..law.fitting import candidate_set_with, law_names
from ..law.search import ProposedLaw
from ..selection.candidates import CandidateSet
from .candidate_model import CandidateModel, candidate_model, movable_parameters
from .evidence import model_evidence
from .left_out import Gain, left_out, with_predicting_effects
from .revision import revised
from .search import Linear, Point, Search

WIDE = 3.0
"""Prior standard deviation of a number of a law, as a multiple of its value in the segments."""


class Proposal(NamedTuple):
    """A `law` that the segments propose beside the effects of `weak`. `penalised`: -2 log likelihood with it, and what
    it and the effects cost."""

    weak: Linear
    law: ProposedLaw
    penalised: float

    @property
    def subject(self) -> tuple[str, tuple[str, ...]]:
        """On what it acts, and on which variables it depends."""
        return self.law.family.action, self.law.family.variables

    def without(self, amplitude: str) -> "Proposal":
        """The same without the term of this `amplitude`."""
        law = self.law
        family = law.family._replace(terms=tuple(term for term in law.family.terms if term.amplitude != amplitude))
        parameters = tuple(part for part in law.parameters if part.name != amplitude)
        values = {name: value for name, value in law.values.items() if name != amplitude}
        shorter = law._replace(expression=family.expression(), parameters=parameters, values=values, family=family)
        return self._replace(law=shorter)


class FittedLaw(NamedTuple):
    """The law `name` of a `proposal` in the model at `linear`, whose candidates `candidate_set` and `search` hold.

    `deviance` (N,): -2 log density of train runs left out, block by block, under the noise and the random force beside
    the law; `log_error` (R,): ln of the mean square error of whole runs left out; `rivals`: other laws, of another
    action or of other variables, that do as well: other motions would tell.
    """

    name: str
    proposal: Proposal
    candidate_set: CandidateSet
    search: Search
    linear: Linear
    deviance: np.ndarray
    log_error: np.ndarray
    rivals: tuple[ProposedLaw, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether nothing but white noise is left beside the law."""
        return model_evidence(self.search, self.linear).exact


def fit_law(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, base: Sequence[str], proposal: Proposal
) -> FittedLaw | None:
    """The model with the law of a proposal, its effects chosen again; None where the law is not among them then."""
    (name,) = law_names(1, candidate_set)
    own_set, own = search_with(case, noise, candidate_set, search, base, name, proposal)
    try:
        start = start_of(search, own, proposal.weak, name, proposal.law)
        linear = with_predicting_effects(own, revised(own, start))
    except FitError:
        return None
    return _judged(name, proposal, own_set, own, linear) if name in linear.point.effects else None


def _judged(name: str, proposal: Proposal, own_set: CandidateSet, own: Search, linear: Linear) -> FittedLaw:
    without, effects = left_out(own, linear), linear.point.effects
    error = np.log(without.mean_square(effects))
    return FittedLaw(name, proposal, own_set, own, linear, without.deviance(effects), error)


def without_idle_terms(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, base: Sequence[str], fitted: FittedLaw
) -> FittedLaw:
    """`fitted` without those terms of its law that these runs do not show: one after the other is left out while -2 log
    density of train runs left out rises by less than `distinct_chi2` in all, and the error of whole runs left out by
    less than its standard error.

    In the segments, beside a weaker force, a term may seem to be there that is not.
    """
    most = fitted.deviance.sum() + search.criteria.distinct_chi2
    while len(fitted.proposal.law.family.terms) > 1 and not fitted.proposal.law.family.whole:
        without = _deviances_without_terms(fitted)
        amplitude = min(without, key=without.__getitem__)
        if not without[amplitude] < most:
            break
        proposal = fitted.proposal.without(amplitude)
        own_set, own = search_with(case, noise, candidate_set, search, base, fitted.name, proposal)
        point = fitted.linear.point
        values = _values_in(own, fitted.search, point.values, {})
        try:
            linear = own.refit(point._replace(values=values), point.effects)
        except FitError:
            break
        shorter = _judged(fitted.name, proposal, own_set, own, linear)
        worse = Gain(shorter.log_error - fitted.log_error, 0.0)
        if not shorter.deviance.sum() < most or worse.exceeds_standard_error:
            break
        fitted = shorter
    return fitted


def _deviances_without_terms(fitted: FittedLaw) -> dict[str, float]:
    """-2 log density of train runs left out without each term of the law, by the name of its amplitude, where all else
    is linear."""
    linear, name = fitted.linear, fitted.name
    whole, subsets = left_out(fitted.search, linear), linear.subsets
    deviances = {}
    for term in fitted.proposal.law.family.terms:
        column = fitted.search.model.names.index(f"effects.{name}.{term.amplitude}")
        # The term as a candidate of its own, which is absent.
        split, _ = subsets.split(name, column)
        without = whole._replace(linear=linear._replace(subsets=split))
        deviances[term.amplitude] = float(without.deviance(linear.point.effects).sum())
    return deviances


def search_with(
    case: Case,
    noise: Noise,
    like: CandidateSet,
    search: Search,
    base: Sequence[str],
    name: str,
    proposal: Proposal,
) -> tuple[CandidateSet, Search]:
    """The candidates of `like` and the law of `proposal`, called `name`, and the search among them on the same runs."""
    law = proposal.law
    built = {name: law_class(law.expression, law.parameters)()}
    own = candidate_set_with(case, noise, like, tuple(like.candidates), built)
    model = own.problem.model
    segments = Segments(model, search.segments.runs, movable_parameters(model, own.tyre, own.candidates, base))
    priors = candidate_model(model, own.tyre, own.candidates, base, search.scales, case.constant_sd)
    priors = _with_wide_priors(priors, search.model, name, law)
    return own, search._replace(segments=segments, model=priors, trials={**search.trials, name: law.forms})


def _with_wide_priors(model: CandidateModel, known: CandidateModel, name: str, law: ProposedLaw) -> CandidateModel:
    """`model` with the priors of the parameters that are `known`, and weak ones of the numbers of a law: each is of the
    size that the segments say, those of a smooth function of the size of the largest."""
    sd_of = dict(zip(known.names, known.sd, strict=True))
    sd = np.array([sd_of.get(parameter, own) for parameter, own in zip(model.names, model.sd, strict=True)])
    least = max(abs(value) for value in law.values.values()) if law.family.together else 1e-3
    for k in model.candidates[name]:
        value = law.values[model.names[k].rsplit(".", 1)[-1]]
        sd[k] = WIDE * max(abs(value), least)
    return model._replace(sd=sd)


def start_of(search: Search, own: Search, weak: Linear, name: str, law: ProposedLaw) -> Point:
    """Where the fit with the `law` begins: all else where it stands beside the law in the segments."""
    free = search.model.free(weak.point.effects)
    step = np.zeros(len(search.model.names))
    step[free] = law.steps
    point = search.stepped(weak, step, weak.point.effects)
    of_law = {f"effects.{name}.{part}": value for part, value in law.values.items()}
    values = _values_in(own, search, point.values, of_law)
    return point._replace(values=values, effects=(*point.effects, name))


def _values_in(own: Search, search: Search, values: np.ndarray, others: dict[str, float]) -> np.ndarray:
    """The `values` of the parameters of `search`, and those of `others` by name, in the order of `own`."""
    known = dict(zip(search.model.names, values, strict=True)) | others
    return np.array([known[parameter] for parameter in own.model.names])
