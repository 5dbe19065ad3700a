"""Qualisys TSV: markers (3D) and rigid bodies (6DOF), in mm and degrees, with tabs.

    NO_OF_FRAMES   500                     one fact a line
    FREQUENCY      100
    MARKER_NAMES   front  back             or BODY_NAMES  board  rotor
    Frame  Time  front X  front Y ...      may be left out; of bodies X Y Z Roll Pitch Yaw Residual Rot[0] ... Rot[8]
    1  0.00  12.1  ...                     lost: all zero, blank, or a negative residual

The matrix Rot is written by columns; where its transpose agrees with the angles instead, it is read by rows.
"""

import re

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line
from ._capture import LENGTH, Body, Capture, Source, lost_together, on_grid, repeated
from ._cells import Rows, numbers, ticks
from ._text import is_blank, number, shown, split
from ._turn import from_euler, from_matrix, require_unit

ANGLES = 6
LOST = ("NULL", "nan", "NaN", "-")
BODY_COLUMNS = ("X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9)))
_FACT = re.compile(r"[A-Z0-9_]{4,}$")


def recognises(source: Source) -> bool:
    """Whether the text begins as a Qualisys export with its header does."""
    return re.match(r"(FILE_VERSION|NO_OF_FRAMES)\t", source.text) is not None


def read(source: Source) -> Capture:
    """All markers or all bodies. **Raises:** `InputError` with file, line and remedy."""
    path, lines = source.path, source.lines
    facts: dict[str, list[str]] = {}
    places: dict[str, int] = {}
    at = 0
    while at < len(lines) and (is_blank(lines[at]) or _FACT.match(lines[at].split("\t", 1)[0].strip())):
        key, *values = split(lines[at], "\t")
        at += 1
        facts[key], places[key] = [value for value in values if value], at
    key = next((key for key in ("BODY_NAMES", "MARKER_NAMES") if facts.get(key)), None)
    if key is None:
        remedy = "export 3D or 6DOF data with the TSV header"
        raise InputError("The Qualisys file names neither markers nor bodies", at_line(path, at), remedy)
    titled = at < len(lines) and not re.match(r"[\s\d.,+-]", lines[at] or " ")
    titles = split(lines[at], "\t") if titled else []
    at += titled
    if at >= len(lines):
        raise InputError("The Qualisys file ends before its first frame", at_line(path, at), "export it again")
    decimal = "," if re.search(r"\d,\d", lines[at]) else "."
    rows = Rows(path, lines[at:], at + 1, "\t", decimal)
    width = max((i for i, cell in enumerate(rows.cells(0)) if cell), default=-1) + 1
    timed = [title for title in titles[:2] if title in ("Frame", "Time")]
    names = facts[key]
    parts = 3 if key == "MARKER_NAMES" else len(BODY_COLUMNS)
    if not titled:
        timed = ["Frame", "Time"][: width - parts * len(names)] if width > parts * len(names) else []
    wide = len(timed) + parts * len(names)
    width = max(width, wide)
    if width != wide:
        what = f"There are {width} columns, but {len(timed)} and {parts} for each of {len(names)} names are expected"
        raise InputError(what, rows.where(0), "export it again with X, Y, Z, or all columns of each body")
    values = numbers(rows, [*timed, *(f"column {i + 1}" for i in range(len(timed), width))], LOST)
    rate = _rate(facts, places, path, decimal, values[:, timed.index("Time")] if "Time" in timed else None)
    numbered, clock = (values[:, timed.index(name)] if name in timed else None for name in ("Frame", "Time"))
    frames = ticks(numbered, clock, rate, rows)
    times = np.arange(frames[-1] - frames[0] + 1) / rate
    bodies: dict[str, Body] = {}
    markers: dict[str, np.ndarray] = {}
    for i, name in enumerate(names):
        if name in markers or name in bodies:
            continue
        block = lost_together(values[:, len(timed) + parts * i :][:, :parts])
        zero = (block[:, :3] == 0).all(axis=1)
        block[zero] = np.nan
        if key == "MARKER_NAMES":
            markers[name] = on_grid(frames, block * LENGTH["mm"])
        else:
            block[block[:, ANGLES] < 0] = np.nan
            rotation = _rotation(block)
            block[np.isnan(rotation).any(axis=1)] = np.nan
            require_unit(rotation, name, rows.where(0))
            where = rows.where(0)
            bodies[name] = Body(times, on_grid(frames, block[:, :3] * LENGTH["mm"]), on_grid(frames, rotation), where)
    doubled = repeated(names)
    notes = []
    if (said := facts.get("NO_OF_FRAMES", [""])[0]) and said != str(len(values)):
        notes.append(f"its header says {shown(said)} frames, but {len(values)} are there")
    where = at_line(path, places[key])
    return Capture("Qualisys TSV", path, where, rate, "mm", bodies, markers, times, doubled=doubled, notes=notes)


def _rate(
    facts: dict[str, list[str]], places: dict[str, int], path: object, decimal: str, times: np.ndarray | None
) -> float:
    said = facts.get("FREQUENCY", [""])[0]
    where = at_line(path, places.get("FREQUENCY", 1))
    if said == "EXT" and times is not None and len(times) > 1 and times[-1] > times[0]:
        return (len(times) - 1) / float(times[-1] - times[0])
    rate = number(said, "FREQUENCY", where, decimal)
    if not rate > 0:
        raise InputError("FREQUENCY is not above 0", where, "write the frames per second after FREQUENCY")
    return rate


def _rotation(block: Float[np.ndarray, "n 16"]) -> Float[np.ndarray, "n 4"]:
    """By the matrix; the angles, which may be defined otherwise in each project, only say how the matrix is written."""
    matrix = block[:, 7:].reshape(-1, 3, 3)
    by_columns, by_rows = from_matrix(matrix.transpose(0, 2, 1)), from_matrix(matrix)
    angles = from_euler("XYZ", np.deg2rad(block[:, 3:ANGLES]))

    def unlike(rotation: np.ndarray) -> float:
        return float(np.nanmean(1 - np.abs((rotation * angles).sum(axis=1)))) if np.isfinite(rotation).any() else 0.0

    return by_rows if unlike(by_rows) + 1e-6 < unlike(by_columns) else by_columns
