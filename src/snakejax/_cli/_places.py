"""Where the markers sit on the board: by a template, or by which of them are at its ends, asked for on a terminal."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .._errors import InputError, at_line
from ._options import names

if TYPE_CHECKING:
    from ..readers import Capture, Hints


def ask(options: argparse.Namespace, question: str) -> str:
    """An answer from the terminal; empty where there is none, or nobody is there to be asked."""
    if options.quiet or not (sys.stdin.isatty() and sys.stdout.isatty()):
        return ""
    try:
        return input(f"{question}: ").strip()
    except EOFError:
        return ""


def places(
    options: argparse.Namespace, capture: "Capture", hints: "Hints", wanted: str
) -> dict[str, Sequence[float]] | None:
    """Where the markers of `wanted` sit on the board, by --template or --front and --back; None where nobody says."""
    from .._import import places_of
    from ..readers._track import subjects

    if options.template:
        return _template(Path(options.template))
    of = subjects(capture)[wanted]
    prefix = f"{wanted}:" if wanted else ""
    front, back = (names(getattr(options, end)) for end in ("front", "back"))
    if front is None or back is None:
        short = ", ".join(name.removeprefix(prefix) for name in of[:24])
        front = names(ask(options, f"Which markers are at the front of the board? {short}")) or None
        back = names(ask(options, "and at the back")) if front else None
    if not front or not back:
        return None
    chosen = names(options.markers)
    full = [[name if name in of else prefix + name for name in some] for some in (chosen or of, front, back)]
    for name in full[0]:
        if name not in capture.markers:
            raise InputError(f'There is no marker "{name}"', "option --markers", f"the markers are {', '.join(of)}")
    return {**places_of(capture, *full, up=hints.up or capture.up)}


def _template(path: Path) -> dict[str, Sequence[float]]:
    from ..readers._text import number, read_text, separator_of, split

    text = read_text(path)
    separator, decimal = separator_of(text)
    header, *rows = [split(line, separator) for line in text.split("\n")]
    if header != ["marker", "x_m", "y_m", "z_m"]:
        raise InputError("The template does not begin with its columns", at_line(path, 1), "write marker,x_m,y_m,z_m")
    found: dict[str, Sequence[float]] = {}
    for line, row in enumerate(rows, 2):
        if not any(row):
            continue
        if len(row) != 4 or not all(row):
            raise InputError(f"The row has {len(row)} cells", at_line(path, line), "write marker,x_m,y_m,z_m")
        found[row[0]] = [number(cell, "a place", at_line(path, line), decimal) for cell in row[1:]]
    return found
