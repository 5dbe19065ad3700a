"""Vicon CSV: `Objects` and `Segments` of Tracker, with three angles or quaternions, and `Trajectories` of Nexus.

    Objects                                      or Segments            Trajectories
    100                                          frames per second      100
    ,,Global Angle board:board,,,,,              one block each         ,,board:front,,,board:back,,
    Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ            or RX,RY,RZ,RW,...     Frame,Sub Frame,X,Y,Z,X,Y,Z
    ,,rad,rad,rad,mm,mm,mm                       units                  ,,mm,mm,mm,mm,mm,mm
    1,0,0.001,-0.002,-2.078,319.6,379.4,62.3     blank cells: lost      1,0,44.2,-276.9,675.7,,,

A file may hold several such sections, and others, which are passed over, divided by blank lines. RX, RY, RZ are a
rotation vector ("helical"), Tracker's default, or Euler angles: `_angles` tells them apart by the data.
"""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line

from .angles import Reading, reading_of, rotation_by
from .capture import ANGLE, LENGTH, Body, Capture, Source, lost_together, on_grid
from .cells import is_blank, number, separator_of, shown, split
from .numeric_table import Rows, numbers, whole_frames
from .rotations import first_unlike_one

BODIES = ("Objects", "Segments")
MARKERS = "Trajectories"
ANGLED = ("RX", "RY", "RZ", "TX", "TY", "TZ")
QUATERNION = ("RX", "RY", "RZ", "RW", "TX", "TY", "TZ")
POSITION = ("X", "Y", "Z")
HEADER_ROWS = 5
"""Rows of a section before its data: name, rate, objects, titles and units."""
_SECTION = re.compile(rf'^[ \t,;"]*({"|".join((*BODIES, MARKERS))})[ \t,;"]*$', re.MULTILINE)


class Section(NamedTuple):
    """A section of the file: its name, the cells of its header's rows, and the rows of its data."""

    name: str
    header: list[list[str]]
    rows: Rows

    def where(self, row: int) -> str:
        """The file and line of a row, counted from the section's name."""
        return self.rows.where(row - HEADER_ROWS)


class Block(NamedTuple):
    """The columns of one object: its name, where they begin, and their titles."""

    name: str
    start: int
    titles: list[str]


def recognises(source: Source) -> bool:
    """Whether the text has a section of a Vicon CSV."""
    return _SECTION.search(source.text) is not None


def read(source: Source) -> Capture:
    """All bodies and markers. Frames that are skipped in the file or left blank are NaN.

    **Raises:** `InputError` with file, line and remedy.
    """
    bodies: dict[str, Body] = {}
    markers: dict[str, np.ndarray] = {}
    doubled: list[str] = []
    angles: dict[str, Reading] = {}
    rates, units, times = [], [], np.zeros(0)
    sections = _sections(source)
    for section in sections:
        rates.append(_rate(section))
        blocks = _blocks(section)
        frames, values = _values(section)
        ticks = np.arange(frames[-1] - frames[0] + 1) / rates[-1]
        for block in blocks:
            into = markers if section.name == MARKERS else bodies
            if block.name in into:
                doubled.append(block.name)
                continue
            if section.name == MARKERS:
                factors = _factors(section, block, POSITION)
                markers[block.name] = on_grid(frames, _taken(values, block, POSITION) * factors)
                times = ticks
            else:
                bodies[block.name], reading = _body(section, block, frames, values, ticks, source.hints.angles)
                angles |= {block.name: reading} if reading else {}
        units += [section.header[4][b.start + b.titles.index(t)] for b in blocks for t in ("TX", "X") if t in b.titles]
    name = "Vicon Nexus CSV" if markers else "Vicon Tracker CSV"
    return Capture(
        name,
        source.path,
        sections[0].where(2),
        rates[0],
        ", ".join(sorted(set(units))),
        bodies,
        markers,
        times,
        doubled=tuple(doubled),
        angles=angles,
    )


def _sections(source: Source) -> list[Section]:
    lines = source.lines
    separator, decimal = separator_of(source.text)
    blank = [i for i, line in enumerate(lines) if is_blank(line)]
    sections: list[Section] = []
    for start, stop in zip([-1, *blank], [*blank, len(lines)], strict=True):
        start += 1
        if start >= stop:
            continue
        name = lines[start].strip(' \t,;"')
        if name in (*BODIES, MARKERS):
            if stop - start <= HEADER_ROWS:
                what = f"The section {name} ends before its first frame"
                remedy = "export the file again with all its frames"
                raise InputError(what, at_line(source.path, stop), remedy)
            header = [split(line, separator) for line in lines[start : start + HEADER_ROWS]]
            data = lines[start + HEADER_ROWS : stop]
            sections.append(Section(name, header, Rows(source.path, data, start + HEADER_ROWS + 1, separator, decimal)))
        elif sections and split(lines[start], separator)[0].isdecimal():
            remedy = "remove the line, or export again"
            raise InputError("A blank line divides the data", at_line(source.path, start), remedy)
    return sections


def _rate(section: Section) -> float:
    rate = number(section.header[1][0], "the frame rate", section.where(1), section.rows.decimal)
    if not rate > 0:
        raise InputError("The frame rate is not above 0", section.where(1), "write the frames per second, such as 100")
    return rate


def _blocks(section: Section) -> list[Block]:
    _, _, names, header, _ = section.header
    if header[:2] != ["Frame", "Sub Frame"]:
        missing = "Frame" if header[0] != "Frame" else "Sub Frame"
        raise InputError(f"Missing column {missing}", section.where(3), "begin the row with Frame,Sub Frame")
    starts = [i for i, name in enumerate(names) if name and i > 1]
    stops = [*starts[1:], len(header)]
    named = [names[i].removeprefix("Global Angle").strip() for i in starts]
    blocks = [Block(name, a, header[a:b]) for name, a, b in zip(named, starts, stops, strict=True)]
    if section.name == MARKERS:
        # Speeds and accelerations, and what Nexus computes from the markers, stand among them with other titles.
        return [block for block in blocks if set(POSITION) <= set(block.titles)]
    for block in blocks:
        wanted = _wanted(block)
        remedy = f"export {','.join(ANGLED)} or {','.join(QUATERNION)} for each object"
        for title in wanted:
            if title not in block.titles:
                raise InputError(f'Missing column {title} of "{shown(block.name)}"', section.where(3), remedy)
        for i, title in enumerate(block.titles):
            if title and (title not in wanted or title in block.titles[:i]):
                what = f'Extra column {shown(title)} of "{shown(block.name)}"'
                raise InputError(what, section.where(3), remedy)
    return blocks


def _wanted(block: Block) -> tuple[str, ...]:
    return QUATERNION if "RW" in block.titles else ANGLED


def _factors(section: Section, block: Block, titles: tuple[str, ...]) -> Float[np.ndarray, " c"]:
    """What makes SI of the columns `titles`. A quaternion has no unit, whatever its unit cells say."""
    units, factors = section.header[4], []
    for title in titles:
        if title[0] == "R" and "RW" in titles:
            factors.append(1.0)
            continue
        known = ANGLE if title[0] == "R" else LENGTH
        column = block.start + block.titles.index(title)
        unit = units[column] if column < len(units) else ""
        if unit not in known:
            remedy = f"write {' or '.join(known)} in the units row, as the data are"
            raise InputError(f'Unknown unit "{shown(unit)}" of column {title}', section.where(4), remedy)
        factors.append(known[unit])
    return np.array(factors)


def _values(section: Section) -> tuple[np.ndarray, Float[np.ndarray, "n c"]]:
    """The frame numbers, and all cells as they are in the file."""
    header = section.header[3]
    width = max(i for i, name in enumerate(header) if name) + 1
    values = numbers(section.rows, header[:width])
    return whole_frames(values[:, 0], section.rows), values


def _taken(values: Float[np.ndarray, "n c"], block: Block, titles: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    return lost_together(values[:, [block.start + block.titles.index(title) for title in titles]])


def _body(
    section: Section, block: Block, frames: np.ndarray, values: np.ndarray, times: np.ndarray, angles: str | None
) -> tuple[Body, Reading | None]:
    wanted = _wanted(block)
    cells = _taken(values, block, wanted) * _factors(section, block, wanted)
    if wanted is QUATERNION:
        rotation, reading = cells[:, :4], None
    else:
        reading = Reading.given(angles) if angles else reading_of(cells[:, :3])
        rotation = rotation_by(reading.angles, cells[:, :3])
    if (row := first_unlike_one(rotation)) is not None:
        what = f'The quaternion of "{shown(block.name)}" is not of length 1'
        raise InputError(what, section.rows.where(row), "check the order RX,RY,RZ,RW of its columns")
    where = section.where(HEADER_ROWS)
    return Body(times, on_grid(frames, cells[:, -3:]), on_grid(frames, rotation), where), reading
