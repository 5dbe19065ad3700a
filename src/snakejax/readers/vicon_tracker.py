"""Vicon Tracker CSV: the `Objects` or `Segments` section, with Euler angles or quaternions.

    Objects
    100                                          frames per second
    ,,Global Angle board:board,,,,,              one block of columns for each object
    Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ            or RX,RY,RZ,RW,TX,TY,TZ: a quaternion x, y, z, w
    ,,rad,rad,rad,mm,mm,mm                       units
    1,0,0.001,-0.002,-2.078,319.6,379.4,62.3     blank cells: a lost frame

The world's z axis points up and the board hardly tilts, so the rotation about z is the heading.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line, instead_of
from ._text import FEWEST_SAMPLES, Track, number, read_text, rows_of, unwrapped

SECTIONS = ("Objects", "Segments")
EULER = ("RX", "RY", "RZ", "TX", "TY", "TZ")
QUATERNION = ("RX", "RY", "RZ", "RW", "TX", "TY", "TZ")
ANGLE = {"rad": 1.0, "deg": math.pi / 180}
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
HEADER_ROWS = 5
LONGEST_SKIP = 100_000


class Section(NamedTuple):
    """A section of the file: its rows, of which the first, its name, stands in `line` of `path`."""

    path: Path
    line: int
    rows: list[list[str]]
    decimal: str

    def where(self, row: int) -> str:
        return at_line(self.path, self.line + row)


class Block(NamedTuple):
    """The columns of one object, by name, and the factor to SI of each."""

    object: str
    columns: dict[str, int]
    factors: dict[str, float]


def recognises(text: str) -> bool:
    """Whether `text` has a section of a Tracker CSV."""
    return any(line.strip(' \t,;"') in SECTIONS for line in text.split("\n"))


def read(path: Path | str, object: str) -> Track:
    """The motion of `object`, named `subject:segment`, in the Tracker CSV at `path`.

    Frames that are skipped in the file or left blank are NaN; time counts from the first row.

    **Raises:** `InputError` with file, line and remedy.
    """
    return parse(read_text(Path(path)), Path(path), object)


def parse(text: str, path: Path, object: str) -> Track:
    """As `read`, from the text of the file."""
    section, start = _find(_sections(text, path), object)
    block = _block(section, object, start)
    rate = _rate(section)
    frames = _frames(section)
    values = _values(section, block)
    present = int(np.isfinite(values).all(axis=1).sum())
    if present < FEWEST_SAMPLES:
        raise InputError(
            f'Only {present} samples of "{object}" are present, but at least {FEWEST_SAMPLES} are needed',
            section.where(HEADER_ROWS),
            "check that the object was tracked, or leave this run out",
        )
    pose = np.full((frames[-1] - frames[0] + 1, 3), np.nan)
    pose[frames - frames[0]] = _planar(values, section, block)
    pose[:, 2] = unwrapped(pose[:, 2])
    return Track(rate, np.arange(len(pose)) / rate, pose)


def _sections(text: str, path: Path) -> list[Section]:
    rows, decimal = rows_of(text)
    found: list[Section] = []
    i = 0
    while i < len(rows):
        end = next((j for j in range(i, len(rows)) if not any(rows[j])), len(rows))
        if rows[i:end] and rows[i][0] in SECTIONS:
            found.append(Section(path, i + 1, rows[i:end], decimal))
        elif found and rows[i:end] and rows[i][0].isdecimal():
            raise InputError("A blank line divides the data", at_line(path, i), "remove the line, or export again")
        i = end + 1
    for section in found:
        if len(section.rows) <= HEADER_ROWS:
            what = f"The section {section.rows[0][0]} ends before its first frame"
            raise InputError(what, section.where(len(section.rows) - 1), "export the file again with all its frames")
    return found


def _objects(section: Section) -> list[tuple[str, int]]:
    named = [(cell.removeprefix("Global Angle").strip(), i) for i, cell in enumerate(section.rows[2])]
    return [(name, i) for name, i in named if name]


def _find(sections: list[Section], object: str) -> tuple[Section, int]:
    places = [(section, i) for section in sections for name, i in _objects(section) if name == object]
    if len(places) == 1:
        return places[0]
    where = (places or [(sections[0], 0)])[0][0].where(2)
    if places:
        raise InputError(f'The object "{object}" is there {len(places)} times', where, "rename or remove all but one")
    there = [name for section in sections for name, _ in _objects(section)]
    raise InputError(f'There is no object "{object}" in the file', where, instead_of(object, there))


def _block(section: Section, object: str, start: int) -> Block:
    _, _, names, header, units = section.rows[:HEADER_ROWS]
    if header[:2] != ["Frame", "Sub Frame"]:
        missing = "Frame" if header[0] != "Frame" else "Sub Frame"
        raise InputError(f"Missing column {missing}", section.where(3), "begin the row with Frame,Sub Frame")
    stop = next((i for i in range(start + 1, len(names)) if names[i]), len(header))
    titles = header[start:stop]
    wanted = QUATERNION if "RW" in titles else EULER
    remedy = f"export {','.join(EULER)} or {','.join(QUATERNION)} for each object"
    for name in wanted:
        if name not in titles:
            raise InputError(f'Missing column {name} of "{object}"', section.where(3), remedy)
    for i, name in enumerate(titles):
        if name and (name not in wanted or name in titles[:i]):
            raise InputError(f'Extra column {name} of "{object}"', section.where(3), remedy)
    columns = {name: start + titles.index(name) for name in wanted}
    # A quaternion has no unit, whatever its unit cells say.
    measured = [name for name in wanted if name[0] == "T" or wanted is EULER]
    return Block(object, columns, {name: _factor(section, units, columns[name], name) for name in measured})


def _factor(section: Section, units: list[str], column: int, name: str) -> float:
    known = LENGTH if name[0] == "T" else ANGLE
    unit = units[column] if column < len(units) else ""
    if unit not in known:
        remedy = f"write {' or '.join(known)} in the units row, as the data are"
        raise InputError(f'Unknown unit "{unit}" of column {name}', section.where(4), remedy)
    return known[unit]


def _rate(section: Section) -> float:
    rate = number(section.rows[1][0], "the frame rate", section.where(1), section.decimal)
    if not rate > 0:
        raise InputError("The frame rate is not above 0", section.where(1), "write the frames per second, such as 100")
    return rate


def _frames(section: Section) -> np.ndarray:
    frames: list[int] = []
    for row in range(HEADER_ROWS, len(section.rows)):
        cell, where = section.rows[row][0], section.where(row)
        value = number(cell, "the frame", where, section.decimal)
        if not value.is_integer():
            raise InputError(f'The frame number "{cell}" is not whole', where, "number the frames 1, 2, 3, ...")
        frame = int(value)
        if frames and frame <= frames[-1]:
            wrong = "comes twice" if frame == frames[-1] else f"comes after frame {frames[-1]}: time runs backwards"
            raise InputError(f"Frame {frame} {wrong}", where, "sort the rows by frame and keep one row for each")
        if frames and frame - frames[-1] > LONGEST_SKIP:
            what = f"The frame number jumps from {frames[-1]} to {frame}, more than {LONGEST_SKIP} frames"
            raise InputError(what, where, "correct the number, or make two files of the two recordings")
        frames.append(frame)
    return np.array(frames)


def _values(section: Section, block: Block) -> Float[np.ndarray, "n c"]:
    """The cells of a block as they are in the file, NaN in the whole row where one is blank."""
    width = max(i for i, name in enumerate(section.rows[3]) if name) + 1
    table = []
    for row in range(HEADER_ROWS, len(section.rows)):
        cells, where = section.rows[row], section.where(row)
        if len(cells) < width or any(cells[width:]):
            what = f"The row has {len(cells)} cells, but there are {width} columns"
            raise InputError(what, where, "export the file again, or complete the row")
        table.append([number(cells[i], name, where, section.decimal) for name, i in block.columns.items()])
    values = np.array(table)
    values[np.isnan(values).any(axis=1)] = np.nan
    return values


def _planar(values: Float[np.ndarray, "n c"], section: Section, block: Block) -> Float[np.ndarray, "n 3"]:
    cells = dict(zip(block.columns, values.T, strict=True))
    position = [cells[name] * block.factors[name] for name in ("TX", "TY")]
    if "RW" not in cells:
        return np.stack([*position, cells["RZ"] * block.factors["RZ"]], axis=1)
    x, y, z, w = (cells[name] for name in ("RX", "RY", "RZ", "RW"))
    wrong = np.flatnonzero(np.abs(np.sqrt(x**2 + y**2 + z**2 + w**2) - 1) > 0.01)
    if wrong.size:
        what = f'The quaternion of "{block.object}" is not of length 1'
        raise InputError(what, section.where(HEADER_ROWS + wrong[0]), "check the order RX,RY,RZ,RW of its columns")
    return np.stack([*position, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))], axis=1)
