"""A comparison of model and measurement as text."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from snakejax.diagnosis.residuals.comparison import Comparison, ModelScore

from .columns import ERROR, HEADING, POSITION, narrow, of_heldout
from .errors import milli_text, times_noise_text
from .tables import NOT_CONVERGED, add_row, indented, plain_table

SHOWN = 5
"""The rows of a table on a terminal; the JSON has all."""


def worst_table(comparison: Comparison) -> Table:
    """The largest residuals."""
    right = ("time\n[s]", "residual\n[sd]", "residual\n[mm, mrad]")
    table = plain_table("run", "channel", *right, right=right)
    for m in comparison.worst[:SHOWN]:
        add_row(table, m.run, m.channel, f"{m.time:.2f}", f"{m.deviations:.1f}", milli_text(m.size))
    return table


def shares_table(comparison: Comparison) -> Table:
    """The variables on which the residual, or its rate, depends."""
    table = plain_table("depends on", "residual of", "share", "p", right=("share", "p"))
    for s in comparison.depends_on[:SHOWN]:
        channel = s.channel.replace("_rate", ", its rate")
        add_row(table, s.variable, channel, f"{100 * s.share:.0f}%", f"{s.p_family:.2g}")
    return table


def sides_table(sides: Sequence[ModelScore]) -> Table:
    """Several models fitted to the same runs."""
    right = tuple(map(narrow, (ERROR, of_heldout(ERROR), POSITION, HEADING)))
    table = plain_table("model", *right, "", right=right)
    for side in sides:
        if side.train is None:
            add_row(table, side.model, side.failure or "failed")
            continue
        heldout = times_noise_text(side.heldout and side.heldout.misfit)
        errors = (milli_text(side.train.position_m), milli_text(side.train.heading_rad))
        note = NOT_CONVERGED if side.converged is False else ""
        add_row(table, side.model, times_noise_text(side.train.misfit), heldout, *errors, note)
    return table


def compare_report(comparison: Comparison, sides: Sequence[ModelScore] = ()) -> RenderableType:
    """The report of `snakejax compare` after that of the fit."""
    white = "are white noise" if comparison.white else "are not white noise"
    parts: list[RenderableType] = [
        Text(),
        Text(f"The residuals {white}, at 5% over all runs and channels (portmanteau test)."),
    ]
    if not comparison.depends_on:
        parts.append(Text("No significant dependence on any variable (5%)."))
    parts += [Text(), indented(worst_table(comparison))]
    if comparison.depends_on:
        parts.append(indented(shares_table(comparison)))
    if sides:
        parts.append(indented(sides_table(sides)))
    return Group(*parts)
