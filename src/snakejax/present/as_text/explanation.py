"""A diagnosis or an explanation as text."""

from collections.abc import Iterator, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from snakejax.core.tabular import listed
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.recording.run import Case

from ..as_json.explanation import coexisting_effects
from .certainty import band_sentences, floor_sentences, horizon_sentences, odd_run_sentences
from .columns import (
    DETECTS,
    ERROR,
    EXPECTED,
    HEADING,
    ORDER,
    P_AND_SD,
    POSITION,
    PREDICTED,
    REFIT,
    WINDOWS,
    narrow,
    of_heldout,
)
from .errors import error_text, milli_text, times_noise_text
from .first_lines import first_lines, title
from .missing import components_text
from .tables import (
    NOT_CONVERGED,
    add_row,
    error,
    expected_text,
    named,
    not_converged_line,
    note,
    number,
    plain_table,
    values_text,
)

CLOSE = 0.9
"""A variable whose share is at least this part of the best one's may be the cause as well."""


def explanation_text(explanation: Explanation) -> RenderableType:
    """The verdict, the effects with their estimates, the error after each step, and the candidates."""
    lines: list[RenderableType] = [
        Text(title(explanation), style="bold"),
        _first(explanation),
        *_warned(explanation.steps),
        Text(""),
        _steps(explanation),
        Text(""),
        _parameters(explanation),
        Text(""),
    ]
    beside = (floor_sentences, horizon_sentences, band_sentences, odd_run_sentences)
    lines += [Text(line) for sentences in beside for line in sentences(explanation)]
    lines += [Text(line) for line in confusable_sentences(explanation.base, explanation.effects)]
    if explanation.missing is not None:
        lines += [Text(""), _dependence(explanation)]
    lines += [Text(""), candidate_table(explanation.base)]
    return Group(*lines)


def _first(explanation: Explanation) -> Table:
    """The first lines, beside their headings."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for head, line in first_lines(explanation):
        table.add_row(head, Text(line))
    return table


def _parameters(explanation: Explanation) -> RenderableType:
    """The parameters of the final model with their standard errors."""
    table = plain_table("parameter", "value", "+-", "unit", "", right=("value", "+-"))
    for name, estimate in explanation.final.estimates.items():
        cells = named(name), number(estimate.value, estimate.sd), error(estimate.sd), estimate.unit, note(estimate)
        add_row(table, *cells, style=None if estimate.determined else "yellow")
    return table


def _dependence(explanation: Explanation) -> RenderableType:
    """The size of the missing force, and the variables on which it depends."""
    missing = explanation.missing
    assert missing is not None
    table = plain_table("the missing force depends on", "share", right=("share",))
    for variable, share in missing.depends_on[:4]:
        add_row(table, variable, f"{100 * share:.0f} %")
    size = f"The missing force, root mean square: {components_text(missing)}."
    if missing.switched:
        size += " It is estimated with separately slipping wheelsets, where it is smaller than with coupled ones."
    known = explanation.final.description_of
    survivors = [
        Text(f"Still significant together with it: {effect}: {known(effect)} {values_text(estimates)}")
        for effect, estimates in coexisting_effects(explanation).items()
    ]
    if missing.is_random:
        return Text(size)
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


def _label(effect: str, name: str) -> str:
    """`effect.name`; what differs by floor, day or session has the label of the runs in its `name` already."""
    group, by, _ = effect.partition("_by_")
    return name if by and name.startswith(f"{group}_") else f"{effect}.{name}".rstrip(".")


def candidate_table(step: SelectionStep, most: int = 6, detectable: bool = False) -> RenderableType:
    """The first `most` candidates: p, remaining error in multiples of the noise, and expected value.

    `detectable` adds the smallest values that these runs would detect. Near the noise the linear model predicts the
    error of whole runs, otherwise the residual of short windows.
    """
    near = step.predicted_of_runs
    titles = ("p", narrow(PREDICTED if near else WINDOWS), narrow(REFIT))
    table = plain_table("candidate", *titles, EXPECTED, *[DETECTS] * detectable, right=(*titles, DETECTS))
    for ranked in step.ranking[:most]:
        p_value = "" if ranked.p_value is None else f"{ranked.p_value:.1g}" if ranked.p_value else "<1e-300"
        star = "*" if ranked.converged is False else ""
        refit = "failed" if ranked.failed else times_noise_text(ranked.refit_misfit) + star
        first = p_value, times_noise_text(ranked.predicted_misfit), refit
        rows = ranked.estimate or {"": None}
        for place, (name, estimate) in enumerate(rows.items()):
            words = "" if estimate is None else expected_text(estimate)
            detects = [f"{ranked.detectable[name]:.2g}" if name else ""] * detectable
            add_row(table, _label(ranked.effect, name), *(first if place == 0 else ("",) * 3), words, *detects)
    first = "predicted" if near else "over short windows"
    legend = "p: probability of such an improvement by chance, corrected for the number of candidates."
    legend += f" / noise: remaining error in multiples of the noise: {first}, and refitted on whole runs."
    if (without := misfit_without(step)) is not None:
        legend += f" Without a candidate it is {times_noise_text(without)} {'on whole runs' if near else first}."
    legend += f" {ORDER} {P_AND_SD} expected: the value by the linear model; a refit may give another one."
    if detectable:
        legend += " detects: the smallest value that these runs would show if the model were otherwise right."
    if any(ranked.converged is False for ranked in step.ranking[:most]):
        legend += f" *: this refit {NOT_CONVERGED}; its error and values are uncertain."
    return Group(table, Text(legend, style="dim"))


def misfit_without(step: SelectionStep) -> float | None:
    """The misfit of the model of `step` where its candidates are compared; None where nobody knows it."""
    return next((row.misfit_without for row in step.ranking if row.misfit_without is not None), None)


def _steps(explanation: Explanation) -> Table:
    """The root mean square error after each step, and its multiple of the noise."""
    right = tuple(map(narrow, (POSITION, HEADING, ERROR, of_heldout(ERROR))))
    table = plain_table("step", *right, "", right=right)
    for step in explanation.steps:
        held = step.heldout
        add_row(
            table,
            step.title,
            milli_text(step.train.position_m),
            milli_text(step.train.heading_rad),
            times_noise_text(step.train.misfit),
            times_noise_text(held.misfit if held else None),
            "" if step.converged else NOT_CONVERGED,
        )
    return table


def warnings(steps: Sequence[SelectionStep]) -> tuple[str, ...]:
    """One sentence that names the fits that did not converge, if any."""
    names = [step.title for step in steps if not step.converged]
    return (not_converged_line(*names),) if names else ()


def _warned(steps: Sequence[SelectionStep]) -> list[Text]:
    return [Text(f"! {description}", style="yellow") for description in warnings(steps)]


def base_headline(name: str, base: SelectionStep) -> str:
    """The error of the base model in the case `name`."""
    held = "" if base.heldout is None else f", on held-out runs {error_text(base.heldout)}"
    return f"{name}: the root mean square error of the base model is {error_text(base.train)}{held}."
