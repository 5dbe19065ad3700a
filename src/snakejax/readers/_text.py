"""What all text readers share: decoding, separators, cells, and the track they return."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line

FEWEST_SAMPLES = 10


class Track(NamedTuple):
    """The planar motion of one object: frame `rate` [Hz], `times` [s] (n,) at every frame from 0 at the first row, and
    `pose` (n, 3) of x [m], y [m] and the unwrapped heading [rad], NaN where the frame was lost.
    """

    rate: float
    times: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, a byte-order mark dropped and line ends made plain.

    **Raises:** `InputError` for a file that cannot be opened, is not UTF-8, or is empty.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"Cannot read the file ({error.strerror})", str(path), "check its name and rights") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise InputError("The file is not UTF-8", at_line(path, line), "save it again as UTF-8 text") from None
    if not text.strip():
        raise InputError("The file is empty", at_line(path, 1), "export it again, or remove it from the case")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def rows_of(text: str) -> tuple[list[list[str]], str]:
    """The stripped cells of each line of a table, and its decimal mark: in a table divided by `;` that is `,` too."""
    separator = ";" if text.count(";") > text.count(",") // 2 else ","
    rows = [[cell.strip(' \t"') for cell in line.split(separator)] for line in text.split("\n")]
    return rows, "," if separator == ";" else "."


def number(cell: str, name: str, where: str, decimal: str = ".") -> float:
    """The finite number in a cell, or NaN for a blank one.

    **Raises:** `InputError` for anything else, "nan" and "inf" among it.
    """
    if not cell:
        return math.nan
    try:
        value = float(cell.replace(decimal, ".").replace("_", "?"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        remedy = "write a finite number, or leave the cells of a lost frame blank"
        raise InputError(f'"{cell}" for {name} is not a finite number', where, remedy)
    return value


def unwrapped(heading: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """`heading` [rad] without jumps of 2 pi from one present (not NaN) sample to the next."""
    heading = heading.copy()
    present = np.isfinite(heading)
    heading[present] = np.unwrap(heading[present])
    return heading
