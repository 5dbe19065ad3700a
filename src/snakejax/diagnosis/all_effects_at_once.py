"""The explanation by effects that are chosen together: of boards for which no model is exact, and of exact boards with
more effects than a search on whole runs adds."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from snakejax.core.errors import FitError
from snakejax.core.progress import Progress
from snakejax.estimation.fit_workspace import fit_heldout_starts
from snakejax.estimation.goodness_of_fit import consistent_with_noise, largest_noise_misfit
from snakejax.recording.run import Case, Noise

from .diagnosing import BaseDiagnosis
from .exact_checks import bands_of
from .explaining_by_law import by_exact_law
from .explanation import Explanation
from .inexact.assessment import Assessment
from .inexact.evidence import ModelEvidence, model_evidence
from .inexact.explaining import assess_effects, explanation_of, find_effects, predicts_heldout_runs, supports
from .inexact.search import Linear, Search
from .inexact.steps import steps_of
from .selection.acceptance import heldout_consistent
from .selection.beam_search import CandidateSubset
from .selection.candidates import CandidateFit, CandidateSet
from .selection.refit import refit
from .selection.steps import SelectionStep


class EffectsAtOnce(NamedTuple):
    """Effects of `candidate_set` that were chosen together, beside a random force, wandering noise and constants within
    their priors: the `search`, the problem linearised at its end, and the `evidence` there."""

    candidate_set: CandidateSet
    base: tuple[str, ...]
    search: Search
    linear: Linear
    evidence: ModelEvidence

    @property
    def few(self) -> CandidateSubset | None:
        """A few effects with which the model is exact, with the values that segments give them; None if it is not, or
        there are more of them."""
        effects = self.linear.point.effects
        if not self.evidence.exact or len(effects) > self.candidate_set.criteria.most_effects_at_once:
            return None
        values = dict(zip(self.search.model.names, self.linear.point.values, strict=True))
        return CandidateSubset((*self.base, *effects), self.candidate_set.problem.values() | values)


def choose_effects_at_once(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, progress: Progress
) -> EffectsAtOnce | None:
    """The effects that the train runs need together, under the freer structure; None where that cannot be simulated."""
    candidate_set = diagnosis.switched[0] if diagnosis.switched else diagnosis.base.candidate_set
    if not supports(candidate_set):
        return None
    base = diagnosis.base.step.effects
    try:
        search, linear = find_effects(case, noise, candidate_set, base, progress)
    except FitError:
        return None
    return EffectsAtOnce(candidate_set, base, search, linear, model_evidence(search, linear))


def explain_inexact(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, at_once: EffectsAtOnce, progress: Progress
) -> Explanation | None:
    """The explanation by the effects of `at_once`; or by a law in the place of their random force, where with one there
    is only white noise.

    None where the effects leave more than noise, unless all that they leave is noise that wanders, and where a model of
    some of them cannot be simulated. None where a law is lacking: its force is too large for a random one, errors grow
    faster than a random force lets them, or the effects do not lower the error.
    """
    law_is_sought = at_once.evidence.suggests_law
    by_law = by_exact_law(case, noise, diagnosis, progress) if law_is_sought else None
    if by_law is not None:
        return by_law
    try:
        assessment = assess_effects(case, noise, *at_once)
    except FitError:
        return None
    if not law_is_sought and assessment.evidence.exact and assessment.law_force is not None:
        by_law = by_exact_law(case, noise, diagnosis, progress)
        if by_law is not None:
            return by_law
    explanation = _by_effects(case, noise, diagnosis, assessment)
    if law_is_sought or explanation is None or not _law_may_explain(assessment, explanation):
        return explanation
    return by_exact_law(case, noise, diagnosis, progress) or explanation


def _by_effects(case: Case, noise: Noise, diagnosis: BaseDiagnosis, assessment: Assessment) -> Explanation | None:
    """The explanation by the effects of `assessment`; None, see `explain_inexact`, and where the model is exact with a
    few known effects."""
    candidate_set, exact = assessment.candidate_set, assessment.evidence.exact
    criteria = candidate_set.criteria
    few = len(assessment.effects) <= criteria.most_effects_at_once
    if exact and few and assessment.law_force is None:
        return None
    if assessment.random_force_share > criteria.largest_random_force:
        return None
    if assessment.inside("train") < criteria.least_inside:
        return None
    try:
        steps = (diagnosis.base.record, *steps_of(assessment))
    except FitError:
        return None
    if not _lower_error(steps):
        return None
    if not exact:
        return explanation_of(case, noise, assessment, steps, predicts_heldout_runs(assessment, criteria))
    fit_set, fit = _fitted_to_whole_runs(candidate_set, assessment)
    if not consistent_with_noise(fit.solution):
        return None
    heldout = fit_heldout_starts(fit_set.problem, fit.solution.values)
    explanation = explanation_of(case, noise, assessment, steps, heldout_consistent(fit_set, fit, heldout))
    return dataclasses.replace(explanation, bands=bands_of(steps[-1].fitted))


def _law_may_explain(assessment: Assessment, explanation: Explanation) -> bool:
    """Whether a law may leave only noise where the effects do not: without a random force and with white noise, they
    leave more."""
    evidence, train = assessment.evidence, explanation.final.train
    inexact = evidence.has_force or evidence.noise_wanders
    return not (evidence.exact or inexact) and train.misfit > largest_noise_misfit(train.samples)


def _fitted_to_whole_runs(candidate_set: CandidateSet, assessment: Assessment) -> tuple[CandidateSet, CandidateFit]:
    """All effects of `assessment` fitted to whole train runs, and the candidates with room for their parameters."""
    effects = (*assessment.base, *assessment.effects)
    problem = candidate_set.problem
    width = max(problem.width, len(candidate_set.free(effects)))
    wide = dataclasses.replace(candidate_set, problem=dataclasses.replace(problem, width=width))
    values = dict(zip(assessment.search.model.names, assessment.linear.point.values, strict=True))
    return wide, CandidateFit(effects, refit(wide, effects, problem.values() | values))


def _lower_error(steps: Sequence[SelectionStep]) -> bool:
    """Whether the effects of the last step, where it has any, lower the error of whole train runs that the base leaves.

    The likelihood with a random force may prefer effects that do not: they then stand in for a law that the model
    lacks, and the force takes up what they cannot do.
    """
    base, final = steps[0], steps[-1]
    return set(final.effects) <= set(base.effects) or final.train.misfit < base.train.misfit
