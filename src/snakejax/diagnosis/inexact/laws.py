"""A law beside a random force: proposed by the segments, then an effect of the model like any other.

A random force that is as strong as the law explains the same motion, so a law is hardly significant beside the force
that was estimated without it. The search therefore assumes a weaker force, together with the known effects that are
significant beside that one. Then everything is fitted anew, the random force included. The law must be significant
among all forms that were tried, and must predict omitted train runs better.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, ProgressEvent
from snakejax.dynamics.law import law_class
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.recording.run import Case, Noise

from ..law.adding import candidate_set_with, law_names
from ..law.grammar import families
from ..law.search import ProposedLaw
from ..law.search import search as search_laws
from ..selection.candidates import CandidateSet
from .candidate_model import CandidateModel, candidate_model, movable_parameters
from .confidence import beside_unknown
from .left_out import Gain, left_out, with_predicting_effects
from .revision import revised
from .search import Linear, Point, Search
from .segment_force import force_windows
from .subsets import choose, prune

WEAKER = 1 / 3
"""A law is looked for beside this share of the random force: a tenth of its power, so that the law is taken for the
rest."""
TRIED = 5
"""So many laws are fitted with everything else, at most."""
WIDE = 3.0
"""Prior standard deviation of a number of a law, as a multiple of its value in the segments."""


class Proposal(NamedTuple):
    """A `law` that the segments propose, the best of `forms`, beside the effects of `weak`. `penalised`: chi^2 on runs
    left out with it, and what its parameters and the effects cost."""

    weak: Linear
    law: ProposedLaw
    forms: int
    penalised: float

    @property
    def subject(self) -> tuple[str, tuple[str, ...]]:
        """On what it acts, and on which variables it depends."""
        return self.law.family.action, self.law.family.variables

    @property
    def form(self) -> tuple[frozenset[tuple[tuple[str, str], ...]], int]:
        """Its formulas without the names of their amplitudes, and the number of parameters inside them."""
        return frozenset(term.formulas for term in self.law.family.terms), len(self.law.family.shape)


class FittedLaw(NamedTuple):
    """The law `name` in the model at `linear`, whose candidates `candidate_set` and `search` hold.

    `deviance` (N,): -2 log density of train runs left out, block by block, under the noise and the random force beside
    the law; `mean_square` (R,): the error of whole runs left out; `rivals`: other laws, of another action or of other
    variables, that do as well: other motions would tell.
    """

    name: str
    candidate_set: CandidateSet
    search: Search
    linear: Linear
    deviance: np.ndarray
    mean_square: np.ndarray
    rivals: tuple[str, ...] = ()


class LawChoice(NamedTuple):
    """The `law` that is kept, or None; then `undecided` are the formulas of those among which these runs cannot
    choose."""

    law: FittedLaw | None = None
    undecided: tuple[str, ...] = ()


def choose_law(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, linear: Linear, base: Sequence[str]
) -> LawChoice:
    """The law that predicts train runs left out best.

    Of laws that do not differ by `distinct_chi2` from the best, see `preferred`. There is none where no law predicts
    them better than `linear` does, each under its own random force, by more than the standard error; or where there is
    but one run; nor where it takes the place of a known effect and these runs cannot distinguish the two. A law that
    raises the error of whole runs left out is not kept: beside a random force it may follow each run better, and lead a
    simulation astray. Where laws of other variables do as well, it is not known which is right, and a wrong one may do
    harm in other motions: there it must lower that error by more than the standard error.
    """
    if len(linear.gram) < 2:
        return LawChoice()
    search.progress(ProgressEvent(Phase.LAW_SEARCH))
    needed = with_needed_effects(search, linear)
    ordered = distinct([one for weak in beside_weaker_force(search, needed) for one in proposed(search, weak)])
    before, effects = left_out(search, linear), linear.point.effects
    whole = before.mean_square(effects)
    fitted: list[tuple[Proposal, FittedLaw]] = []
    for one in near(ordered, search.criteria.distinct_chi2):
        search.progress(ProgressEvent(Phase.LAW_FIT, f"fitting {one.law.expression} together with a random force"))
        with_one = _fitted(case, noise, candidate_set, search, base, one)
        if with_one is not None:
            fitted.append((one, with_one))
    most = min((with_one.deviance.sum() for _, with_one in fitted), default=0.0) + search.criteria.distinct_chi2
    as_good = [pair for pair in fitted if pair[1].deviance.sum() < most]
    predicting = [pair for pair in as_good if pair[1].mean_square.sum() < whole.sum()]
    if not predicting:
        return LawChoice()
    proposal, best = preferred(predicting)
    gain = Gain(before.deviance(effects) - best.deviance, 0.0)
    displaced = set(effects) - set(best.linear.point.effects)
    if not gain.exceeds_standard_error or (displaced and gain.by_part.sum() < search.criteria.distinct_chi2):
        return LawChoice()
    rivals = tuple(one.law.expression for one, _ in as_good if one.subject != proposal.subject)
    if rivals and not Gain(whole - best.mean_square, 0.0).exceeds_standard_error:
        return LawChoice(undecided=(proposal.law.expression, *rivals))
    return LawChoice(best._replace(rivals=rivals))


def preferred(fitted: Sequence[tuple[Proposal, FittedLaw]]) -> tuple[Proposal, FittedLaw]:
    """The law with the fewest parameters, of as many the best one; another one where that lowers the error of whole
    runs left out by more than the standard error."""
    first, *others = sorted(fitted, key=lambda pair: (len(pair[0].law.parameters), pair[1].deviance.sum()))
    for other in others:
        if Gain(first[1].mean_square - other[1].mean_square, 0.0).exceeds_standard_error:
            first = other
    return first


def near(ordered: Sequence[Proposal], distinct_chi2: float) -> list[Proposal]:
    """The first few proposals, whose chi^2 on runs left out is less than twice `distinct_chi2` above the best: in the
    segments the parameters beside a law are held, and the random force is weaker than it is."""
    return [one for one in ordered if one.penalised - ordered[0].penalised < 2 * distinct_chi2][:TRIED]


def _fitted(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, base: Sequence[str], one: Proposal
) -> FittedLaw | None:
    """The model with the law of a proposal, its effects chosen again; None where the law is not among them then."""
    (name,) = law_names(1, candidate_set)
    own_set, own = search_with(case, noise, candidate_set, search, base, {name: one.law}, {name: one.forms})
    try:
        linear = with_predicting_effects(own, revised(own, start_of(search, own, one.weak, name, one.law)))
    except FitError:
        return None
    effects = linear.point.effects
    if name not in effects:
        return None
    without = left_out(own, linear)
    return FittedLaw(name, own_set, own, linear, without.deviance(effects), without.mean_square(effects))


def distinct(proposals: Sequence[Proposal]) -> list[Proposal]:
    """The proposals, the best first, each form once: beside those effects with which it is best."""
    of_form: dict[object, Proposal] = {}
    for one in sorted(proposals, key=lambda one: one.penalised):
        of_form.setdefault(one.form, one)
    return list(of_form.values())


def with_needed_effects(search: Search, linear: Linear) -> Linear:
    """The fit with only those effects of `linear` that are needed even if a share `cautious_force` of the forces had
    another cause: the others may stand in for the law, which then cannot be seen beside them."""
    effects = linear.point.effects
    needed = prune(beside_unknown(search, linear, search.criteria.cautious_force, exact=False), effects)
    return linear if set(needed) == set(effects) else search.refit(linear.point, needed)


def beside_weaker_force(search: Search, linear: Linear) -> list[Linear]:
    """`linear` with a weaker random force, with its effects and, where they are others, with those that are significant
    beside that force: some of them are there, and some stand in for the law."""
    point = linear.point
    weaker = point.discrepancy.without_force(np.maximum(WEAKER * point.discrepancy.force, search.scales.least_force))
    subsets = linear.under(weaker)
    sets = dict.fromkeys(tuple(sorted(effects)) for effects in (point.effects, choose(subsets, point.effects)))
    return [linear._replace(point=point._replace(discrepancy=weaker, effects=e), subsets=subsets) for e in sets]


def proposed(search: Search, weak: Linear) -> list[Proposal]:
    """The laws that the segments propose beside the effects of `weak`."""
    windows = force_windows(search, weak)
    forms = sum(1 for _ in families(windows.ranges(), windows.wheel))
    thresholds = sum(weak.subsets.threshold(effect) for effect in weak.point.effects)
    return [Proposal(weak, law, forms, law.score + thresholds) for law in search_laws(windows)]


def search_with(
    case: Case,
    noise: Noise,
    like: CandidateSet,
    search: Search,
    base: Sequence[str],
    laws: dict[str, ProposedLaw],
    trials: dict[str, int],
) -> tuple[CandidateSet, Search]:
    """The candidates of `like` and the `laws`, and the search among them on the same runs."""
    built = {name: law_class(law.expression, law.parameters)() for name, law in laws.items()}
    own = candidate_set_with(case, noise, like, tuple(like.candidates), built)
    model = own.problem.model
    segments = Segments(model, search.segments.runs, movable_parameters(model, own.tyre, own.candidates, base))
    priors = candidate_model(model, own.tyre, own.candidates, base, search.scales, case.constant_sd)
    for name, law in laws.items():
        priors = _with_wide_priors(priors, name, law)
    return own, search._replace(segments=segments, model=priors, trials=trials)


def _with_wide_priors(model: CandidateModel, name: str, law: ProposedLaw) -> CandidateModel:
    """`model` with weak priors of the numbers of a law: each is of the size that the segments say."""
    sd = model.sd.copy()
    for k in model.candidates[name]:
        value = law.values[model.names[k].rsplit(".", 1)[-1]]
        sd[k] = WIDE * max(abs(value), 1e-3)
    return model._replace(sd=sd)


def start_of(search: Search, own: Search, weak: Linear, name: str, law: ProposedLaw) -> Point:
    """Where the fit with the `law` begins: all else where it stands beside the law in the segments."""
    free = search.model.free(weak.point.effects)
    step = np.zeros(len(search.model.names))
    step[free] = law.steps
    point = search.stepped(weak, step, weak.point.effects)
    known = dict(zip(search.model.names, point.values, strict=True))
    known |= {f"effects.{name}.{part}": value for part, value in law.values.items()}
    values = np.array([known[parameter] for parameter in own.model.names])
    return point._replace(values=values, effects=(*point.effects, name))
