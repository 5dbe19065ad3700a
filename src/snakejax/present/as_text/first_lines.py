"""The first lines of an explanation: the cause and its value, the error before and after, its validation, and how sure
that is."""

from collections.abc import Iterator

from snakejax.core.tabular import counted, listed
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.estimation.goodness_of_fit import largest_noise_misfit

from .certainty import confidence_sentences, law_sentences
from .errors import error_text
from .missing import components_text
from .tables import NOT_CONVERGED, values_text

UNDECIDED = "No known effect brings the error down to the noise."
UNSEEN = "The train runs are explained, the held-out runs are not: they differ from what this model predicts."

BEYOND = (
    "They go beyond the train runs, which do not determine the values well enough for them: this error does not"
    " contradict the model."
)


def title(explanation: Explanation) -> str:
    """The case and the verdict: `tilted-floor: explained by ground_slope`."""
    name = explanation.case.name
    if explanation.verdict == "explained":
        return f"{name}: explained by {listed(explanation.effects)}"
    return f"{name}: {explanation.verdict}"


def first_lines(explanation: Explanation) -> list[tuple[str, str]]:
    """Pairs of a heading and a sentence."""
    lines = [("cause", sentence) for sentence in _causes(explanation)]
    lines += [("error", _error(explanation)), ("validation", _validation(explanation))]
    lines += [("how sure", sentence) for sentence in _certainty(explanation)]
    # One heading for all lines of its kind.
    return [(head if k == 0 or lines[k - 1][0] != head else "", line) for k, (head, line) in enumerate(lines)]


def _causes(explanation: Explanation) -> Iterator[str]:
    final = explanation.final
    doubt = "" if final.converged else f" (its fit {NOT_CONVERGED})"
    if explanation.verdict == "adequate":
        constants = "" if explanation.calibrated is None else f" with {values_text(explanation.constants)}"
        yield f"None: the base model explains the recordings{constants}."
        return
    if explanation.verdict == "unexplained":
        unseen = _explains_train_runs(explanation)
        yield UNSEEN if unseen else UNDECIDED
        # A law that explains the train runs is the force that was missing.
        if explanation.missing is not None and not (unseen and explanation.named_laws):
            yield _missing(explanation.missing)
        known = tuple(effect for effect in explanation.effects if effect not in explanation.named_laws)
        if known:
            yield f"Still significant together with the missing force: {listed(known)}."
    causes = tuple(dict.fromkeys((*explanation.partial, *explanation.named_laws)))
    for effect in causes if explanation.verdict == "unexplained" else explanation.effects:
        helped = "Lowers the error: " if explanation.verdict == "unexplained" else ""
        values = values_text(final.estimates_of(effect))
        yield f"{helped}{effect}: {final.description_of(effect)} {values}".rstrip() + doubt


def _explains_train_runs(explanation: Explanation) -> bool:
    """Whether an unexplained recording is one of which only the held-out runs are unexplained: noise is all that is
    left of the train runs, or noise and a random force."""
    train = explanation.final.train
    only_noise = train.misfit <= largest_noise_misfit(train.samples)
    with_force = explanation.floor is not None and not explanation.of_windows
    return explanation.final.heldout is not None and (only_noise or with_force)


def _missing(force: LatentForce) -> str:
    depends = "" if force.is_random else "It depends on no variable of these runs."
    if force.shape is not None and force.depends_on:
        variable, share = force.depends_on[0]
        depends = (
            f"A force that depends on {variable.replace('_', ' ')} alone predicts {100 * share:.0f} % of the squared"
            " error above the noise on omitted runs."
        )
    return f"A force is missing: {components_text(force)} (root mean square). {depends}".rstrip()


def _error(explanation: Explanation) -> str:
    base, final = explanation.base.train, explanation.final.train
    if explanation.final is explanation.base:
        return f"{error_text(base)}."
    return f"from {error_text(base)} to {error_text(final)}."


def _validation(explanation: Explanation) -> str:
    base, final = explanation.base, explanation.final
    if final.heldout is None or base.heldout is None:
        return "None: no run is held out."
    runs = counted(len(final.fitted.numbered("heldout")), "held-out run")
    if explanation.final is explanation.base:
        return f"{runs}, not used in the fit: {error_text(final.heldout)}."
    beyond = ""
    exact = explanation.verdict == "explained" and explanation.floor is None
    if exact and final.heldout.misfit > largest_noise_misfit(final.heldout.samples):
        beyond = f" {BEYOND}"
    return f"{runs}, not used in the fit: from {error_text(base.heldout)} to {error_text(final.heldout)}.{beyond}"


def _certainty(explanation: Explanation) -> Iterator[str]:
    if explanation.verdict == "adequate":
        noise = "what the model leaves is like noise of the vehicle itself"
        yield f"No effect is missing: {noise if explanation.floor is not None else 'only noise is left'}."
    elif explanation.verdict == "unexplained":
        if _explains_train_runs(explanation):
            yield "Not sure: the held-out runs show an effect, or conditions, that the train runs do not show."
        else:
            yield "Not sure: the model lacks an effect, so the values are biased."
    yield from law_sentences(explanation)
    several = len(explanation.confidence) > 1
    for effect in explanation.confidence:
        sentences = " ".join(confidence_sentences(explanation, effect))
        if sentences:
            yield f"{effect}: {sentences}" if several else sentences
