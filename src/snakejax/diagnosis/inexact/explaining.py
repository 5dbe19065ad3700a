"""Explaining recordings for which no model is exact."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Progress
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.estimation.discrepancy.kalman import Discrepancy
from snakejax.estimation.discrepancy.segment_dynamics import BODY
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.discrepancy.strength import scales_of
from snakejax.recording.run import Case, Noise

from ..explanation import Explanation, PoseError, Remainder, TriedCandidate, vehicle_constants
from ..latent_force.missing_force import LatentForce
from ..residuals.dependence import general_name, residual_dependence, significant_shares
from ..residuals.replays import replay_runs
from ..selection.candidates import CandidateSet
from ..selection.criteria import SelectionCriteria
from ..selection.steps import SelectionStep, raises_heldout_error
from .assessment import Assessment, assess
from .candidate_model import candidate_model, movable_parameters
from .confidence import LIKELY, RELEVANT, STAND_IN, SURE
from .evidence import ModelEvidence
from .fitted_law import FittedLaw
from .laws import LawChoices, choose_laws
from .left_out import with_predicting_effects
from .random_force import random_force
from .revision import search_effects
from .search import Linear, Search
from .steps import beside_stated_constants, calibrated


def supports(candidate_set: CandidateSet) -> bool:
    """Whether the structure of the model is one whose state is the pose and the velocities of the body."""
    model = candidate_set.problem.model
    zero = np.zeros(())
    return model.constraint.slips and model.constraint.frees_wheels and len(model.start((zero, zero, zero))[0]) == BODY


def find_effects(
    case: Case, noise: Noise, candidate_set: CandidateSet, base: Sequence[str], progress: Progress
) -> tuple[Search, Linear]:
    """Which effects `candidate_set` needs beside those of the `base`, with a random force and constants within priors:
    the search, and the problem linearised at its end.

    **Raises:** `FitError` where a simulation is not finite.
    """
    model = candidate_set.problem.model
    names = movable_parameters(model, candidate_set.tyre, candidate_set.candidates, base)
    segments = Segments(model, case.having("train"), names)
    scales = scales_of(segments, np.asarray(noise.channels), noise.correlation)
    priors = candidate_model(model, candidate_set.tyre, candidate_set.candidates, base, scales, case.constant_sd)
    search = Search(segments, priors, scales, candidate_set.criteria, progress)
    return search, with_predicting_effects(search, search_effects(search))


def assess_effects(
    case: Case,
    noise: Noise,
    candidate_set: CandidateSet,
    base: Sequence[str],
    search: Search,
    linear: Linear,
    evidence: ModelEvidence,
) -> Assessment:
    """What is reported about the effects at `linear`; where there is `evidence` of a random force there, with laws
    among them.

    **Raises:** `FitError` where a simulation is not finite.
    """
    choices = LawChoices()
    if evidence.has_force:
        choices = choose_laws(case, noise, candidate_set, search, linear, base)
    heldout = case.having("heldout")
    if not choices.laws:
        return assess(candidate_set, search, linear, tuple(base), heldout, {}, choices.undecided)
    last = choices.laws[-1]
    rivals = {law.name: tuple(rival.expression for rival in law.rivals) for law in choices.laws}
    kept = {name: others for name, others in rivals.items() if name in last.linear.point.effects}
    assessment = assess(last.candidate_set, last.search, last.linear, tuple(base), heldout, kept, choices.undecided)
    laws = [law for law in choices.laws if law.name in kept]
    return assessment._replace(law_force=force_without(laws, linear.point.discrepancy))


def force_without(laws: Sequence[FittedLaw], discrepancy: Discrepancy) -> LatentForce:
    """What is missing beside everything else of the model with `laws`: the random force as strong as `discrepancy`
    says, which was estimated without them. The share of a law is that of what those before it leave. After the laws
    stand those that predict runs left out as well."""
    last = laws[-1]
    search, values = last.search, last.search.values(last.linear)
    proposals, left = [], 1.0
    for law in laws:
        columns = list(search.model.candidates[law.name])
        values[columns] = search.model.neutral[columns]
        proposals.append(law.proposal.law._replace(share=left * law.proposal.law.share))
        left *= 1 - law.proposal.law.share
    point = last.linear.point._replace(values=values, discrepancy=discrepancy)
    force = random_force(search, point, last.candidate_set.switched).with_found(proposals)
    return dataclasses.replace(force, laws=(*force.laws, *(rival for law in laws for rival in law.rivals)))


def predicts_heldout_runs(assessment: Assessment, criteria: SelectionCriteria) -> bool:
    """Whether the held-out runs are as expected with the random force and noise of `assessment`; true without any."""
    check = assessment.check
    return check is None or (check.passed and assessment.inside("heldout") >= criteria.least_inside)


def explanation_of(
    case: Case, noise: Noise, assessment: Assessment, steps: Sequence[SelectionStep], explained: bool
) -> Explanation:
    """The explanation with the effects of `assessment`, which the `steps` from the base on add; `explained`: whether
    held-out runs are as it predicts them. Effects with which these are further off than without any, or that leave most
    of their error, do not explain them, however wide the bands of a prediction are."""
    base, final = steps[0], steps[-1]
    with_constants = base if _is_switched(steps) else calibrated(assessment)
    if final is base and with_constants.train.misfit < base.train.misfit:
        final = with_constants
    claimed = tuple(effect for effect in final.effects if effect not in base.effects)
    misleads = bool(claimed) and raises_heldout_error(base, final)
    noise_floor = PoseError(
        float(np.hypot(assessment.floor[0], assessment.floor[1])),
        float(assessment.floor[2]),
        "cameras and a random force" if assessment.evidence.has_force else "cameras",
    )
    share, explained_share = shares_of(steps)
    constants_share = max(0.0, shares_of([base, with_constants])[1])
    if claimed and not _is_switched(steps):
        alone = _error_beside_stated_constants(assessment, steps)
        of_first = divided_share(_error(base), _error(steps[1]), _error(with_constants), alone)
        share[claimed[0]], constants_share = of_first
    remainder = _remainder(final, noise_floor, assessment.undecided_laws)
    fails = bool(claimed) and leaves_most(explained_share, remainder, noise_floor, noise)
    verdict = ("explained" if claimed else "adequate") if explained and not (misleads or fails) else "unexplained"
    missing = None
    if verdict == "unexplained" and assessment.evidence.has_force:
        point = assessment.linear.point._replace(values=assessment.values)
        force = random_force(assessment.search, point, assessment.candidate_set.switched)
        missing = dataclasses.replace(force, depends_on=remainder.depends_on)
    return Explanation(
        case,
        noise,
        tuple(steps),
        verdict,
        claimed if verdict == "explained" else (),
        () if verdict == "explained" else claimed,
        base.left_out,
        missing,
        confidence={effect: _word(assessment, effect, share, misleads) for effect in assessment.effects},
        share=share,
        explained_share=explained_share,
        floor=noise_floor,
        remainder=remainder,
        candidates=_tried(assessment, steps, share),
        constants=vehicle_constants(final),
        constants_share=constants_share,
        bands=assessment.bands,
        odd_runs=assessment.odd_runs,
        law=assessment.law_force,
        calibrated=None if final is steps[-1] else final,
    )


def leaves_most(explained_share: float, remainder: Remainder, floor: PoseError, noise: Noise) -> bool:
    """Whether more of the squared error of unseen runs is left than taken away, and more of that is above the floor,
    which vehicle and cameras leave by themselves, than in it; channels in units of the `noise`."""
    size = np.array([float(noise.position), float(noise.heading)])
    rest, own = (float(np.sum((np.array([e.position_m, e.heading_rad]) / size) ** 2)) for e in (remainder, floor))
    return explained_share < 0.5 and rest > own


def _word(assessment: Assessment, effect: str, share: Mapping[str, float], misleads: bool) -> str:
    """How sure `effect` is: as the train runs say; a stand-in at most where the model `misleads` on held-out runs; and
    likely at most where no model is exact and it takes away less than `RELEVANT` of the squared error."""
    word = assessment.confidence[effect].word
    if misleads and word in (SURE, LIKELY):
        return STAND_IN
    exact = assessment.evidence.exact and assessment.law_force is None
    return LIKELY if word == SURE and not exact and share.get(effect, 0.0) < RELEVANT else word


def _is_switched(steps: Sequence[SelectionStep]) -> bool:
    """Whether the effects of `steps` act under another structure than that of the base."""
    return len(steps) > 1 and steps[1].name == LATERAL_SLIP_SWITCH


def _error_beside_stated_constants(assessment: Assessment, steps: Sequence[SelectionStep]) -> float:
    """The squared error with the first effect and the constants of the vehicle as stated; that of the base where such a
    model cannot be simulated, as then the effect alone takes nothing away."""
    try:
        return _error(beside_stated_constants(assessment, (steps[1].name,)))
    except FitError:
        return _error(steps[0])


def divided_share(base: float, both: float, with_constants: float, with_effect: float) -> tuple[float, float]:
    """The shares of the squared error of the base that are due to the first effect and to the constants of the vehicle,
    which are estimated with it: the fall by each of them, averaged over the two orders in which they may be added.

    The errors of the `base`, with `both`, with the constants alone, and with the effect alone; what makes the error
    larger takes nothing away.
    """
    with_constants, with_effect = min(base, with_constants), min(base, with_effect)
    of_effect = ((base - with_effect) + (with_constants - both)) / 2 / base
    return of_effect, (base - both) / base - of_effect


def _error(step: SelectionStep) -> float:
    """The squared error of held-out runs, or of train runs where none is held out."""
    return (step.heldout or step.train).misfit


def shares_of(steps: Sequence[SelectionStep]) -> tuple[dict[str, float], float]:
    """By effect the share of the squared error of the base that its step takes away, and that of all steps together.

    The error is that of held-out runs, or of train runs where none is held out.
    """
    return shares_of_errors(steps, [_error(step) for step in steps])


def shares_of_errors(steps: Sequence[SelectionStep], errors: Sequence[float]) -> tuple[dict[str, float], float]:
    """The shares of `errors`, one of each step."""
    share: dict[str, float] = {}
    for step, before, after in zip(steps[1:], errors[:-1], errors[1:], strict=True):
        share[step.name] = share.get(step.name, 0.0) + (before - after) / errors[0]
    return share, (errors[0] - errors[-1]) / errors[0]


def _remainder(final: SelectionStep, floor: PoseError, laws: tuple[str, ...]) -> Remainder:
    """What the final model leaves of unseen runs above the floor, in squares, and on what it depends in train runs."""
    judged = final.heldout or final.train
    tracks = [replay.track for replay in replay_runs(final.fitted) if replay.role == "train"]
    shares: dict[str, float] = {}
    for share in significant_shares(residual_dependence(tracks)):
        variable = general_name(share.variable)
        shares[variable] = max(share.share, shares.get(variable, 0.0))
    left = Remainder.above(floor, judged.position_m, judged.heading_rad)
    return left._replace(depends_on=tuple(sorted(shares.items(), key=lambda pair: -pair[1])), laws=laws)


def _tried(
    assessment: Assessment, steps: Sequence[SelectionStep], shares: dict[str, float]
) -> tuple[TriedCandidate, ...]:
    """One row for each candidate beside each step; `shares` of the effects that were taken."""
    rows, linear = [], assessment.linear
    for number in range(len(assessment.effects) + 1):
        here = assessment.effects[:number]
        offset = len(steps) - 1 - len(assessment.effects)
        for effect in linear.subsets.candidates:
            if effect not in here:
                row = _row(assessment, number + offset, here, effect)
                # What was taken has been simulated; the others are known by the linear problem alone.
                rows.append(row._replace(share=shares[effect]) if row.taken else row)
    return tuple(rows)


def _row(assessment: Assessment, number: int, here: tuple[str, ...], effect: str) -> TriedCandidate:
    subsets = assessment.linear.subsets
    best = subsets.with_effects([*here, effect])
    fall = subsets.with_effects(here).chi2 - best.chi2
    threshold = subsets.threshold(effect)
    taken = effect in assessment.effects and assessment.effects.index(effect) == len(here)
    twins = tuple(e for e in assessment.effects if effect in assessment.confidence[e].instead)
    if taken:
        why = f"taken: chi^2 falls by {fall:.4g}, by chance at most {threshold:.3g}"
    elif effect in assessment.effects:
        why = "taken in a later step"
    elif twins:
        why = f"these runs cannot distinguish it from {', '.join(twins)}"
    elif fall >= threshold and len(here) < len(assessment.effects):
        why = "the effects that were taken explain the same error"
    elif fall >= threshold:
        why = f"refused: it does not improve the prediction of omitted runs, although chi^2 falls by {fall:.4g}"
    else:
        why = f"refused: chi^2 falls by {fall:.3g}, by chance at most {threshold:.3g}"
    p = min(1.0, subsets.p_value(effect, fall) * len(assessment.search.model.candidates))
    share = assessment.predicted.share(here, effect)
    return TriedCandidate(number, effect, share, p, best.chi2 / assessment.predicted.samples, taken, why, twins)
