"""A law beside a random force: proposed by the segments, then an effect of the model like any other.

A random force that is as strong as the law explains the same motion, so that a law is hardly told beside the force that
was estimated without it. It is looked for beside a weaker one, together with the known effects that show there; then
everything is fitted anew, the random force included, and the law must be significant among all forms that were tried
and must predict whole train runs better that were left out.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.progress import Phase, ProgressEvent
from snakejax.dynamics.law import law_class
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.recording.run import Case, Noise

from ..law.adding import candidate_set_with, law_names, predicts_better
from ..law.grammar import families
from ..law.search import ProposedLaw
from ..law.search import search as search_laws
from ..selection.candidates import CandidateSet
from .candidate_model import CandidateModel, candidate_model, movable_parameters
from .left_out import left_out, with_predicting_effects
from .search import Linear, Point, Search, revised
from .segment_force import force_windows
from .subsets import choose

WEAKER = 1 / 3
"""A law is looked for beside this share of the random force: a tenth of its power, so that the law is taken for the
rest."""
WIDE = 3.0
"""Prior standard deviation of a number of a law, as a multiple of its value in the segments."""


class FoundLaw(NamedTuple):
    """The law `name` in the model at `linear`, whose candidates `candidate_set` and `search` hold; `rivals`: the
    expressions of other laws that do as well in the segments."""

    name: str
    rivals: tuple[str, ...]
    candidate_set: CandidateSet
    search: Search
    linear: Linear


def with_law(
    case: Case, noise: Noise, candidate_set: CandidateSet, search: Search, linear: Linear, base: Sequence[str]
) -> FoundLaw | None:
    """The model with the law that predicts train runs left out best; None where none predicts them better than that of
    `linear` does, by more than its standard error, or where there is but one run."""
    if len(linear.gram) < 2:
        return None
    search.progress(ProgressEvent(Phase.LAW_SEARCH))
    weak = beside_weaker_force(search, linear)
    windows = force_windows(search, weak)
    laws = search_laws(windows)
    if not laws:
        return None
    best, (name,) = laws[0], law_names(1)
    search.progress(ProgressEvent(Phase.LAW_FIT, f"fitting {best.expression} beside a random force"))
    forms = sum(1 for _ in families(windows.ranges(), windows.wheel))
    own_set, own = search_with(case, noise, candidate_set, search, base, {name: best}, {name: forms})
    found = with_predicting_effects(own, revised(own, start_of(search, own, weak, name, best)))
    effects, known = found.point.effects, linear.point.effects
    if name not in effects:
        return None
    after, before = left_out(own, found).error(effects), left_out(search, linear).error(known)
    if not predicts_better(after, before):
        return None
    return FoundLaw(name, rivals(laws, search.criteria.distinct_chi2), own_set, own, found)


def rivals(laws: Sequence[ProposedLaw], distinct_chi2: float) -> tuple[str, ...]:
    """The laws of another action or of other variables than the first, that leave chi^2 on runs left out, with what
    their parameters cost, less than `distinct_chi2` above that of the first."""
    best = laws[0]

    def of(law: ProposedLaw) -> tuple[str, tuple[str, ...]]:
        return law.family.action, law.family.variables

    return tuple(law.expression for law in laws[1:] if of(law) != of(best) and law.score - best.score < distinct_chi2)


def beside_weaker_force(search: Search, linear: Linear) -> Linear:
    """`linear` with a weaker random force, and the known effects that are significant beside it."""
    point = linear.point
    weaker = point.discrepancy.without_force(np.maximum(WEAKER * point.discrepancy.force, search.scales.least_force))
    subsets = linear.under(weaker)
    effects = choose(subsets, point.effects)
    return linear._replace(point=point._replace(discrepancy=weaker, effects=tuple(effects)), subsets=subsets)


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
    there = search.stepped(weak, step, weak.point.effects)
    known = dict(zip(search.model.names, there.values, strict=True))
    known |= {f"effects.{name}.{part}": value for part, value in law.values.items()}
    values = np.array([known[parameter] for parameter in own.model.names])
    return there._replace(values=values, effects=(*there.effects, name))
