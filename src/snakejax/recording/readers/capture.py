"""What a motion-capture file holds, whatever its format: bodies, markers, and when they were seen."""

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line
from snakejax.core.text_files import read_text

from .angles import Reading
from .cells import is_blank

_T = TypeVar("_T")
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
ANGLE = {"rad": 1.0, "deg": math.pi / 180}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
LONGEST_SKIP = 100_000
MOST_COLUMNS, HEADER_LINES = 30_000, 40
"""Limits beyond which a file is damaged: frames that a number skips, columns of a table, and lines in which these are
counted."""


class Body(NamedTuple):
    """A rigid body over time.

    `times` [s] (n,) on the clock of its file, `position` [m] (n, 3), `rotation` (n, 4), the quaternion x, y, z, w that
    takes axes of the body to those of the file; NaN where a frame was lost. A body that the file has only in a plane
    has a `heading` [rad] (n,) too. `where` is the place in the file that complaints name.
    """

    times: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    where: str
    heading: Float[np.ndarray, " n"] | None = None


class Capture(NamedTuple):
    """The contents of one file: bodies and markers over time.

    `rate` [Hz]: frame rate of the file, None if it has only time stamps. `markers` (n, 3) [m] by name, at `times` [s]
    (n,); NaN where lost. `up`: the axis that points up, unless the user states another one; `up_said`: the reason;
    `up_known`: whether the file states the axis; `up_open`: whether neither the file nor its format does. `doubled`:
    names that occur more than once. `angles`: how the three angles of each body were read. `assumed`: sentences about
    what neither the file nor the user states.
    """

    format: str
    path: Path
    where: str
    rate: float | None
    units: str
    bodies: Mapping[str, Body]
    markers: Mapping[str, Float[np.ndarray, "n 3"]]
    times: Float[np.ndarray, " n"]
    up: str = "z"
    up_known: bool = False
    up_said: str = ""
    up_open: bool = False
    doubled: Sequence[str] = ()
    notes: Sequence[str] = ()
    angles: Mapping[str, Reading] = {}
    assumed: Sequence[str] = ()


X_AXIS_DIRECTIONS = {"forward": 0.0, "left": np.pi / 2, "back": np.pi, "right": -np.pi / 2}
"""Heading [rad] of an object's x axis from that of the board, by where on the board it points."""


class FileAnnotations(NamedTuple):
    """What the user states about a file in addition to its contents; None means the usual value of the format.

    `columns`: names of the columns of a plain table, by what they hold. `units`: by "length", "angle" and "time". `up`:
    the axis that points up, or its components. `markers`: places (x, y, z) [m] of markers by name, from the middle of
    the board, x forward and z up. `x_axis`: the direction on the board of the object's x axis, one of
    `X_AXIS_DIRECTIONS`. `angles`: the meaning of three angles, one of `ANGLES`.
    """

    columns: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None
    up: str | Sequence[float] | None = None
    markers: Mapping[str, Sequence[float]] | None = None
    x_axis: str = "forward"
    angles: str | None = None


class Source:
    """A file to read: its path, its first bytes, and its text where it is text."""

    def __init__(self, path: Path, hints: FileAnnotations) -> None:
        self.path, self.hints = path, hints

    @functools.cached_property
    def head(self) -> bytes:
        """The first bytes; none of a folder or of a file that cannot be opened."""
        try:
            with self.path.open("rb") as file:
                return file.read(1024)
        except OSError:
            return b""

    @functools.cached_property
    def text(self) -> str:
        """All of it as text. **Raises:** `InputError`."""
        return read_text(self.path)

    @functools.cached_property
    def lines(self) -> list[str]:
        """The lines of the text, without blank ones at the end. **Raises:** `InputError` for absurdly many columns."""
        lines = self.text.split("\n")
        while is_blank(lines[-1]):
            lines.pop()
        for i, line in enumerate(lines[:HEADER_LINES]):
            if (wide := max(line.count(mark) for mark in ",;\t")) > MOST_COLUMNS:
                what = f"The line has {wide + 1} cells, but a recording has at most {MOST_COLUMNS}"
                raise InputError(what, at_line(self.path, i + 1), "export only the objects that matter")
        return lines


def on_grid(frames: np.ndarray, values: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "m ..."]:
    """`values` at every frame from the first of `frames` to the last, NaN at those that are not there."""
    if frames.size == 0 or frames[-1] - frames[0] + 1 == frames.size:
        return values
    full = np.full((frames[-1] - frames[0] + 1, *values.shape[1:]), np.nan)
    full[frames - frames[0]] = values
    return full


def lost_together(values: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    """`values` with whole rows of NaN where one of them is NaN."""
    values = values.copy()
    values[np.isnan(values).any(axis=1)] = np.nan
    return values


def repeated(names: Sequence[_T]) -> tuple[_T, ...]:
    """The names that stand there already, in order, once for each time again."""
    earlier: set[_T] = set()
    return tuple(name for name in names if name in earlier or earlier.add(name))  # type: ignore[func-returns-value]
