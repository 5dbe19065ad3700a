"""Plain tables as text, divided by commas, semicolons, tabs or spaces, and TUM trajectories, which are such tables.

    time_s,x_mm,y_mm,heading_deg       or    Frame,Time,LASI,,,RASI,,    the names of the columns, or of markers
    0.00,12.1,...                            ,,X,Y,Z,X,Y,Z               whose axes stand below them
                                             ,s,mm,mm,mm,mm,mm,mm        and units, where there are any

Comments may stand before. Without names the columns are called 1, 2, 3 and so on. `columns` says which holds what,
unless their names do.
"""

import csv
import re

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line

from .assumed import SI
from .capture import Capture, Source
from .cells import is_comment, separator_of, split
from .columns import COUNTED, LOST, Column, capture_of, columns_of
from .dates import is_date, seconds
from .names import AXES, UNIT_OF, without_unit
from .numeric_table import Rows, columns_at_once, numbers

MOST_COMMENTS = 100
"""Lines of comment that may stand before a table."""
TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_AXIS = re.compile(r"[xyz]( ?[\[(]\w+[\])])?", re.IGNORECASE)


def recognises(source: Source) -> bool:
    """Whether the first row that is no comment has three cells or more."""
    lines = source.text[:2_000_000].split("\n", MOST_COMMENTS)
    first = next((line for line in lines if not is_comment(line)), "")
    return len(_cells(first, _divider(first))) > 2 and first.isprintable() | ("\t" in first)


def read(source: Source) -> Capture:
    """All objects. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    at = next(i for i, line in enumerate(lines) if not is_comment(line))
    separator = _divider(lines[at])
    decimal = separator_of("\n".join(lines[at : at + 40]))[1] if separator in ";\t" else "."
    names, hints, first, tum = _cells(lines[at], separator), source.hints, at, False
    units: list[str] = []
    if any(_is_number(cell, decimal) for cell in names):
        tum = hints.columns is None and separator == " " and len(names) == len(TUM)
        if tum:
            hints = hints._replace(columns=dict(zip(TUM, map(str, range(1, 9)), strict=True)), units=SI)
        names = [str(i + 1) for i in range(len(names))]
    else:
        below = [_cells(line, separator) for line in lines[at + 1 : at + 4]]
        names, units, more = _header(names, below, decimal)
        first = at + 1 + more
    where = at_line(path, at + 1)
    columns = columns_of(names, units, hints, where)
    rows = Rows(path, lines[first:], first + 1, separator, decimal)
    if not rows.lines:
        raise InputError("The table ends before its first row", at_line(path, len(lines)), "export the file again")
    values, labels, dated = _values(rows, names, columns)
    if dated:
        columns = [c._replace(unit="s") if c.role == "time" else c for c in columns]
    return capture_of("TUM" if tum else "plain CSV", source, where, names, columns, values, labels)


def _header(names: list[str], below: list[list[str]], decimal: str) -> tuple[list[str], list[str], int]:
    """The names of the columns, their units, and how many of the rows `below` the first one say so."""
    rows = 0
    if below and _are_axes(below[0], decimal):
        names, rows = _joined(names, below[0]), 1
        # A table of pandas has the name of its index in a row of its own.
        if len(below) > 1 and below[1][0] and not any(below[1][1:]) and not _is_number(below[1][0], decimal):
            names, rows = [below[1][0], *names[1:]], 2
    units = below[rows] if rows < len(below) else []
    if any(units) and all(cell.strip("[]()").lower() in (*UNIT_OF, "", "-") for cell in units):
        return names, [UNIT_OF.get(cell.strip("[]()").lower(), "") for cell in units], rows + 1
    return names, [], rows


def _are_axes(cells: list[str], decimal: str) -> bool:
    """Whether the row has X, Y, Z below the names of markers, and no number."""
    axes = sum(1 for cell in cells if _AXIS.fullmatch(cell))
    return axes >= len(AXES) and not any(cell and _is_number(cell, decimal) for cell in cells)


def _joined(above: list[str], below: list[str]) -> list[str]:
    """Names of columns by the marker above, which may stand above the first of its axes only, and the axis below."""
    names, last = [], ""
    for i, axis in enumerate(below):
        own = above[i] if i < len(above) else ""
        if _AXIS.fullmatch(axis):
            last = own or last
            marker, unit = without_unit(last)
            if unit and not without_unit(axis)[1]:
                axis = f"{axis} ({unit})"
            names.append(f"{marker}.{axis}" if marker else axis)
        else:
            last = ""
            names.append(axis if axis and not own else f"{own} {axis}".strip())
    return names


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
    rows: Rows, names: list[str], columns: list[Column]
) -> tuple[dict[int, Float[np.ndarray, " n"]], np.ndarray | None, bool]:
    """The numbers of the columns by index, the names in the column of objects, and whether the times are dates.

    Other columns may hold anything.
    """
    indices = [c.column_index for c in columns if c.role != "object" and c.column_index != COUNTED]
    label = next((c.column_index for c in columns if c.role == "object"), None)
    clock = next(c.column_index for c in columns if c.role == "time")
    if label is None and (complete := columns_at_once(rows, len(names), indices)) is not None:
        return dict(zip(indices, complete.T, strict=True)), None, False
    need = max(*indices, label or 0)
    kept, labels, dates = [], [], []
    for row, line in enumerate(rows.lines):
        cells = _cells(line, rows.separator)
        if len(cells) <= need:
            what = f"The row has {len(cells)} cells, but there are {len(names)} columns"
            raise InputError(what, rows.where(row), "complete the row, or remove it where it is blank")
        if dates or (not row and clock != COUNTED and is_date(cells[clock])):
            dates.append(cells[clock])
            cells[clock] = "0"
        kept.append("\t".join("" if cells[i] in LOST else cells[i] for i in indices))
        if label is not None:
            labels.append(cells[label])
    table = numbers(Rows(rows.path, kept, rows.first, "\t", rows.decimal), [names[i] for i in indices])
    values = dict(zip(indices, table.T, strict=True))
    if dates:
        values[clock] = seconds(dates, rows)
    return values, np.array(labels) if label is not None else None, bool(dates)
