"""The explanation by laws of the missing force, alone or beside known effects."""

from collections.abc import Sequence

from snakejax.core.progress import Progress
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.recording.run import Case, Noise

from .diagnosing import BaseDiagnosis
from .exact_explanation import exact_explanation, leaves_only_noise
from .explanation import Explanation
from .latent_force.missing_force import LatentForce, choose_structure, estimate_latent_force
from .law.adding import best_laws
from .law.exact_laws import exact_law, exact_smooth_law
from .law.fitting import AddedLaws
from .law.known_effects import known_effects_beside, law_beside_effects
from .selection.candidates import CandidateFit
from .selection.ranking import trial_order
from .selection.working_step import WorkingStep, selection_step

BESIDE_A_LAW = 2
"""So many known effects, those that lower the misfit most, are tried with a law each."""


def with_laws(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, last: WorkingStep, missing: LatentForce, progress: Progress
) -> tuple[list[WorkingStep], LatentForce]:
    """The steps to the model with the laws of the missing force, and with known effects beside them where they leave
    more than noise; none where no law predicts runs left out. And the force in which the last law was found."""
    like = _structure_of(diagnosis, missing)
    steps = [] if like is diagnosis.base else [like]
    laws = best_laws(case, noise, like, last, missing, progress)
    if not laws:
        return [], missing
    first, missing = len(steps), missing.with_also(laws[0].laws)
    steps += [selection_step(added.candidate_set, "added", added.names[-1], added.fit) for added in laws]
    if not consistent_with_noise(laws[-1].fit.solution):
        beside = known_effects_beside(case, noise, like.candidate_set, laws[-1], progress)
        steps += beside
        again = law_beside_effects(case, noise, like, beside[-1], laws[-1], progress) if beside else None
        if again is not None:
            return [*steps[:first], *again.steps], again.force
    return steps, missing


def by_exact_law(case: Case, noise: Noise, diagnosis: BaseDiagnosis, progress: Progress) -> Explanation | None:
    """The explanation by one law, with which only noise is left of the train runs: it needs no random force. By a
    formula or a smooth function alone, or by a formula beside a known effect; held-out runs judge the first of these
    that is found."""
    missing = latent_force_of(diagnosis, diagnosis.base, progress)
    like = _structure_of(diagnosis, missing)
    for find in (exact_law, exact_smooth_law):
        law = find(case, noise, like, missing, progress)
        if law is not None:
            return _by_law(case, noise, diagnosis, like, law, missing)
    return by_exact_law_beside(case, noise, diagnosis, progress)


def by_exact_law_beside(case: Case, noise: Noise, diagnosis: BaseDiagnosis, progress: Progress) -> Explanation | None:
    """The explanation by a known effect, of those that lower the misfit most, and one law, with which only noise is
    left of the train runs. The law shows once the effect is in the model: before, the force holds what both do."""
    base = diagnosis.base
    ordered = trial_order(base.ranking, base.candidate_set.criteria)
    refits = [(row.effect, row.refit) for row in ordered if row.refit is not None and not row.failed]
    for effect, refit in refits[:BESIDE_A_LAW]:
        step = CandidateFit((*base.step.effects, effect), refit)
        known = selection_step(base.candidate_set, "added", effect, step)
        missing = estimate_latent_force(base.candidate_set, step, progress).with_laws()
        law = exact_law(case, noise, known, missing, progress)
        if law is not None:
            return _by_law(case, noise, diagnosis, known, law, missing)
    return None


def _by_law(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, like: WorkingStep, law: AddedLaws, missing: LatentForce
) -> Explanation:
    """The explanation by the step `like` and a `law` of `missing`."""
    added = selection_step(law.candidate_set, "added", law.names[0], law.fit)
    steps = [added] if like is diagnosis.base else [like, added]
    return conclude_with_law(case, noise, diagnosis, steps, missing.with_also(law.laws))


def _structure_of(diagnosis: BaseDiagnosis, missing: LatentForce) -> WorkingStep:
    """The base, or the change of structure, that `missing` is the force of."""
    if not missing.switched or diagnosis.switched is None:
        return diagnosis.base
    return selection_step(diagnosis.switched[0], "added", LATERAL_SLIP_SWITCH, diagnosis.switched[1])


def conclude_with_law(
    case: Case, noise: Noise, diagnosis: BaseDiagnosis, with_law: Sequence[WorkingStep], missing: LatentForce
) -> Explanation:
    """The verdict on a model with a law: it explains where only noise is left."""
    last, steps = with_law[-1], (diagnosis.base.record, *(step.record for step in with_law))
    final, left_out = steps[-1], steps[0].left_out
    if leaves_only_noise(last):
        return exact_explanation(case, noise, last, steps, missing)
    return Explanation(case, noise, steps, "unexplained", final.effects, (), left_out, missing, law=missing)


def latent_force_of(diagnosis: BaseDiagnosis, last: WorkingStep, progress: Progress) -> LatentForce:
    """The force that both structures lack, and the added effects that act beside it.

    Effects that do not explain would hide a part of it, so it is estimated from the structures on.
    """
    base = diagnosis.base
    structures = [(base.candidate_set, base.step)]
    if diagnosis.switched:
        structures.append(diagnosis.switched)
    added = [name for name in last.step.effects if name not in base.step.effects]
    return choose_structure(structures, last.candidate_set, added, progress)
