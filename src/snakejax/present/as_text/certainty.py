"""How sure each effect is, what vehicle and cameras leave by themselves, and how far a simulation is off."""

from collections.abc import Iterator

from snakejax.core.parameter import parameters, unit_text
from snakejax.core.tabular import listed
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.diagnosis.law.words import in_words
from snakejax.diagnosis.residuals.horizon import horizon_errors
from snakejax.diagnosis.selection.steps import indistinguishable

from .errors import pose_error_text
from .tables import number, values_text


def confidence_sentences(explanation: Explanation, effect: str) -> Iterator[str]:
    """How sure an effect is, and what share of the error it takes away."""
    word = explanation.confidence.get(effect)
    if word is None:
        return
    twins = {row.effect: None for row in explanation.candidates if effect in row.instead_of}
    twins = twins or dict.fromkeys(indistinguishable(explanation.steps, effect))
    unnamed = "another law" if effect in explanation.named_laws else "another effect"
    others = listed(tuple(twins), "or") if twins else unnamed
    sure = SURE_OF_WINDOWS if explanation.of_windows else SURE_WHERE_EXACT if explanation.floor is None else ""
    unknown = percent(explanation.base.criteria.largest_random_force)
    runs_instead = (f"that run {odd.run} differs" for odd in explanation.odd_runs if effect in odd.effects)
    cause = next(runs_instead, "a wrong constant")
    yield (sure if word == "sure" else "") or CONFIDENCE[word].format(others=others, unknown=unknown, cause=cause)
    share = explanation.share.get(effect)
    if share is not None:
        runs = "train runs" if explanation.final.heldout is None else "held-out runs"
        runs = "train recordings, each left out in turn" if explanation.of_windows else runs
        if share < 0:
            yield f"The squared error of the {runs} rises by {percent(-share)} with it."
        else:
            yield f"It takes away {percent(share)} of the squared error of the {runs}."


def law_sentences(explanation: Explanation) -> Iterator[str]:
    """What the laws say, how well their variables are known, and what else fits almost as well."""
    force = explanation.law
    if force is None or not force.laws:
        return
    taken = {effect.expression: name for name, effect in explanation.named_laws.items()}
    laws = [law for law in force.laws if law.expression in taken]
    for law in laws:
        yield f"In words, {taken[law.expression]} is {in_words(law.family)}."
    shares = [f"{variable.replace('_', ' ')} {percent(share)}" for variable, share in force.depends_on[:3]]
    above = "noise and random force" if force.is_random else "the noise"
    if shares:
        yield (
            f"Share of the squared error above {above}, on omitted runs, that a force of one variable alone predicts:"
            f" {', '.join(shares)}."
        )
    others = [law for law in force.laws if law.expression not in taken]
    if force.is_random:
        if others:
            yield f"These laws predict omitted runs as well: {'; or '.join(_short(law) for law in others)}."
        return
    others = [law for law in others if not any(_is_more(law, one) for one in laws)]
    least = min(law.left_out for law in force.laws)
    close = [law for law in others if law.left_out - 1 < ALMOST * max(least - 1, LEAST_EXCESS)]
    if close:
        yield f"Over short windows these laws fit almost as well: {'; or '.join(_short(law) for law in close)}."
    elif others:
        best = min(others, key=lambda law: law.left_out)
        yield (
            f"No other form comes near it over short windows: it leaves {force_left(least)} times the noise,"
            f" the next, {_short(best)}, {force_left(best.left_out)}."
        )


def _is_more(law: ProposedLaw, taken: ProposedLaw) -> bool:
    """Whether a law acts on what the one that was `taken` acts, on the same variables, with more parameters: it may
    hold that law as a special case."""
    same = (law.family.action, law.family.variables) == (taken.family.action, taken.family.variables)
    return same and len(law.parameters) > len(taken.parameters)


def _short(law: ProposedLaw) -> str:
    """A law by its formula where that is short, else in words."""
    return law.expression if len(law.expression) <= SHORT else in_words(law.family)


SHORT = 80
"""A formula of more letters is said in words."""
ALMOST = 3.0
"""A law that leaves less than this multiple of the excess of the best one fits almost as well."""
LEAST_EXCESS = 0.01
"""The best excess counts as this much at least: below it, windows differ by chance."""


def force_left(misfit: float) -> str:
    """The error that a law leaves, in multiples of the noise."""
    return f"{misfit**0.5:.3g}"


CONFIDENCE = {
    "sure": "Sure: it would be significant even if {unknown} of the forces had another cause.",
    "likely": "Likely: it is significant, and omitted runs are predicted better with it.",
    "stand_in": "Stand-in: it lowers the error, but another cause is possible, such as {cause}.",
    "ambiguous": "Ambiguous: {others} would explain the runs nearly as well.",
}
"""What the words of `confidence` mean."""
SURE_WHERE_EXACT = "Sure: with it only noise is left, and no other candidate does as well."
"""The same of an effect that leaves only noise."""
SURE_OF_WINDOWS = "Sure: the recordings agree on its value, and each is predicted better with it from the others."
"""The same of an effect found in windows of longer recordings."""


def percent(share: float) -> str:
    """A positive share in percent: two digits, more near 100%, one below half a percent; from `less than 0.01%` to
    `more than 99.9%`."""
    if share < 1e-4:
        return "less than 0.01%"
    if share < 0.005:
        return f"{100 * share:.1g}%"
    if 0.999 < share < 1.0:
        return "more than 99.9%"
    return f"{100 * share:.1f}%" if share > 0.99 else f"{100 * share:.0f}%"


def floor_sentences(explanation: Explanation) -> Iterator[str]:
    """What vehicle and cameras leave by themselves, and the constants that were estimated."""
    floor = explanation.floor
    if floor is None:
        return
    noise = pose_error_text(*(float(part) for part in (explanation.noise.position, explanation.noise.heading)))
    what = "windows" if explanation.of_windows else "whole runs"
    yield (
        f"The error of {what} that comes from {floor.source} alone is"
        f" {pose_error_text(floor.position_m, floor.heading_rad)}; the noise of a sample is {noise}."
    )
    rest = explanation.remainder
    if rest is not None and rest.position_m + rest.heading_rad > 0:
        depends = [f"{variable} ({percent(share)})" for variable, share in rest.depends_on[:3]]
        where = (
            f"A share of its residuals in train runs depends on {listed(depends)}."
            if depends
            else "Its residuals in train runs depend on no variable (5%)."
        )
        yield f"The error of the model is {pose_error_text(rest.position_m, rest.heading_rad)} above that. {where}"
    if rest is not None and rest.laws:
        yield (
            f"A force with one of these laws may be missing: {'; or '.join(rest.laws)}. They fit the train runs equally"
            " well, and none predicts omitted whole runs better, so none is added. Runs with other motions can"
            " distinguish them."
        )
    if explanation.constants:
        noun, limits = explanation.case.board.noun, [n for n, e in explanation.constants.items() if e.at_bound]
        values, share = values_text(explanation.constants), explanation.constants_share
        alone = f" They take away {percent(share)} of the squared error." if share > 0 else ""
        yield f"The constants of the {noun} were estimated within their stated uncertainty: {values}.{alone}"
        if limits:
            yield f"At the limit of this uncertainty: {', '.join(limits)}. Measure again or state a larger one."


def horizon_sentences(explanation: Explanation) -> Iterator[str]:
    """How far a simulation is off some seconds after a known pose, and whether that is what the user needs."""
    final, needed = explanation.final, explanation.case.needed
    role = "train" if final.heldout is None else "heldout"
    runs = "train" if final.heldout is None else "held-out"
    errors = horizon_errors(final.fitted, role)
    if errors:
        parts = [f"{pose_error_text(e.position_m, e.heading_rad)} after {e.seconds:g} s" for e in errors]
        yield (
            f"From a known pose, simulations of {runs} runs are off by {', '.join(parts)}, the noise of both poses"
            " included."
        )
    if needed is None:
        return
    wanted = pose_error_text(needed.position, needed.heading)
    for reached in horizon_errors(final.fitted, role, [needed.horizon]):
        enough = reached.position_m <= needed.position and reached.heading_rad <= needed.heading
        error = pose_error_text(reached.position_m, reached.heading_rad)
        words = "Good enough" if enough else "Not good enough"
        yield f"{words} for {wanted} in {needed.horizon:g} s: the error is {error}."
        return
    yield f"No run is long enough to check the required {wanted} after {needed.horizon:g} s."


def band_sentences(explanation: Explanation) -> Iterator[str]:
    """What share of the runs lies inside the bands of the predictions."""
    for role, name in (("heldout", "held-out"), ("train", "train")):
        inside = [band.inside for band in explanation.bands if band.role == role]
        if inside:
            mean = 100 * sum(inside) / len(inside)
            yield f"The 95% bands of predictions from the start of each run hold {mean:.1f}% of the {name} samples."
            return


def odd_run_sentences(explanation: Explanation) -> Iterator[str]:
    """The runs that differ from the others, and by what."""
    known = parameters(explanation.final.model)
    for odd in explanation.odd_runs:
        value = f"{number(odd.shift, odd.sd)} +- {number(odd.sd, odd.sd)}"
        unit = unit_text(known[odd.parameter].domain.unit) if odd.parameter in known else ""
        alike = f" Another value of {listed(odd.alike, 'or')} explains it nearly as well." if odd.alike else ""
        either = "".join(f", or {effect} acts in all runs, which explains as much" for effect in odd.effects)
        yield (
            f"Run {odd.run} differs from the others{either}: the model fits it better with {odd.parameter} changed by"
            f" {value}{unit} in this run alone (p = {odd.p_value:.1g}).{alike} Check this run, or leave it out."
        )
