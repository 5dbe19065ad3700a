"""What is reported about the effects that a search has found, as plain numbers."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.progress import Phase, ProgressEvent
from snakejax.estimation.discrepancy.kalman import gram_matrices
from snakejax.estimation.discrepancy.least_squares import Optimum
from snakejax.estimation.discrepancy.open_loop import open_loop
from snakejax.estimation.uncertainty import Estimate, estimate_of
from snakejax.recording.run import Run

from ..explanation import RunBand
from ..latent_force.missing_force import LatentForce
from ..odd_runs import OddRun, odd_runs
from ..selection.candidates import CandidateSet
from .confidence import RELEVANT, WORDS, Confidence, confidence
from .evidence import ModelEvidence, model_evidence
from .left_out import LeftOut, left_out
from .prediction import PredictiveCheck, bands, left_out_bands, likelier_segments, predictive_check, simulated_segments
from .search import Linear, Search
from .subsets import Subsets


class Assessment(NamedTuple):
    """What a search has found.

    `base`: effects that were in the model from the start; `effects`, the surest first; `wide`: the problem under the
    discrepancy of intervals (`interval_force`), without the bounds of what the fit has inside them; `confidence` of
    each effect; `predicted`: runs left out; `evidence` of what else is there; `check` of the held-out runs; `floor`
    (3,) [m, m, rad]: what vehicle and cameras leave of whole runs; `bands` of all runs; `odd_runs` among the train
    runs; `candidate_set`: that of the search; `undecided_laws`: formulas of laws among which the runs cannot choose, so
    that none of them is an effect; `law_force`: what is missing without the law among the effects, and that law.
    """

    search: Search
    linear: Linear
    base: tuple[str, ...]
    effects: tuple[str, ...]
    wide: Subsets
    confidence: dict[str, Confidence]
    predicted: LeftOut
    evidence: ModelEvidence
    check: PredictiveCheck | None
    floor: np.ndarray
    bands: tuple[RunBand, ...]
    odd_runs: tuple[OddRun, ...]
    candidate_set: CandidateSet
    undecided_laws: tuple[str, ...] = ()
    law_force: LatentForce | None = None

    def inside(self, role: str) -> float:
        """The mean share of the samples of the runs of `role` inside the bands of their predictions; 1 without any."""
        shares = [band.inside for band in self.bands if band.role == role]
        return float(np.mean(shares)) if shares else 1.0

    @property
    def random_force_share(self) -> float:
        """The largest random force, as a share of the force that moves the vehicle; 0 where there is none: the estimate
        of one that short runs do not show says nothing."""
        if not self.evidence.has_force:
            return 0.0
        return float(np.max(self.linear.point.discrepancy.force / self.search.scales.force))

    @property
    def values(self) -> np.ndarray:
        """The values (P,) of all parameters with all effects."""
        return self.search.values(self.linear)

    @property
    def converged(self) -> bool:
        """Whether the fit with all effects has converged."""
        return self.linear.has_converged

    def estimates(self, effects: tuple[str, ...], values: np.ndarray) -> dict[str, Estimate]:
        """The estimates of the parameters free in a model with `effects`, by name, at their `values`."""
        return estimates_at(self.search, self.wide.with_effects(effects), values, self.search.model.free(effects))


def estimates_at(search: Search, best: Optimum, values: np.ndarray, columns: Iterable[int]) -> dict[str, Estimate]:
    """The `values` of the parameters numbered `columns`, by name, with the errors of the optimum `best`."""
    estimates = {}
    for k in columns:
        domain, held = search.segments.domains[k], k not in best.free
        estimates[search.model.names[k]] = estimate_of(float(values[k]), float(best.sd[k]), domain, held)
    return estimates


def assess(
    candidate_set: CandidateSet,
    search: Search,
    linear: Linear,
    base: tuple[str, ...],
    heldout: Sequence[Run],
    laws: Mapping[str, tuple[str, ...]],
    undecided: tuple[str, ...] = (),
) -> Assessment:
    """The report on the point of `linear`, validated on the `heldout` runs.

    `base`: effects always in the model. `laws`: the laws among its effects, with other laws that fit equally well.
    `undecided`: laws that were not added, because these runs cannot distinguish them.
    """
    criteria, scales = search.criteria, search.scales
    evidence = model_evidence(search, linear)
    # Intervals count a force that the runs do not show, as far as it was estimated; predictions do without it. Where
    # the model is not exact, what it lacks may be too regular to be seen as a random force, or a law or an effect may
    # stand in for it.
    wide = expected = predicting = linear.point.discrepancy
    exact = evidence.exact and not laws
    if not exact:
        wide = wide.enlarged(criteria.interval_force * scales.force, longest=criteria.shortest_force)
    if evidence.has_force:
        expected = wide
    else:
        expected = predicting = expected.without_force(scales.least_force)
    predicted = left_out(search, linear)
    sure = confidence(search, linear, predicted, laws, exact)
    effects = surest_first({effect: one.word for effect, one in sure.items()}, predicted.contributions(tuple(sure)))
    problem = linear.under(wide)
    # What the fit has inside its bounds has an error, also where a larger force would move it to one.
    of_intervals = problem.unbounded(linear.subsets.with_effects(effects).free)
    search.progress(ProgressEvent(Phase.PREDICTIVE_CHECK))
    best = of_intervals.with_effects(effects)
    gram, _ = gram_matrices(linear.data, wide)
    predictions = left_out_bands(search.segments.runs, linear.data, problem, gram, effects, predicting)
    check = None
    if heldout:
        linearised = likelier_segments if evidence.has_force else simulated_segments
        unseen = linearised(search, heldout, search.values(linear), expected)
        check = predictive_check(unseen, best, expected)
        predictions += bands(heldout, unseen, best, predicting)
    floor = np.sqrt((open_loop(linear.data, predicting).rms_sd ** 2).mean(axis=0))
    odd = _odd_runs(search, linear, problem, gram)
    results = (of_intervals, sure, predicted, evidence, check, floor, predictions, odd)
    return Assessment(search, linear, base, effects, *results, candidate_set, undecided)


def surest_first(words: Mapping[str, str], contributions: Mapping[str, float]) -> tuple[str, ...]:
    """The effects by the word for how sure each is, in the order of `WORDS`; of equals that which contributes most
    first. Behind all others are those that contribute less than `RELEVANT` of what all do, however sure they are."""
    least = RELEVANT * sum(contributions.values())

    def place(effect: str) -> tuple[bool, int, float]:
        return contributions[effect] < least, WORDS.index(words[effect]), -contributions[effect]

    return tuple(sorted(words, key=place))


def _odd_runs(search: Search, linear: Linear, problem: Subsets, gram: np.ndarray) -> tuple[OddRun, ...]:
    """The train runs to which the parameters at `linear` do not apply, by the Gram matrices of the runs."""
    model, values = search.model, linear.point.values
    names = {name: k for k, name in enumerate(model.names)}
    free = model.free(linear.point.effects)
    odd_of_model = odd_runs(gram, [run.name for run in search.segments.runs], names, free, problem.prior.precision)
    numbers = [names[odd.parameter] for odd in odd_of_model]
    return tuple(
        odd.in_units(search.segments.domains[k], values[k]) for odd, k in zip(odd_of_model, numbers, strict=True)
    )
