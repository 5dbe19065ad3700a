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

from snakejax.core.errors import InputError, at_line

from .capture import LENGTH, Body, Capture, Source, lost_together, on_grid, repeated
from .cells import is_blank, number, separator_of, shown, split
from .numeric_table import Rows, numbers, ticks
from .rotations import from_euler, require_unit

LENGTHS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm", "Inches": "in", "Feet": "ft"}
MOST_HEADER_ROWS = 12
"""Rows that are searched for the row of titles; Motive writes about seven before the data."""
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
    for kind, name in dict.fromkeys((c.kind, c.name) for c in columns if c.kind in (*BODIES, *MARKERS)):
        position = _columns_of(places, kind, name, "Position", "XYZ", at_line(path, start))
        if not position:
            continue
        place = on_grid(frames, lost_together(data[:, position] * LENGTH[unit]))
        if kind in BODIES:
            turns = "XYZW" if order == "Quaternion" else order
            turned = _columns_of(places, kind, name, "Rotation", turns, at_line(path, start))
            if not turned:
                what = f'The {kind} "{shown(name)}" has a position, but no rotation'
                raise InputError(what, at_line(path, start), f"export its Rotation, {', '.join(turns)}")
            rotation = _rotation(lost_together(data[:, turned]), order)
            require_unit(rotation, name, at_line(path, start + 1))
            bodies[name] = Body(times, place, on_grid(frames, rotation), at_line(path, start + 1))
        elif (kind == "Marker" or name not in markers) and not name.startswith("Unlabeled"):
            markers[name] = place
    lost = sum(1 for kind, name in {(c.kind, c.name) for c in columns} if name.startswith("Unlabeled"))
    notes = [f"{lost} unlabelled markers are ignored"] if lost else []
    first = [(c.kind, c.name) for c in columns if (c.part, c.axis) == ("Position", "X") and c.kind]
    doubled = [name for _, name in repeated(first) if name in bodies or name in markers]
    return Capture("Motive CSV", path, where, rate, unit, bodies, markers, times, up="y", doubled=doubled, notes=notes)


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
    cells = [(cell(kinds, i), cell(names, i), cell(parts, i), cell(axes, i).upper()) for i in range(2, width)]
    return [Column(*texts) for texts in cells], last + 1


def _columns_of(
    places: dict[tuple[str, str, str, str], int], kind: str, name: str, part: str, axes: str, where: str
) -> list[int]:
    """The columns of the `part` of a body or marker along `axes`; none where it has no such part.

    **Raises:** `InputError` where it has some of them, but not all.
    """
    by_axis = {axis: places.get((kind, name, part, axis)) for axis in axes}
    missing = [axis for axis, column in by_axis.items() if column is None]
    if missing and len(missing) < len(axes):
        known = ", ".join(axis or "(blank)" for (k, n, p, axis) in reversed(places) if (k, n, p) == (kind, name, part))
        what = f'{part} {" and ".join(missing)} of "{shown(name)}" is missing: its columns are {known}'
        raise InputError(what, where, f"export {', '.join(axes)} for each {kind.lower()}")
    return [column for column in by_axis.values() if column is not None]


def _rotation(cells: Float[np.ndarray, "n c"], order: str) -> Float[np.ndarray, "n 4"]:
    return cells if order == "Quaternion" else from_euler(order, cells * math.pi / 180)
