"""Results as tables and sentences for a terminal of 80 columns. Everything here is pure: it returns what to print."""

from collections.abc import Mapping, Sequence

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ._compare import Comparison, Side
from ._estimates import Estimate
from ._fit import Fit
from ._json import short
from ._misfit import RunScore, Score
from ._model import Model
from ._provenance import model_kind, skid_kind
from ._recording import Case, Noise, Run
from ._skid import Ideal
from ._units import parameters
from .quality import Inspection

MOST_FINDINGS = 12
"""How many findings a report lists on a terminal; the JSON has all."""

Interval = tuple[float | None, float | None]


def number(value: float | None, sd: float | None = None) -> str:
    """`value` with as many digits as its standard error `sd` bears: the error's first two, but no less than units."""
    if value is None:
        return ""
    if sd is None or not 0 < sd < float("inf") or abs(value) >= 1e7:
        return f"{value:.4g}"
    decimals = max(1 - _magnitude(sd), 0)
    if decimals <= 8:
        return f"{value:z.{decimals}f}"
    return f"{value:.{max(decimals + _magnitude(value), 0)}e}" if value else "0"


def _magnitude(value: float) -> int:
    """The power of ten of the first digit."""
    return int(f"{value:.1e}".split("e")[1])


def error(sd: float | None) -> str:
    """A standard error, to two digits."""
    return "" if sd is None else number(sd, sd)


def interval_text(interval: Interval | None, sd: float | None = None) -> str:
    """A 95% interval; an end that the data leave open is a sign of infinity."""
    if interval is None:
        return ""
    low, high = interval
    return f"{'-inf' if low is None else number(low, sd)} to {'inf' if high is None else number(high, sd)}"


def note(estimate: Estimate) -> str:
    """What to know before believing an estimate."""
    if estimate.at_bound:
        return "at its bound"
    return "" if estimate.determined else "cannot be determined"


def plain_table(*columns: str, right: Sequence[str] = ()) -> Table:
    """A table without frame; the columns in `right` are aligned on the right."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    for column in columns:
        names = column in ("run", "parameter", "model", "candidate")
        justify = "right" if column in right else "left"
        table.add_column(Text(column), justify=justify, overflow="fold", no_wrap=names)
    return table


def add_row(table: Table, *cells: str, style: str | None = None) -> None:
    """Add a row of `cells` to `table` as they are: brackets in a name are no markup."""
    table.add_row(*map(Text, cells), style=style)


def misfit_text(misfit: float | None) -> str:
    """A misfit to three digits, and to two with an exponent where it is large."""
    if misfit is None:
        return ""
    return f"{misfit:#.3g}".rstrip(".") if misfit < 999.5 else f"{misfit:.1e}".replace("e+0", "e").replace("e+", "e")


def named(name: str) -> str:
    """A parameter in a table: `B`, `ground_slope.sx`, `board.mass`."""
    return short(name).removeprefix("effects.")


def fit_table(found: Fit, intervals: Mapping[str, Interval] | None = None) -> Table:
    """Every estimate with its standard error, unit, 95% interval and a note; then what was held."""
    table = plain_table("parameter", "value", "+-", "unit", "95% interval", "note", right=("value", "+-"))
    for name, estimate in found.estimates.items():
        profiled = (intervals or {}).get(name)
        told = note(estimate) + (", by profile" if profiled and note(estimate) else "by profile" if profiled else "")
        add_row(
            table,
            named(name),
            number(estimate.value, estimate.sd),
            error(estimate.sd),
            estimate.unit,
            interval_text(profiled or estimate.interval(), estimate.sd),
            told,
            style="yellow" if not estimate.determined else None,
        )
    for name, value, unit in held(found.model, found.estimates):
        add_row(table, named(name), number(value), "", unit, "", "held", style="dim")
    return table


def held(model: Model, estimates: Mapping[str, Estimate]) -> list[tuple[str, float, str]]:
    """(name, value, unit) of the tyre's and the effects' parameters that were not estimated."""
    shown = ("effects.",) if isinstance(model.skid, Ideal) else ("tyre.", "effects.")
    return [
        (name, float(value), domain.unit)
        for name, (value, domain) in parameters(model).items()
        if name.startswith(shown)
        and name not in estimates
        and not (name in ("tyre.dSh", "tyre.dSv") and float(value) == 0)
    ]


def runs_table(scores: Sequence[RunScore]) -> Table:
    """How each run fares: misfits in units of the noise variance, errors as root mean squares."""
    right = ("misfit", "x", "y", "heading", "rms\n[mm]", "rms\n[mrad]", "worst\nat [s]")
    table = plain_table("run", *right, right=right)
    for role, title in (("train", "train"), ("heldout", "held out")):
        of_role = [s for s in scores if s.role == role]
        if of_role and len({s.role for s in scores}) > 1:
            add_row(table, title, style="bold")
        for s in of_role:
            add_row(
                table,
                s.run,
                *map(misfit_text, (s.misfit, s.channels["x"], s.channels["y"], s.channels["heading"])),
                f"{1e3 * s.position_m:.3g}",
                f"{1e3 * s.heading_rad:.3g}",
                f"{s.worst_time_s:.2f}",
            )
    return table


def combinations_table(combinations: Mapping[str, Estimate]) -> Table:
    """What the runs determine of several parameters together."""
    table = plain_table("together", "value", "+-", "unit", right=("value", "+-"))
    for name, estimate in combinations.items():
        add_row(table, name, number(estimate.value, estimate.sd), error(estimate.sd), estimate.unit)
    return table


def log_clocks_table(runs: Sequence[Run]) -> Table:
    """How the clocks of the joint logs go, as far as they were estimated."""
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
    return (
        f"{role}: misfit {misfit_text(score.misfit)} (1 = noise), rms error {1e3 * score.position_m:.3g} mm "
        f"and {1e3 * score.heading_rad:.3g} mrad"
    )


def noise_line(noise: Noise) -> str:
    """The noise as a sentence."""
    position, heading = 1e3 * float(noise.position), 1e3 * float(noise.heading)
    return f"noise of one sample {position:.3g} mm and {heading:.3g} mrad ({noise.source})"


def quality_report(seen: Inspection) -> RenderableType:
    """What was found in the recordings before anything was fitted to them, and what was done about it."""
    runs = seen.case.runs
    frames = sum(len(run.times) for run in runs)
    there = sum(int(np.isfinite(np.asarray(run.pose)).all(axis=1).sum()) for run in runs)
    lost = f"{len(runs)} runs, {frames} frames, {1 - there / max(frames, 1):.1%} of them lost"
    if not seen.findings:
        return Text(f"recordings: {lost}; nothing is wrong with them", style="dim")
    table = plain_table("run", "from [s]", "to [s]", "found", "done, or to do", right=("from [s]", "to [s]"))
    done = {"mask": "masked", "turn": "turned back"}
    for f in seen.findings[:MOST_FINDINGS]:
        acted = done[f.action] if f.applied else f.remedy
        when = ("", "") if f.run is None else (f"{f.start:.2f}", f"{f.end:.2f}")
        add_row(table, f.run or "all", *when, f.what, acted)
    more = len(seen.findings) - MOST_FINDINGS
    end = f"{more} more findings are in the JSON; " if more > 0 else ""
    how = "as recorded" if seen.as_recorded else f"{sum(seen.masked.values())} frames masked"
    return Group(Text(f"recordings: {lost}"), Text(), indented(table), Text(f"{end}{how}"), Text())


def indented(renderable: RenderableType) -> Padding:
    """`renderable` two columns in."""
    return Padding(renderable, (0, 0, 1, 2))


def fit_report(case: Case, noise: Noise, found: Fit, intervals: Mapping[str, Interval] | None = None) -> RenderableType:
    """All that `snakejax fit` says of a case."""
    model = found.model
    parts: list[RenderableType] = [
        Text(f"{case.name}: {case.title}", style="bold"),
        Text(f"model {model_kind(model)}, skid {skid_kind(model)}, {noise_line(noise)}"),
        Text(),
        indented(fit_table(found, intervals)),
        indented(runs_table([*found.runs, *found.heldout])),
    ]
    if any(run.log is not None and run.log.free for run in found.study.runs):
        parts.append(indented(log_clocks_table(found.study.runs)))
    if found.combinations:
        parts.append(indented(combinations_table(found.combinations)))
    parts.append(Text(score_line("train", found.train_score)))
    if found.heldout_score is not None:
        parts.append(Text(score_line("held out", found.heldout_score)))
    parts += [Text(f"! {sentence}", style="yellow") for sentence in found.advice]
    return Group(*parts)


SHOWN = 5
"""How many lines a list of what fails has on a terminal; the JSON has all."""


def worst_table(failing: Comparison) -> Table:
    """The moments furthest from the model."""
    right = ("time\n[s]", "off by\n[sd]", "off by\n[mm, mrad]")
    table = plain_table("run", "channel", *right, right=right)
    for m in failing.worst[:SHOWN]:
        add_row(table, m.run, m.channel, f"{m.time:.2f}", f"{m.deviations:.1f}", f"{1e3 * m.size:.3g}")
    return table


def shares_table(failing: Comparison) -> Table:
    """What the residual, or its rate, goes with."""
    table = plain_table("goes with", "of", "share", "p", right=("share", "p"))
    for s in failing.depends_on[:SHOWN]:
        of = s.channel.replace("_rate", ", its rate")
        add_row(table, s.variable, of, f"{100 * s.share:.0f}%", f"{s.p_family:.2g}")
    return table


def sides_table(sides: Sequence[Side]) -> Table:
    """Several models fitted to the same runs."""
    right = ("misfit", "held out", "rms\n[mm]", "rms\n[mrad]")
    table = plain_table("model", *right, right=right)
    for side in sides:
        if side.train is None:
            add_row(table, side.model, side.failure or "failed")
            continue
        shown = side.heldout or side.train
        heldout = misfit_text(side.heldout and side.heldout.misfit)
        errors = (f"{1e3 * shown.position_m:.3g}", f"{1e3 * shown.heading_rad:.3g}")
        add_row(table, side.model, misfit_text(side.train.misfit), heldout, *errors)
    return table


def compare_report(failing: Comparison, sides: Sequence[Side] = ()) -> RenderableType:
    """All that `snakejax compare` says of a case beside its fit."""
    white = "is white noise" if failing.white else "is not white noise"
    parts: list[RenderableType] = [
        Text(),
        Text(f"What the model leaves {white}, at 5% over all runs and channels (portmanteau test)."),
    ]
    if not failing.depends_on:
        parts.append(Text("It goes with no variable, at 5% over all of them."))
    parts += [Text(), indented(worst_table(failing))]
    if failing.depends_on:
        parts.append(indented(shares_table(failing)))
    if sides:
        parts.append(indented(sides_table(sides)))
    return Group(*parts)
