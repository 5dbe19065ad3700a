"""Dates with the time of day, or that time alone, as clocks of plain tables: 2026-01-31T12:00:00.5, 01/31/2026
12:00:00, 9:05:00.25."""

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError

from .cells import shown
from .numeric_table import Rows

DATE = re.compile(
    r"(\d{4})[-/](\d{1,2})[-/](\d{1,2})[T ] ?(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)? ?(Z|[+-]\d\d:?\d\d)?"
)
YEAR_LAST = re.compile(r"(\d{1,2})[./-](\d{1,2})[./-](\d{4})(?=[T ])")
"""08/15/2022: the month first, unless the first number of any row is above 12."""
TIME_OF_DAY = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?")
DAY = 86400.0
"""Seconds of a day."""


def is_date(cell: str) -> bool:
    """Whether the cell holds a date with the time of day, or the time of day alone with its seconds."""
    return bool(DATE.match(_year_first(cell.strip(), False)) or TIME_OF_DAY.fullmatch(cell.strip()))


def seconds(dates: Sequence[str], rows: Rows) -> Float[np.ndarray, " n"]:
    """`dates`, one for each of `rows`, as seconds since 1970, all in the zone of the first; times of day without a date
    as seconds since the midnight before the first of them.

    **Raises:** `InputError` for one that is none, with its line, or is in another zone.
    """
    plain = []
    zones = set()
    day_first = any(int(match[1]) > 12 for date in dates if (match := YEAR_LAST.match(date.strip())))
    undated = TIME_OF_DAY.fullmatch(dates[0].strip()) is not None
    for row, date in enumerate(dates):
        dated = f"1970-01-01 {date.strip()}" if undated else _year_first(date.strip(), day_first)
        if (match := DATE.fullmatch(dated)) is None:
            raise _complaint(date, rows.where(row))
        year, month, day, hour, minute, second, fraction, zone = match.groups(default="")
        plain.append(f"{year}-{month:0>2}-{day:0>2}T{hour:0>2}:{minute}:{second or '00'}.{fraction or '0'}")
        zones.add(zone)
        if len(zones) > 1:
            raise _complaint(date, rows.where(row))
    try:
        stamps = np.array(plain, "datetime64[ns]")
    except ValueError:
        bad = next(i for i, date in enumerate(plain) if not _is_date(date))
        raise _complaint(dates[bad], rows.where(bad)) from None
    times = stamps.astype(np.int64) * 1e-9
    if not undated:
        return times
    midnights = np.diff(times, prepend=times[:1]) < -DAY / 2
    return times + DAY * np.cumsum(midnights)


def _year_first(date: str, day_first: bool) -> str:
    """A date with its year last in the order year, month, day; any other as it is."""
    return YEAR_LAST.sub(r"\3-\2-\1" if day_first else r"\3-\1-\2", date)


def _is_date(date: str) -> bool:
    try:
        np.datetime64(date, "ns")
    except ValueError:
        return False
    return True


def _complaint(date: str, where: str) -> InputError:
    what = f'"{shown(date)}" is no date and time'
    return InputError(what, where, "write 2026-01-31T12:00:00.5, all in one time zone")
