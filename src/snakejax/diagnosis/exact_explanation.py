"""The explanation by a model that leaves only noise."""

from collections.abc import Sequence
from itertools import pairwise

from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.recording.run import Case, Noise

from .effect_or_odd_run import odd_runs_beside
from .exact_checks import STATED_WELL, bands_of
from .explanation import Explanation
from .inexact.confidence import AMBIGUOUS, STAND_IN, SURE
from .inexact.explaining import shares_of
from .latent_force.missing_force import LatentForce
from .odd_runs import OddRun
from .selection.acceptance import heldout_consistent
from .selection.steps import SelectionStep, indistinguishable, raises_heldout_error
from .selection.working_step import WorkingStep


def leaves_only_noise(last: WorkingStep) -> bool:
    """Whether the model of a step leaves only noise, in held-out runs too."""
    return consistent_with_noise(last.step.solution) and heldout_consistent(
        last.candidate_set, last.step, last.judgement
    )


def exact_explanation(
    case: Case,
    noise: Noise,
    last: WorkingStep,
    steps: tuple[SelectionStep, ...],
    law: LatentForce | None = None,
    instead: Sequence[OddRun] = (),
) -> Explanation:
    """The explanation by the `last` step, which leaves only noise; `law`: the force in which a law of it was found;
    `instead`: the runs that may be odd instead of an effect.

    Train runs may not determine its values well enough for the held-out runs. Where these are further off with it than
    without, it explains only the train runs.
    """
    final = steps[-1]
    misleads = raises_heldout_error(steps[0], final)
    verdict = "unexplained" if misleads else "explained" if final.effects else "adequate"
    share, explained_share = shares_of(steps)
    return Explanation(
        case,
        noise,
        steps,
        verdict,
        () if misleads else final.effects,
        final.effects if misleads else (),
        steps[0].left_out,
        None,
        confidence={effect: confidence_where_exact(steps, effect, instead) for effect in final.effects},
        share=share,
        explained_share=explained_share,
        bands=bands_of(final.fitted),
        odd_runs=_with_instead(odd_runs_beside(last.candidate_set, last.step), instead),
        law=law,
    )


def _with_instead(odd: Sequence[OddRun], instead: Sequence[OddRun]) -> tuple[OddRun, ...]:
    """The runs that are `odd` beside all effects, and those that may be odd `instead` of effects; each once, with all
    of these."""
    by_run: dict[str, OddRun] = {}
    for one in (*odd, *instead):
        before = by_run.get(one.run)
        by_run[one.run] = one._replace(effects=(*before.effects, *one.effects)) if before else one
    return tuple(by_run.values())


def confidence_where_exact(steps: Sequence[SelectionStep], effect: str, instead: Sequence[OddRun] = ()) -> str:
    """How sure an effect is where it leaves only noise: the model is exact, so only a twin, a constant, or one run that
    differs `instead` is as good. One with which held-out runs are further off may stand in for something else."""
    if indistinguishable(steps, effect):
        return AMBIGUOUS
    if any(after.name == effect and raises_heldout_error(before, after) for before, after in pairwise(steps)):
        return STAND_IN
    if any(effect in odd.effects for odd in instead):
        return STAND_IN
    final = steps[-1]
    port = final.model.effects.get(effect)
    stated_sd = final.model.board.stated_sd
    for name, constant in ({} if port is None else port.equivalent_constant).items():
        if abs(final.estimates_of(effect)[name].value) < STATED_WELL * stated_sd.get(constant, 0.0):
            return STAND_IN
    return SURE
