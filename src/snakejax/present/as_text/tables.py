"""Numbers and tables for a terminal of 80 columns."""

from collections.abc import Mapping, Sequence

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from snakejax.core.parameter import Domain, short_name
from snakejax.estimation.uncertainty import Estimate

MOST_DIGITS = 9
"""The largest number of significant digits: the error of a simulation is about 1e-9 of its result."""
Interval = tuple[float | None, float | None]
MILLI = {"rad": "mrad", "m": "mm"}
"""Units of which small values are shown as thousandths."""


def number(value: float | None, sd: float | None = None) -> str:
    """`value` rounded to the second digit of its standard error `sd`, but at most to units."""
    if value is None:
        return ""
    if sd is None or not 0 < sd < float("inf") or abs(value) >= 1e7:
        return f"{value:.4g}"
    decimals = max(1 - _magnitude(sd), 0)
    if value and decimals + _magnitude(value) >= MOST_DIGITS:
        return f"{value:.{MOST_DIGITS}g}"
    if decimals < MOST_DIGITS:
        return f"{value:z.{decimals}f}"
    return f"{value:.{max(decimals + _magnitude(value), 0)}e}" if value else "0"


def _magnitude(value: float) -> int:
    """The power of ten of the first digit."""
    return int(f"{value:.1e}".split("e")[1])


def error(sd: float | None) -> str:
    """A standard error, to two digits."""
    return number(sd, sd) if sd is not None and np.isfinite(sd) else ""


def interval_text(interval: Interval | None, sd: float | None = None) -> str:
    """A 95% interval; an end that the data do not determine is infinite."""
    if interval is None:
        return ""
    low, high = interval
    return f"{'-inf' if low is None else number(low, sd)} to {'inf' if high is None else number(high, sd)}"


def clipped(interval: Interval, domain: Domain | None) -> Interval:
    """`interval` within the bounds of `domain`: beyond them there is no value. Open ends stay open."""
    if domain is None:
        return interval
    low, high = interval
    least = 0.0 if domain.positive else domain.low
    return None if low is None else max(low, least), None if high is None else min(high, domain.high)


def bounds_text(domain: Domain) -> str:
    """The bounds of a parameter: `above 0`, `0 to 2`, `at most 1`, `none`."""
    low, high = domain.low, domain.high
    if np.isinf(low) and np.isinf(high):
        return "above 0" if domain.positive else "none"
    if np.isinf(low):
        return f"{'above 0, ' if domain.positive else ''}at most {high:g}"
    return f"at least {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"


def note(estimate: Estimate) -> str:
    """A warning about an estimate; empty where there is none."""
    if estimate.at_bound:
        return "at its bound"
    return "" if estimate.determined else "cannot be determined"


def unit_text(estimate: Estimate) -> str:
    """The unit behind a number; empty for a pure number."""
    return "" if estimate.unit == "-" else f" {estimate.unit}"


def expected_text(estimate: Estimate) -> str:
    """A value rounded by its standard error, with both and the unit: `0.0047 +- 0.0014 m`."""
    return f"{number(estimate.value, estimate.sd)} +- {error(estimate.sd)}{unit_text(estimate)}"


def with_unit(name: str, unit: str) -> str:
    """The title of a column, `D [N]`; the name alone for a pure number."""
    return name if unit in ("-", "1", "") else f"{name} [{unit}]"


def plain_table(*columns: str, right: Sequence[str] = ()) -> Table:
    """A table without frame; the columns in `right` are aligned on the right."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    for column in columns:
        names = column in ("run", "parameter", "model", "candidate")
        justify = "right" if column in right else "left"
        table.add_column(Text(column), justify=justify, overflow="fold", no_wrap=names)
    return table


def add_row(table: Table, *cells: str, style: str | None = None) -> None:
    """Add a row of `cells` to `table`; brackets in them are not markup."""
    table.add_row(*map(Text, cells), style=style)


def named(name: str) -> str:
    """A parameter in a table: `B`, `ground_slope.sx`, `board.mass`."""
    return short_name(name).removeprefix("effects.")


def indented(renderable: RenderableType) -> Padding:
    """`renderable` two columns in."""
    return Padding(renderable, (0, 0, 1, 2))


NOT_CONVERGED = "did not converge"
"""The note beside every number of a fit that did not converge."""


def not_converged_line(*fits: str) -> str:
    """The warning about the `fits` that did not converge."""
    *first, last = fits
    which, whose = (f"fits of {', '.join(first)} and {last}", "their") if first else (f"fit of {last}", "its")
    return f"The {which} {NOT_CONVERGED}: {whose} errors and values are less certain than the standard errors state."


def values_text(estimates: Mapping[str, Estimate]) -> str:
    """Names, values and standard errors: `sx = 3.000 +- 0.017 mrad`."""
    return ", ".join(f"{name} = {value_text(estimate)}" for name, estimate in estimates.items())


def value_text(estimate: Estimate) -> str:
    """A value with at most four digits, its standard error, and its unit; small angles and lengths as thousandths."""
    value, sd, unit = estimate.value, estimate.sd, estimate.unit
    if unit in MILLI and abs(value) < 1:
        value, sd, unit = 1e3 * value, None if sd is None else 1e3 * sd, MILLI[unit]
    unit = "" if unit == "-" else f" {unit}"
    if sd is None or not value:
        return f"{number(value, sd)}{f' +- {error(sd)}' if sd else ''}{unit}"
    least = 10.0 ** (int(f"{value:.3e}".split("e")[1]) - 3)
    if sd >= least:
        return f"{number(value, max(sd, 10 * least))} +- {error(sd)}{unit}"
    return f"{number(value, 10 * least)}{unit} (+- less than {least:g})"
