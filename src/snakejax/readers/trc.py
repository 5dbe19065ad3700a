"""TRC: marker trajectories as tables, divided by tabs, or by commas where a spreadsheet saved them.

PathFileType  4  (X/Y/Z)  trial.trc
DataRate  CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  OrigDataStartFrame  OrigNumFrames
100       100         652        51          mm     100           0                   652
Frame#  Time  front          back
              X1   Y1   Z1   X2  Y2  Z2
1       0.00  1.0  2.0  3.0                   blank cells: lost
"""

import numpy as np

from .._errors import InputError, at_line
from ._capture import LENGTH, Capture, Source, lost_together, on_grid, repeated
from ._cells import Rows, numbers, ticks
from ._text import is_blank, number, separator_of, shown, split

HEADER_ROWS = 5
LOST = ("nan", "NaN", "NAN")


def recognises(source: Source) -> bool:
    """Whether the text begins as a TRC does."""
    return source.text[:100].lstrip('"').startswith("PathFileType")


def read(source: Source) -> Capture:
    """All markers. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    separator, decimal = separator_of("\n".join(lines[:40]))
    if len(lines) <= HEADER_ROWS:
        raise InputError("The TRC ends before its first frame", at_line(path, len(lines)), "export the file again")
    header = [split(line, separator) for line in lines[:HEADER_ROWS]]
    facts = dict(zip(header[1], header[2], strict=False))
    rate = number(facts.get("DataRate", ""), "DataRate", at_line(path, 3), decimal)
    if not rate > 0:
        raise InputError("DataRate is not above 0", at_line(path, 3), "write the frames per second under DataRate")
    if (unit := facts.get("Units", "")) not in LENGTH:
        raise InputError(f'Unknown Units "{shown(unit)}"', at_line(path, 3), f"write {' or '.join(LENGTH)} under Units")
    if header[3][:2] != ["Frame#", "Time"]:
        raise InputError("The row of markers does not begin with Frame# and Time", at_line(path, 4), "export it again")
    names = [name for name in header[3][2:] if name]
    given = [cell for cell in header[4] if cell]
    if len(given) != 3 * len(names):
        what = f"{len(names)} markers are named, but there are {len(given)} columns of X, Y and Z"
        raise InputError(what, at_line(path, 5), "export the file again")
    start = next(i for i in range(HEADER_ROWS, len(lines)) if not is_blank(lines[i]))
    rows = Rows(path, lines[start:], start + 1, separator, decimal)
    values = numbers(rows, ["Frame#", "Time", *given], LOST)
    frames = ticks(values[:, 0], values[:, 1], rate, rows)
    markers: dict[str, np.ndarray] = {}
    for i, name in enumerate(names):
        if name not in markers:
            markers[name] = on_grid(frames, lost_together(values[:, 2 + 3 * i : 5 + 3 * i]) * LENGTH[unit])
    times = np.arange(frames[-1] - frames[0] + 1) / rate
    notes = []
    if (said := facts.get("NumFrames", "")) and said != str(len(values)):
        notes.append(f"its header says {shown(said)} frames, but {len(values)} are there")
    doubled = repeated(names)
    where = at_line(path, 4)
    return Capture("TRC", path, where, rate, unit, {}, markers, times, doubled=doubled, notes=notes)
