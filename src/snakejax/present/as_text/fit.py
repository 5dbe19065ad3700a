"""The report of a fit as tables and sentences for a terminal of 80 columns."""

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from snakejax.core.parameter import parameters
from snakejax.dynamics.model import Model
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.goodness_of_fit import RunScore, Score
from snakejax.estimation.uncertainty import Estimate, RefittedInterval
from snakejax.recording.run import Case, Noise, Run

from ..as_json.provenance import constraint_kind, model_kind
from .columns import CHANNELS, ERROR, HEADING, POSITION, narrow
from .errors import error_text, milli_text, times_noise_text
from .tables import add_row, clipped, error, indented, interval_text, named, note, number, plain_table


def fit_table(fit: Fit, intervals: Mapping[str, RefittedInterval] | None = None) -> Table:
    """Every estimate with its standard error, unit, 95% interval and a note; then the fixed parameters."""
    table = plain_table("parameter", "value", "+-", "unit", "95% interval", "note", right=("value", "+-"))
    known = parameters(fit.model)
    for name, estimate in fit.estimates.items():
        own = (intervals or {}).get(name)
        remarks = ", ".join(filter(None, (note(estimate), f"by {own.source}" if own else "")))
        interval = (own.low, own.high) if own else estimate.interval()
        add_row(
            table,
            named(name),
            number(estimate.value, estimate.sd),
            error(estimate.sd),
            estimate.unit,
            interval_text(clipped(interval, known[name].domain), estimate.sd) if interval else "",
            remarks,
            style="yellow" if not estimate.determined else None,
        )
    for name, value, unit in held(fit.model, fit.estimates):
        add_row(table, named(name), number(value), "", unit, "", "fixed", style="dim")
    return table


def held(model: Model, estimates: Mapping[str, Estimate]) -> list[tuple[str, float, str]]:
    """(name, value, unit) of the tyre's and the effects' parameters that were not estimated."""
    shown = ("effects.",) if not model.constraint.slips else ("tyre.", "effects.")
    return [
        (name, float(value), domain.unit)
        for name, (value, domain) in parameters(model).items()
        if name.startswith(shown)
        and name not in estimates
        and not (name in ("tyre.dSh", "tyre.dSv") and float(value) == 0)
    ]


def runs_table(scores: Sequence[RunScore]) -> Table:
    """The root mean square errors of each run, and their multiples of the noise, of all channels and of each."""
    right = (*map(narrow, (POSITION, HEADING, ERROR, *CHANNELS)), "worst\nat [s]")
    table = plain_table("run", *right, right=right)
    for role, title in (("train", "train"), ("heldout", "held out")):
        of_role = [s for s in scores if s.role == role]
        if of_role and len({s.role for s in scores}) > 1:
            add_row(table, title, style="bold")
        for s in of_role:
            add_row(
                table,
                s.run,
                *map(milli_text, (s.position_m, s.heading_rad)),
                *map(times_noise_text, (s.misfit, s.channels["x"], s.channels["y"], s.channels["heading"])),
                f"{s.worst_time_s:.2f}",
            )
    return table


def combinations_table(combinations: Mapping[str, Estimate]) -> Table:
    """The combinations of parameters that the runs determine."""
    table = plain_table("combination", "value", "+-", "unit", right=("value", "+-"))
    for name, estimate in combinations.items():
        add_row(table, name, number(estimate.value, estimate.sd), error(estimate.sd), estimate.unit)
    return table


def log_clocks_table(runs: Sequence[Run]) -> Table:
    """Offset and drift of the clocks of the joint logs."""
    right = ("offset [ms]", "+-", "drift [1e-6]", "+- ")
    table = plain_table("run", *right, "from", right=right)
    for run in runs:
        if run.log is not None:
            log = run.log
            late, fast = (None if sd is None else sd * unit for sd, unit in ((log.offset_sd, 1e3), (log.drift_sd, 1e6)))
            cells = number(1e3 * log.offset, late), error(late), number(1e6 * log.drift, fast), error(fast)
            add_row(table, run.name, *cells, log.source)
    return table


def score_line(role: str, score: Score) -> str:
    """One role's score as a sentence."""
    return f"{role}: root mean square error {error_text(score)}"


def noise_line(noise: Noise) -> str:
    """The noise as a sentence. Errors in position are of x and y together: sqrt(2) times that of each."""
    position, heading = 1e3 * float(noise.position), 1e3 * float(noise.heading)
    both = f"{position:.3g} mm in x and in y ({2**0.5 * position:.3g} mm together)"
    return f"noise of one sample {both} and {heading:.3g} mrad ({noise.source})"


def fit_report(
    case: Case, noise: Noise, fit: Fit, intervals: Mapping[str, RefittedInterval] | None = None
) -> RenderableType:
    """The report of `snakejax fit`."""
    model = fit.model
    parts: list[RenderableType] = [
        Text(f"{case.name}: {case.title}", style="bold"),
        Text(f"model {model_kind(model)}, skid {constraint_kind(model)}, {noise_line(noise)}"),
        Text(),
        indented(fit_table(fit, intervals)),
        indented(runs_table([*fit.runs, *fit.heldout])),
    ]
    if any(run.log is not None and run.log.free for run in fit.recordings):
        parts.append(indented(log_clocks_table(fit.recordings)))
    if fit.combinations:
        parts.append(indented(combinations_table(fit.combinations)))
    parts.append(Text(score_line("train", fit.train_score)))
    if fit.heldout_score is not None:
        parts.append(Text(score_line("held out", fit.heldout_score)))
    parts += [Text(f"! {description}", style="yellow") for description in fit.advice]
    return Group(*parts)
