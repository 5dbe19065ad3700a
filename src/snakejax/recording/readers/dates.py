"""Dates with the time of day, as clocks of plain tables: 2026-01-31T12:00:00.5, 2026/1/31 9:05:00+01:00."""

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


def seconds(dates: Sequence[str], rows: Rows) -> Float[np.ndarray, " n"]:
    """`dates`, one for each of `rows`, as seconds since 1970, all in the zone of the first.

    **Raises:** `InputError` for one that is none, with its line, or is in another zone.
    """
    plain = []
    zones = set()
    for row, date in enumerate(dates):
        if (match := DATE.fullmatch(date.strip())) is None:
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
    return stamps.astype(np.int64) * 1e-9


def _is_date(date: str) -> bool:
    try:
        np.datetime64(date, "ns")
    except ValueError:
        return False
    return True


def _complaint(date: str, where: str) -> InputError:
    what = f'"{shown(date)}" is no date and time'
    return InputError(what, where, "write 2026-01-31T12:00:00.5, all in one time zone")
