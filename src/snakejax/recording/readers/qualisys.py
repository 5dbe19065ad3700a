"""Qualisys TSV: markers (3D) and rigid bodies (6DOF), in mm and degrees, with tabs.

    NO_OF_FRAMES   500                     one fact a line
    FREQUENCY      100
    MARKER_NAMES   front  back             or BODY_NAMES  board  rotor
    Frame  Time  front X  front Y ...      may be left out; of bodies X Y Z Roll Pitch Yaw Residual Rot[0] ... Rot[8]
    1  0.00  12.1  ...                     lost: all zero, blank, or a negative residual

Of several bodies the titles may stand there once for all of them, and an empty column after each. The matrix Rot is
written by columns; where its transpose agrees with the angles instead, it is read by rows.
"""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line

from .capture import LENGTH, Body, Capture, Source, lost_together, on_grid, repeated
from .cells import is_blank, number, shown, split
from .numeric_table import Rows, numbers, ticks
from .rotations import from_euler, from_matrix, require_unit

LOST = ("NULL", "nan", "NaN", "-")
BODY_COLUMNS = ("X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9)))
ANGLES = {"roll": 3, "pitch": 4, "yaw": 5}
RESIDUAL = 6
AGREE = 1e-5
"""Quaternions whose product is so near 1 are of one rotation, to half a degree."""
_FACT = re.compile(r"[A-Z0-9_]{4,}$")
_TIMED = ("Frame", "Time")


class Table(NamedTuple):
    """The numbers of the file: `values` (n, c), of which the first columns are `timed`, the columns at which each name
    `starts`, and the `titles` of those of one body.
    """

    rows: Rows
    values: Float[np.ndarray, "n c"]
    timed: list[str]
    starts: list[int]
    titles: list[str]

    def column(self, name: str) -> Float[np.ndarray, " n"] | None:
        """The column Frame or Time, where there is one."""
        return self.values[:, self.timed.index(name)] if name in self.timed else None


def recognises(source: Source) -> bool:
    """Whether the text begins as a Qualisys export with its header does."""
    return re.match(r"(FILE_VERSION|NO_OF_FRAMES)\t", source.text) is not None


def read(source: Source) -> Capture:
    """All markers or all bodies. **Raises:** `InputError` with file, line and remedy."""
    path = source.path
    facts, places, at = _facts(source)
    key = next((key for key in ("BODY_NAMES", "MARKER_NAMES") if facts.get(key)), None)
    if key is None:
        remedy = "export 3D or 6DOF data with the TSV header"
        raise InputError("The Qualisys file names neither markers nor bodies", at_line(path, at), remedy)
    names = facts[key]
    parts = 3 if key == "MARKER_NAMES" else len(BODY_COLUMNS)
    table = _table(source, at, len(names), parts)
    rate = _rate(facts, places, path, table)
    frames = ticks(table.column("Frame"), table.column("Time"), rate, table.rows)
    times = np.arange(frames[-1] - frames[0] + 1) / rate
    bodies: dict[str, Body] = {}
    markers: dict[str, np.ndarray] = {}
    for name, start in zip(names, table.starts, strict=True):
        if name in markers or name in bodies:
            continue
        block = lost_together(table.values[:, start : start + parts])
        block[(block[:, :3] == 0).all(axis=1)] = np.nan
        if key == "MARKER_NAMES":
            markers[name] = on_grid(frames, block * LENGTH["mm"])
        else:
            rotation = _rotation(block, table.titles)
            block[np.isnan(rotation).any(axis=1)] = np.nan
            require_unit(rotation, name, table.rows.where(0))
            place = on_grid(frames, block[:, :3] * LENGTH["mm"])
            bodies[name] = Body(times, place, on_grid(frames, rotation), table.rows.where(0))
    notes = []
    if (stated := first_of(facts, "NO_OF_FRAMES")) and stated != str(len(table.values)):
        notes.append(f"its header says {shown(stated)} frames, but {len(table.values)} are there")
    where, doubled = at_line(path, places[key]), repeated(names)
    return Capture("Qualisys TSV", path, where, rate, "mm", bodies, markers, times, doubled=doubled, notes=notes)


def _facts(source: Source) -> tuple[dict[str, list[str]], dict[str, int], int]:
    """The facts of the header by their names, the lines on which they stand, and how many lines that takes."""
    facts: dict[str, list[str]] = {}
    places: dict[str, int] = {}
    lines, at = source.lines, 0
    while at < len(lines) and (is_blank(lines[at]) or _FACT.match(lines[at].split("\t", 1)[0].strip())):
        key, *values = split(lines[at], "\t")
        at += 1
        facts[key], places[key] = [value for value in values if value], at
    return facts, places, at


def _table(source: Source, at: int, count: int, parts: int) -> Table:
    """The rows from line `at` on, with `parts` columns for each of `count` names.

    **Raises:** `InputError` where there are more or fewer columns.
    """
    path, lines = source.path, source.lines
    titles = split(lines[at], "\t") if at < len(lines) and _is_titles(lines[at]) else []
    at += bool(titles)
    if at >= len(lines):
        raise InputError("The Qualisys file ends before its first frame", at_line(path, at), "export it again")
    rows = Rows(path, lines[at:], at + 1, "\t", "," if re.search(r"\d,\d", lines[at]) else ".")
    width = max(line.rstrip().count("\t") for line in rows.lines) + 1
    timed = [title for title in titles[:2] if title in _TIMED]
    leads = [len(timed)] if titles else range(len(_TIMED) + 1)
    spaced = next((lead for lead in leads if parts > 3 and _is_spaced(rows, lead, parts, count)), None)
    lead = spaced if spaced is not None else len(timed) if titles else max(0, width - parts * count)
    timed = timed or list(_TIMED[:lead])
    stride = parts + (spaced is not None)
    wide = len(timed) + stride * (count - 1) + parts
    if width > wide:
        what = f"There are {width} columns, but {len(timed)} and {parts} for each of {count} names are expected"
        raise InputError(what, rows.where(0), "export it again with X, Y, Z, or all columns of each body")
    values = numbers(rows, [*timed, *(f"column {i + 1}" for i in range(len(timed), wide))], LOST)
    starts = [len(timed) + stride * i for i in range(count)]
    return Table(rows, values, timed, starts, [title.split(" ")[-1] for title in titles[len(timed) :][:parts]])


def _is_titles(line: str) -> bool:
    """Whether a cell of the line is a word."""
    return any(re.match(r"[A-Za-z]", cell) and cell not in LOST for cell in split(line, "\t"))


def _is_spaced(rows: Rows, lead: int, parts: int, count: int) -> bool:
    """Whether after `lead` columns an empty one follows the `parts` of each body but the last, in all rows."""
    gaps = [lead + (parts + 1) * i + parts for i in range(count - 1)]
    wide = lead + (parts + 1) * (count - 1) + parts
    table = [line.split("\t") for line in rows.lines] if gaps else []
    return bool(table) and all(len(cells) >= wide and not any(cells[i].strip() for i in gaps) for cells in table)


def first_of(facts: dict[str, list[str]], key: str) -> str:
    """The first value of a key of the header; empty where it has none."""
    return (facts.get(key) or [""])[0]


def _rate(facts: dict[str, list[str]], places: dict[str, int], path: object, table: Table) -> float:
    stated, times = first_of(facts, "FREQUENCY"), table.column("Time")
    where = at_line(path, places.get("FREQUENCY", 1))
    if stated == "EXT" and times is not None and len(times) > 1 and times[-1] > times[0]:
        return (len(times) - 1) / float(times[-1] - times[0])
    rate = number(stated, "FREQUENCY", where, table.rows.decimal)
    if not rate > 0:
        raise InputError("FREQUENCY is not above 0", where, "write the frames per second after FREQUENCY")
    return rate


def _rotation(block: Float[np.ndarray, "n 16"], titles: list[str]) -> Float[np.ndarray, "n 4"]:
    """By the matrix; the angles, which may be defined otherwise in each project, only say how the matrix is written.

    Qualisys turns about X, Y, Z by roll, pitch, yaw, and in older versions about Z, Y, X by yaw, pitch, roll.
    """
    block = np.where(block[:, RESIDUAL : RESIDUAL + 1] < 0, np.nan, block)
    matrix = block[:, 7:].reshape(-1, 3, 3)
    by_columns, by_rows = from_matrix(matrix.transpose(0, 2, 1)), from_matrix(matrix)
    order = [title.lower() for title in titles]
    roll, pitch, yaw = (
        np.deg2rad(block[:, order.index(name) if name in order else usual]) for name, usual in ANGLES.items()
    )
    turns = [from_euler("XYZ", np.stack([roll, pitch, yaw], 1)), from_euler("ZYX", np.stack([yaw, pitch, roll], 1))]

    def agrees(rotation: np.ndarray) -> bool:
        return any(float(np.nanmean(1 - np.abs((rotation * turn).sum(axis=1)))) < AGREE for turn in turns)

    if not np.isfinite(by_columns).any():
        return by_columns
    return by_rows if agrees(by_rows) and not agrees(by_columns) else by_columns
