"""Many cells at once: the numbers of a table's rows, with the line of the first one that is none."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line
from snakejax.core.text_files import LARGEST

from .capture import LONGEST_SKIP
from .cells import number, split

AT_ONCE = 4_000_000
"""Characters that are parsed at once, to limit the memory."""
_NUMERIC = b"0123456789+-.eE,"


class Rows(NamedTuple):
    """Lines of a table; the first of them is line `first` of `path`, counted from 1."""

    path: Path
    lines: Sequence[str]
    first: int
    separator: str
    decimal: str

    def where(self, row: int) -> str:
        """The file and line of a row."""
        return at_line(self.path, self.first + row)

    def parts(self, width: int) -> Iterator[tuple[int, "Rows"]]:
        """The rows a part at a time, and the first row of each, so that what is made of the text stays small."""
        step = max(1, AT_ONCE // max(1, 10 * width))
        for start in range(0, len(self.lines), step):
            yield start, self._replace(lines=self.lines[start : start + step], first=self.first + start)

    def cells(self, row: int) -> list[str]:
        """The stripped cells of a row."""
        return split(self.lines[row], self.separator)


def numbers(rows: Rows, names: Sequence[str], blank: Sequence[str] = ()) -> Float[np.ndarray, "n c"]:
    """The numbers of all rows in the columns `names`, NaN where a cell is blank, or one of the words `blank`.

    Each row has a cell for each of the columns; what may follow them is blank.

    **Raises:** `InputError` for a row too short or too long, and for a cell that is no finite number, with its line.
    """
    table = np.empty((len(rows.lines), len(names)))
    for start, part in rows.parts(len(names)):
        values = all_at_once(part, len(names))
        table[start : start + len(part.lines)] = _one_by_one(part, names, blank) if values is None else values
    return table


def columns_at_once(rows: Rows, width: int, indices: Sequence[int]) -> Float[np.ndarray, "n c"] | None:
    """The columns numbered `indices` of `width`, where all cells of the table are numbers or blank; else None."""
    complete = []
    for _, part in rows.parts(width):
        values = all_at_once(part, width)
        if values is None:
            return None
        complete.append(values[:, indices])
    return np.concatenate(complete)


def all_at_once(rows: Rows, width: int) -> Float[np.ndarray, "n c"] | None:
    """The numbers, where the cells are numbers or blank and nothing else, and as many in each row; else None."""
    wide = rows.lines[0].count(rows.separator) + 1
    if wide < width or wide > 2 * width + 8 or any(line.count(rows.separator) + 1 != wide for line in rows.lines):
        return None
    text = rows.separator.join(rows.lines)
    if '"' in text:
        text = text.replace('"', "")
    if rows.decimal == ",":
        text = text.replace(",", ".")
    if rows.separator != ",":
        text = text.replace(rows.separator, ",")
    if " " in text:
        text = text.replace(", ", ",").replace(" ,", ",")
    if not text.isascii() or (raw := text.encode()).translate(None, _NUMERIC):
        return None
    if b",," in raw or raw[:1] == b"," or raw[-1:] in (b",", b""):
        raw = (b"," + raw + b",").replace(b",,", b",nan,").replace(b",,", b",nan,")[1:-1]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            values = np.fromstring(raw, sep=",")
    except (ValueError, DeprecationWarning):
        return None
    if values.size != len(rows.lines) * wide or (np.abs(values) > LARGEST).any():
        return None
    values = values.reshape(-1, wide)
    return values[:, :width] if np.isnan(values[:, width:]).all() else None


def _one_by_one(rows: Rows, names: Sequence[str], blank: Sequence[str]) -> Float[np.ndarray, "n c"]:
    table = np.empty((len(rows.lines), len(names)))
    for row in range(len(rows.lines)):
        cells, where = rows.cells(row), rows.where(row)
        if len(cells) < len(names) or any(cells[len(names) :]):
            what = f"The row has {len(cells)} cells, but there are {len(names)} columns"
            raise InputError(what, where, "export the file again, or complete the row")
        table[row] = [
            np.nan if cell in blank else number(cell, name, where, rows.decimal)
            for cell, name in zip(cells, names, strict=False)
        ]
    return table


def whole_frames(values: Float[np.ndarray, " n"], rows: Rows) -> np.ndarray:
    """Frame numbers as integers.

    **Raises:** `InputError` with its line where one is blank, not whole, not above the one before, or skips too many.
    """
    with np.errstate(invalid="ignore"):
        wrong = ~((values == np.round(values)) & (np.abs(values) < 2**53))
        step = np.diff(values)
        bad = wrong | np.concatenate([[False], (step <= 0) | (step > LONGEST_SKIP)])
    if not bad.any():
        return values.astype(np.int64)
    row = int(bad.argmax())
    cell, where = rows.cells(row)[0], rows.where(row)
    if wrong[row]:
        raise InputError(f'The frame number "{cell}" is not whole', where, "number the frames 1, 2, 3, ...")
    before, frame = int(values[row - 1]), int(values[row])
    if frame > before:
        what = f"The frame number jumps from {before} to {frame}, more than {LONGEST_SKIP} frames"
        raise InputError(what, where, "correct the number, or make two files of the two recordings")
    wrong_order = "comes twice" if frame == before else f"comes after frame {before}: time runs backwards"
    raise InputError(f"Frame {frame} {wrong_order}", where, "sort the rows by frame and keep one row for each")


def ticks(
    frames: Float[np.ndarray, " n"] | None, times: Float[np.ndarray, " n"] | None, rate: float, rows: Rows
) -> np.ndarray:
    """The frame of each row, counted in steps of 1/`rate`, by its number or, where that counts otherwise, its time.

    **Raises:** `InputError` with its line where the two contradict each other, or a frame is not above the one before.
    """
    if frames is None:
        frames = np.arange(len(rows.lines), dtype=float) if times is None else np.round((times - times[0]) * rate)
    counted = whole_frames(frames, rows)
    if times is None:
        return counted
    if (blank := np.flatnonzero(np.isnan(times))).size:
        raise InputError("The time is blank", rows.where(int(blank[0])), "export the file again")
    span = (times[-1] - times[0]) * rate
    if abs(span - (counted[-1] - counted[0])) <= max(1.0, 1e-3 * span):
        return counted
    by_time = (times - times[0]) * rate
    if np.abs(by_time - np.round(by_time)).max() < 0.3:
        return whole_frames(np.round(by_time), rows)
    what = f"By its times the file has {(len(times) - 1) / (times[-1] - times[0]):.6g} frames per second, not {rate:g}"
    raise InputError(what, rows.where(0), "correct the frame rate in its header, or its times")
