"""OptiTrack Motive CSV: rigid bodies with quaternions or Euler angles, and markers; Motive's y axis points up.

Format Version,1.21,Take Name,...,Export Frame Rate,120,...,Rotation Type,Quaternion,Length Units,Meters,...
(blank)
,,Rigid Body,Rigid Body,...          what each column belongs to: also Rigid Body Marker, Marker, Bone
,,board,board,...                    its name
,,"CF5107...",...                    its id; newer versions have a row of parents too
,,Rotation,Rotation,...,Position,...
Frame,Time,X,Y,Z,W,X,Y,Z,,...
0,0.000000,0.1,...                   blank cells: lost
"""

import csv
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line
from ._capture import LENGTH, Body, Capture, Source, lost_together, on_grid
from ._cells import Rows, numbers, ticks
from ._text import is_blank, number, separator_of, shown, split
from ._turn import from_euler, require_unit

LENGTHS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm", "Inches": "in", "Feet": "ft"}
MOST_HEADER_ROWS = 12
BODIES = ("Rigid Body", "Bone")
MARKERS = ("Marker", "Rigid Body Marker", "Bone Marker")


class Column(NamedTuple):
    """A column by what the header says of it, such as Rigid Body, board, Rotation, X."""

    kind: str
    name: str
    part: str
    axis: str


def recognises(source: Source) -> bool:
    """Whether the text begins as a Motive export does."""
    return source.text[:100].lstrip('"').startswith("Format Version")


def read(source: Source) -> Capture:
    """All rigid bodies and labelled markers. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    separator, decimal = separator_of("\n".join(lines[: MOST_HEADER_ROWS + 20]))
    first = next(csv.reader([lines[0]], delimiter=separator))
    facts = dict(zip(first[::2], first[1::2], strict=False))
    rate = number(facts.get("Export Frame Rate", ""), "Export Frame Rate", at_line(path, 1), decimal)
    if not rate > 0:
        raise InputError("Export Frame Rate is not above 0", at_line(path, 1), "export the file again with its header")
    unit = LENGTHS.get(facts.get("Length Units", ""))
    if unit is None:
        what = f'Unknown Length Units "{shown(facts.get("Length Units", ""))}"'
        raise InputError(what, at_line(path, 1), f"export in {' or '.join(LENGTHS)}")
    if facts.get("Coordinate Space", "Global") == "Local":
        raise InputError("The poses are in local coordinates", at_line(path, 1), "export with Coordinate Space Global")
    order = facts.get("Rotation Type", "Quaternion")
    if order != "Quaternion" and sorted(order) != ["X", "Y", "Z"]:
        raise InputError(f'Unknown Rotation Type "{shown(order)}"', at_line(path, 1), "export Quaternion")
    columns, start = _columns(source, separator)
    rows = Rows(path, lines[start:], start + 1, separator, decimal)
    values = numbers(rows, ["Frame", "Time", *(f"{c.name} {c.part} {c.axis}".strip() for c in columns)])
    frames = ticks(values[:, 0], values[:, 1], rate, rows)
    times = np.arange(frames[-1] - frames[0] + 1) / rate
    data = values[:, 2:]
    where = at_line(path, 4)
    bodies, markers = {}, {}
    places = {(c.kind, c.name, c.part, c.axis): i for i, c in reversed([*enumerate(columns)])}
    for kind, name in dict.fromkeys((c.kind, c.name) for c in columns):
        position = _triple(places, kind, name)
        if position is None:
            continue
        place = on_grid(frames, lost_together(data[:, position] * LENGTH[unit]))
        if kind in BODIES:
            turns = "XYZW" if order == "Quaternion" else order
            turned = [places.get((kind, name, "Rotation", axis)) for axis in turns]
            if any(column is None for column in turned):
                what = f'Missing a Rotation of "{shown(name)}"'
                raise InputError(what, at_line(path, start), f"export {', '.join(turns)} for each rigid body")
            rotation = _rotation(lost_together(data[:, np.array(turned, int)]), order)
            require_unit(rotation, name, at_line(path, start + 1))
            bodies[name] = Body(times, place, on_grid(frames, rotation), at_line(path, start + 1))
        elif kind in MARKERS and (kind == "Marker" or name not in markers) and not name.startswith("Unlabeled"):
            markers[name] = place
    lost = sum(1 for kind, name in {(c.kind, c.name) for c in columns} if name.startswith("Unlabeled"))
    notes = [f"{lost} unlabelled markers are passed over"] if lost else []
    return Capture("Motive CSV", path, where, rate, unit, bodies, markers, times, up="y", notes=notes)


def _columns(source: Source, separator: str) -> tuple[list[Column], int]:
    """The columns after Frame and Time, and how many lines stand before the data."""
    path, lines = source.path, source.lines
    last = next((i for i in range(min(MOST_HEADER_ROWS, len(lines))) if lines[i].lstrip('"').startswith("Frame")), None)
    if last is None or last + 1 >= len(lines):
        what = "The Motive file ends before its first frame"
        raise InputError(what, at_line(path, len(lines)), "export the file again with its column headers")
    above = [split(line, separator) for line in lines[1:last] if not is_blank(line)]
    axes = split(lines[last], separator)
    if len(above) < 3:
        raise InputError("The header has too few rows", at_line(path, last + 1), "export with the column headers")
    width = max(i for row in (axes, above[-1]) for i, cell in enumerate(row) if cell) + 1

    def cell(row: list[str], i: int) -> str:
        return row[i] if i < len(row) else ""

    kinds, names, parts = above[0], above[1], above[-1]
    return [Column(cell(kinds, i), cell(names, i), cell(parts, i), cell(axes, i)) for i in range(2, width)], last + 1


def _triple(places: dict[tuple[str, str, str, str], int], kind: str, name: str) -> list[int] | None:
    found = [places.get((kind, name, "Position", axis)) for axis in "XYZ"]
    return None if None in found else [i for i in found if i is not None]


def _rotation(cells: Float[np.ndarray, "n c"], order: str) -> Float[np.ndarray, "n 4"]:
    return cells if order == "Quaternion" else from_euler(order, cells * math.pi / 180)
