"""A diagnosis or an explanation as text."""

from collections.abc import Iterator, Mapping, Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from snakejax.core.tabular import listed
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.residuals.horizon import horizon_errors
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.estimation.uncertainty import Estimate
from snakejax.recording.run import Case

from ..as_json.explanation import _steps, _warned, base_headline, coexisting_effects
from .errors import error_text, pose_error_text, times_noise_text
from .tables import NOT_CONVERGED, add_row, number, plain_table

CLOSE = 0.9
"""A variable whose share is at least this part of the best one's may be the cause as well."""


def explanation_text(explanation: Explanation) -> RenderableType:
    """The verdict, the effects with their estimates, the error after each step, and the candidates."""
    lines: list[RenderableType] = [
        Text(headline(explanation)),
        *_warned(explanation.steps),
        Text(""),
        _steps(explanation),
    ]
    note = "" if explanation.final.converged else f" (its fit {NOT_CONVERGED})"
    for effect in explanation.partial if explanation.verdict == "unexplained" else explanation.effects:
        values = _values(explanation.final.estimates_of(effect))
        lines.append(Text(f"{effect}: {explanation.final.description_of(effect)} {values}{note}"))
        lines += [Text(f"  {line}", style="dim") for line in confidence_sentences(explanation, effect)]
    beside = (floor_sentences, horizon_sentences, band_sentences, odd_run_sentences)
    lines += [Text(line) for sentences in beside for line in sentences(explanation)]
    lines += [Text(line) for line in confusable_sentences(explanation.base, explanation.effects)]
    if explanation.missing is not None:
        lines += [Text(""), _dependence(explanation)]
    lines += [Text(""), candidate_table(explanation.base)]
    return Group(*lines)


def confidence_sentences(explanation: Explanation, effect: str) -> Iterator[str]:
    """How sure an effect is, and what share of the error it takes away."""
    word = explanation.confidence.get(effect)
    if word is None:
        return
    twins = {row.effect: None for row in explanation.candidates if effect in row.instead_of}
    others = listed(tuple(twins), "or") if twins else "another effect"
    exact = word == "sure" and explanation.floor is None
    yield SURE_WHERE_EXACT if exact else CONFIDENCE[word].format(others=others)
    share = explanation.share.get(effect)
    if share is not None:
        runs = "train" if explanation.final.heldout is None else "held-out"
        yield f"It takes away {percent(share)} of the squared error of the {runs} runs."


CONFIDENCE = {
    "sure": "Sure: it would be significant even if a fiftieth of the forces were something else.",
    "likely": "Likely: it is significant, and runs that were left out are predicted better with it.",
    "stand_in": "It may stand in for something else, such as a constant that is not as stated.",
    "ambiguous": "Ambiguous: {others} would explain the runs nearly as well.",
}
"""What the words of `confidence` mean."""
SURE_WHERE_EXACT = "Sure: with it only noise is left, and no other candidate does as well."
"""The same of an effect that leaves only noise."""


def percent(share: float) -> str:
    """A share in percent, with as many nines as it has."""
    for digits in range(5):
        if abs(1.0 - share) >= 10.0 ** -(digits + 2) or share > 1.0:
            return f"{100 * share:.{digits}f}%"
    return f"{100 * share:.4f}%"


def floor_sentences(explanation: Explanation) -> Iterator[str]:
    """What vehicle and cameras leave by themselves, and the constants that were estimated."""
    floor = explanation.floor
    if floor is None:
        return
    noise = pose_error_text(*(float(part) for part in (explanation.noise.position, explanation.noise.heading)))
    yield (
        f"Of whole runs, {floor.source} leave {pose_error_text(floor.position_m, floor.heading_rad)} by themselves;"
        f" the noise of a sample is {noise}."
    )
    if explanation.constants:
        parts = [
            f"{name} = {number(e.value, e.sd)} +- {number(e.sd, e.sd)}{_unit(e)}"
            for name, e in explanation.constants.items()
        ]
        yield f"The constants of the board were estimated within what is known of them: {', '.join(parts)}."


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
    for error in horizon_errors(final.fitted, role, [needed.horizon]):
        enough = error.position_m <= needed.position and error.heading_rad <= needed.heading
        there = pose_error_text(error.position_m, error.heading_rad)
        words = "Good enough" if enough else "Not good enough"
        yield f"{words} for {wanted} in {needed.horizon:g} s: the error is {there}."
        return
    yield f"No run is long enough to say whether it is good enough for {wanted} in {needed.horizon:g} s."


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
    for odd in explanation.odd_runs:
        value = f"{number(odd.shift, odd.sd)} +- {number(odd.sd, odd.sd)}"
        alike = f", or {listed(odd.alike, 'or')}," if odd.alike else ""
        yield (
            f"Run {odd.run} differs from the others, as if {odd.parameter}{alike} were {value} more there"
            f" (p = {odd.p_value:.1g}). Look at this run, or leave it out."
        )


def _dependence(explanation: Explanation) -> RenderableType:
    """The size of the missing force, and the variables on which it depends."""
    missing = explanation.missing
    assert missing is not None
    push, turn = missing.size
    table = plain_table("the missing force depends on", "share", right=("share",))
    for variable, share in missing.depends_on[:4]:
        add_row(table, variable, f"{100 * share:.0f} %")
    size = f"The missing force is {number(push)} N along the board and {number(turn)} N m in yaw (root mean square)."
    if missing.switched:
        size += " It is estimated with separately slipping wheelsets, where it is smaller than with coupled ones."
    survivors = [
        Text(f"Still significant beside it: {effect}: {explanation.final.description_of(effect)} {_values(estimates)}")
        for effect, estimates in coexisting_effects(explanation).items()
    ]
    if missing.shape is None:
        return Group(*survivors, Text(size), Text("No variable of these runs predicts it."))
    (first, best), *others = missing.depends_on
    close = [variable for variable, share in others if share > CLOSE * best]
    if close:
        size += f" These runs hardly distinguish {first} from {' or '.join(close)}; runs with another gait may."
    advice = "With --out DIR, an effect of this form is written to DIR/missing_force.py, for you to edit."
    return Group(*survivors, Text(size), table, Text(advice))


def diagnosis_text(case: Case, base: SelectionStep) -> RenderableType:
    """The error of the base model, the candidates, and which of them are confusable."""
    lines: list[RenderableType] = [
        Text(base_headline(case.name, base)),
        *_warned([base]),
        Text(""),
        candidate_table(base, len(base.ranking), detectable=True),
    ]
    level = base.criteria.significance_level
    sure = [r.effect for r in base.ranking if r.p_value is not None and r.p_value < level]
    if not sure:
        lines.append(Text(f"No candidate is significant at {level:g}, corrected for their number."))
    lines += [Text(line) for line in (*confusable_sentences(base, sure), *_left_out(base))]
    return Group(*lines)


def confusable_sentences(step: SelectionStep, effects: Sequence[str]) -> Iterator[str]:
    """One sentence for each group of effects that these runs cannot distinguish; measurement faults are named."""
    named_groups: set[frozenset[str]] = set()
    of_measurement = {row.effect for row in step.ranking if row.of_measurement}
    for ranked in step.ranking:
        group = frozenset((ranked.effect, *ranked.confusable_with))
        if ranked.effect not in effects or len(group) < 2 or group in named_groups:
            continue
        named_groups.add(group)
        text = f"These runs cannot distinguish {ranked.effect} from {listed(ranked.confusable_with, 'or')}."
        faults = sorted(group & of_measurement)
        if faults and len(faults) < len(group):
            text += f" ({', '.join(faults)}: an error of the measurement, not of the board.)"
        yield text


def _left_out(step: SelectionStep) -> Iterator[str]:
    for name, why in step.left_out.items():
        yield f"Excluded: {name}: {why.rstrip('.')}."


def _values(estimates: Mapping[str, Estimate]) -> str:
    parts = [f"{name} = {number(e.value, e.sd)} +- {number(e.sd, e.sd)}{_unit(e)}" for name, e in estimates.items()]
    return ", ".join(parts)


def _unit(estimate: Estimate) -> str:
    return "" if estimate.unit == "-" else f" {estimate.unit}"


def headline(explanation: Explanation) -> str:
    """The verdict in one sentence."""
    base, final = explanation.base, explanation.final
    if explanation.verdict == "adequate":
        if explanation.floor is not None:
            return (
                f"{explanation.case.name}: adequate. No effect is missing: what the model leaves is like noise of the"
                f" vehicle itself, {error_text(final.train)}."
            )
        return f"{explanation.case.name}: adequate. The base model leaves only noise: {error_text(base.train)}."
    unseen = "" if final.heldout is None else f", on held-out runs to {error_text(final.heldout)}"
    fall = f"the root mean square error falls from {error_text(base.train)} to {error_text(final.train)}{unseen}"
    if explanation.verdict == "explained":
        return f"{explanation.case.name}: explained by {listed(explanation.effects)}; {fall}."
    lacking = "No known effect brings the error down to the noise."
    if explanation.effects:
        known = listed(explanation.effects)
        lacking = f"With {known} in the model there remains a force that no known effect explains."
    helped = f" With {listed(explanation.final.effects)} {fall}." if explanation.final.effects else ""
    return f"{explanation.case.name}: unexplained. {lacking}{helped}"


def candidate_table(step: SelectionStep, most: int = 6, detectable: bool = False) -> RenderableType:
    """The first `most` candidates: p, remaining error in multiples of the noise, and expected value.

    `detectable` adds the smallest values that these runs would detect. Near the noise the linear model predicts the
    error of whole runs, otherwise the residual of short windows.
    """
    near = step.predicted_of_runs
    titles = ("p", f"{'predicts' if near else 'windows'}\n/ noise", "refit\n/ noise")
    table = plain_table("candidate", *titles, "expected", *["detects"] * detectable, right=(*titles, "detects"))
    for ranked in step.ranking[:most]:
        p_value = "" if ranked.p_value is None else f"{ranked.p_value:.1g}" if ranked.p_value else "< 1e-300"
        star = "*" if ranked.converged is False else ""
        refit = "failed" if ranked.failed else times_noise_text(ranked.refit_misfit) + star
        first = p_value, times_noise_text(ranked.predicted_misfit), refit
        rows = ranked.estimate or {"": None}
        for place, (name, estimate) in enumerate(rows.items()):
            words = "" if estimate is None else f"{estimate.value:.2g} +- {estimate.sd:.1g}{_unit(estimate)}"
            detects = [f"{ranked.detectable[name]:.2g}" if name else ""] * detectable
            label = f"{ranked.effect}.{name}".rstrip(".")
            add_row(table, label, *(first if place == 0 else ("",) * 3), words, *detects)
    first = "predicted" if near else "over short windows"
    legend = f"/ noise: remaining error in multiples of the noise: {first}, and refitted on whole runs."
    if any(ranked.converged is False for ranked in step.ranking[:most]):
        legend += f" *: this refit {NOT_CONVERGED}; its error and values are uncertain."
    return Group(table, Text(legend, style="dim"))
