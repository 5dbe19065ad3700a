"""Plain tables as text, divided by commas, semicolons, tabs or spaces, and TUM trajectories, which are such tables.

The first row that is no comment names the columns, a second one may hold their units; without names the columns are
called 1, 2, 3 and so on. `columns` says which holds what, unless their names do: time_s,x_mm,y_mm,heading_deg.
"""

import csv
import re

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line
from ._capture import ANGLE, LENGTH, TIME, Capture, Source
from ._cells import Rows, all_at_once, numbers
from ._roles import LOST, capture_of, columns_of
from ._text import is_blank, separator_of, shown, split

MOST_COMMENTS = 100
TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d")


def recognises(source: Source) -> bool:
    """Whether the first row that is no comment has three cells or more."""
    lines = source.text[:2_000_000].split("\n", MOST_COMMENTS)
    first = next((line for line in lines if not is_blank(line) and not line.startswith("#")), "")
    return len(_cells(first, _divider(first))) > 2 and first.isprintable() | ("\t" in first)


def read(source: Source) -> Capture:
    """All objects. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    at = next(i for i, line in enumerate(lines) if not is_blank(line) and not line.startswith("#"))
    separator = _divider(lines[at])
    decimal = separator_of("\n".join(lines[at : at + 40]))[1] if separator in ";\t" else "."
    names, units, hints, first = _cells(lines[at], separator), [], source.hints, at
    if any(_is_number(cell, decimal) for cell in names):
        tum = hints.columns is None and separator == " " and len(names) == len(TUM)
        if tum:
            hints = hints._replace(columns=dict(zip(TUM, map(str, range(1, 9)), strict=True)))
        names = [str(i + 1) for i in range(len(names))]
    else:
        tum, first = False, at + 1
        cells = _cells(lines[first], separator) if first < len(lines) else []
        if any(cells) and all(cell in (*LENGTH, *ANGLE, *TIME, "") for cell in cells):
            units, first = cells, first + 1
    where = at_line(path, at + 1)
    columns, used = columns_of(names, units, hints, where)
    rows = Rows(path, lines[first:], first + 1, separator, decimal)
    if not rows.lines:
        raise InputError("The table ends before its first row", at_line(path, len(lines)), "export the file again")
    wanted = {column.role: column.index for column in columns}
    values, labels = _values(rows, names, [c.index for c in columns if c.role != "object"], wanted)
    format = "TUM" if tum else "plain CSV"
    return capture_of(format, source, where, columns, used, values, labels)


def _divider(line: str) -> str:
    marks = {mark: line.count(mark) for mark in (",", ";", "\t")}
    best = max(marks, key=lambda mark: marks[mark])
    return best if marks[best] else " "


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    return split(line, separator)


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _values(
    rows: Rows, names: list[str], indices: list[int], wanted: dict[str, int]
) -> tuple[dict[int, Float[np.ndarray, " n"]], np.ndarray | None]:
    """The numbers of the columns `indices`, and the names in the column of objects. Other columns may hold anything."""
    if "object" not in wanted:
        found = [all_at_once(part, len(names)) for _, part in rows.parts(len(names))]
        whole = [values[:, indices] for values in found if values is not None]
        if len(whole) == len(found):
            return dict(zip(indices, np.concatenate(whole).T, strict=True)), None
    need = max(wanted.values())
    label, clock = wanted.get("object"), wanted["time"]
    kept, labels, dates = [], [], []
    for row, line in enumerate(rows.lines):
        cells = _cells(line, rows.separator)
        if len(cells) <= need:
            what = f"The row has {len(cells)} cells, but there are {len(names)} columns"
            raise InputError(what, rows.where(row), "complete the row, or remove it where it is blank")
        if dates or (not row and _DATE.match(cells[clock])):
            dates.append(cells[clock])
            cells[clock] = "0"
        kept.append("\t".join("" if cells[i] in LOST else cells[i] for i in indices))
        if label is not None:
            labels.append(cells[label])
    table = numbers(Rows(rows.path, kept, rows.first, "\t", rows.decimal), [names[i] for i in indices])
    values = dict(zip(indices, table.T, strict=True))
    if dates:
        values[clock] = _seconds(dates, rows)
    return values, np.array(labels) if label is not None else None


def _seconds(dates: list[str], rows: Rows) -> Float[np.ndarray, " n"]:
    """Dates with the time of day as seconds since 1970."""
    try:
        stamps = np.array([date.removesuffix("Z").replace(" ", "T", 1) for date in dates], "datetime64[ns]")
    except ValueError:
        bad = next((i for i, date in enumerate(dates) if not _DATE.match(date)), 0)
        what = f'"{shown(dates[bad])}" is no date and time'
        raise InputError(what, rows.where(bad), "write 2026-01-31T12:00:00.5, all in one time zone") from None
    return stamps.astype(np.int64) * 1e-9
