"""TRC: marker trajectories as tables, divided by tabs, or by commas where a spreadsheet saved them.

PathFileType  4  (X/Y/Z)  trial.trc
DataRate  CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  OrigDataStartFrame  OrigNumFrames
100       100         652        51          mm     100           0                   652
Frame#  Time  front          back
              X1   Y1   Z1   X2  Y2  Z2
1       0.00  1.0  2.0  3.0                   blank cells: lost

Markers may have no names, and are called by their number then.
"""

import numpy as np

from snakejax.core.errors import InputError, at_line

from .capture import LENGTH, Capture, Source, lost_together, on_grid, repeated
from .cells import is_blank, number, separator_of, shown, split
from .numeric_table import Rows, numbers, ticks
from .upward import upward

HEADER_ROWS = 4
"""Rows before the row of axes."""
LOST = ("nan", "NaN", "NAN")
LENGTHS = LENGTH | {"meters": 1.0, "millimeters": 1e-3, "centimeters": 1e-2}


def recognises(source: Source) -> bool:
    """Whether the text begins as a TRC does."""
    return source.text[:100].lstrip('"').startswith("PathFileType")


def read(source: Source) -> Capture:
    """All markers. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    separator, decimal = separator_of("\n".join(lines[:40]))
    if len(lines) <= HEADER_ROWS + 1:
        raise InputError("The TRC ends before its first frame", at_line(path, len(lines)), "export the file again")
    header = [split(line, separator) for line in lines[: HEADER_ROWS + 1]]
    facts = dict(zip(header[1], header[2], strict=False))
    rate = number(facts.get("DataRate", ""), "DataRate", at_line(path, 3), decimal)
    if not rate > 0:
        raise InputError("DataRate is not above 0", at_line(path, 3), "write the frames per second under DataRate")
    if (unit := facts.get("Units", "")).lower() not in LENGTHS:
        raise InputError(f'Unknown Units "{shown(unit)}"', at_line(path, 3), f"write {' or '.join(LENGTH)} under Units")
    if [cell.lower().rstrip("#") for cell in header[3][:2]] != ["frame", "time"]:
        raise InputError("The row of markers does not begin with Frame# and Time", at_line(path, 4), "export it again")
    start = next((i for i in range(HEADER_ROWS, len(lines)) if _is_data(lines[i], separator)), None)
    if start is None:
        raise InputError("The TRC ends before its first frame", at_line(path, len(lines)), "export the file again")
    rows = Rows(path, lines[start:], start + 1, separator, decimal)
    names, unnamed = _names(header[3], header[4] if start > HEADER_ROWS else [], rows)
    values = numbers(rows, ["Frame#", "Time", *(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ")], LOST)
    frames = ticks(values[:, 0], values[:, 1], rate, rows)
    markers: dict[str, np.ndarray] = {}
    for i, name in enumerate(names):
        if name not in markers:
            markers[name] = on_grid(frames, lost_together(values[:, 2 + 3 * i : 5 + 3 * i]) * LENGTHS[unit.lower()])
    times = np.arange(frames[-1] - frames[0] + 1) / rate
    notes = [f"{unnamed} of its markers have no name: they are called by their number"] if unnamed else []
    if (stated := facts.get("NumFrames", "")) and stated != str(len(values)):
        notes.append(f"its header says {shown(stated)} frames, but {len(values)} are there")
    up = upward(markers, "y", "a guess: OpenSim writes y, most other programs z")
    return Capture(
        "TRC",
        path,
        at_line(path, 4),
        rate,
        unit,
        {},
        markers,
        times,
        up=up.up,
        up_said=up.reason,
        up_open=up.open,
        doubled=repeated(names),
        notes=notes,
    )


def _is_data(line: str, separator: str) -> bool:
    """Whether the line is one of frames, or of what ought to be: its first cell is not blank."""
    return not is_blank(line) and bool(split(line, separator)[0])


def _names(titles: list[str], axes: list[str], rows: Rows) -> tuple[list[str], int]:
    """The names of all markers that have columns, and how many of them had none in the file.

    `titles` stand above the first column of each marker, or side by side; `axes` are X1, Y1, Z1, X2, ...

    **Raises:** `InputError` where there is not one of X, Y, Z for each.
    """
    apart = {i: name for i, name in enumerate(titles) if name and i > 1}
    if all(i % 3 == 2 for i in apart):
        named = [apart.get(i, "") for i in range(2, max(apart, default=-1) + 1, 3)]
    else:
        named = [*apart.values()]
    width = max(len(line.rstrip(f" \t{rows.separator}").split(rows.separator)) for line in rows.lines) - 2
    given = sum(1 for cell in axes if cell)
    count = max(len(named), -(-max(given, width) // 3))
    if width > 3 * len(named) and width % 3:
        what = f"There are {width} columns after Frame# and Time, which is not three for each marker"
        raise InputError(what, rows.where(0), "export X, Y and Z of each marker, and nothing else")
    if 0 < given < 3 * len(named):
        what = f"{len(named)} markers are named, but there are {given} columns of X, Y and Z"
        raise InputError(what, at_line(rows.path, HEADER_ROWS + 1), "export the file again")
    named += [""] * (count - len(named))
    return [name or f"marker {i + 1}" for i, name in enumerate(named)], sum(not name for name in named)
