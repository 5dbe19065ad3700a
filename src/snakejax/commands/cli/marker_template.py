"""The positions of the markers on the board, from a template or from the markers at its ends."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from snakejax.core.errors import InputError, at_line

from .options import names

if TYPE_CHECKING:
    from snakejax.recording.readers import Capture, FileAnnotations


def ask(options: argparse.Namespace, question: str) -> str:
    """The answer to `question` from the terminal; empty without a terminal or an answer."""
    if options.quiet or not (sys.stdin.isatty() and sys.stdout.isatty()):
        return ""
    try:
        return input(f"{question}: ").strip()
    except EOFError:
        return ""


def places(
    options: argparse.Namespace, capture: "Capture", hints: "FileAnnotations", object_name: str
) -> dict[str, Sequence[float]] | None:
    """The positions [m] of the markers of `name` on the board; None without --template, --front and --back."""
    from snakejax.recording.case_import import places_of
    from snakejax.recording.readers.planar_pose import subjects, up_by

    if options.template:
        return _template(Path(options.template))
    object_markers = subjects(capture)[object_name]
    prefix = f"{object_name}:" if object_name else ""
    front, back = (names(getattr(options, end)) for end in ("front", "back"))
    if front is None or back is None:
        short = ", ".join(name.removeprefix(prefix) for name in object_markers[:24])
        front = names(ask(options, f"Which markers are at the front of the board? {short}")) or None
        back = names(ask(options, "Which markers are at its back")) if front else None
    if not front or not back:
        return None
    chosen = names(options.markers)
    full = [
        [name if name in object_markers else prefix + name for name in some]
        for some in (chosen or object_markers, front, back)
    ]
    for name in full[0]:
        if name not in capture.markers:
            raise InputError(
                f'There is no marker "{name}"', "option --markers", f"the markers are {', '.join(object_markers)}"
            )
    return {**places_of(capture, *full, up=up_by(capture, hints))}


def _template(path: Path) -> dict[str, Sequence[float]]:
    from snakejax.core.text_files import read_text
    from snakejax.recording.readers.cells import number, separator_of, split

    text = read_text(path)
    separator, decimal = separator_of(text)
    header, *rows = [split(line, separator) for line in text.split("\n")]
    if header != ["marker", "x_m", "y_m", "z_m"]:
        raise InputError(
            "The first line of the template is not its header", at_line(path, 1), "write marker,x_m,y_m,z_m"
        )
    positions: dict[str, Sequence[float]] = {}
    for line, row in enumerate(rows, 2):
        if not any(row):
            continue
        if len(row) != 4 or not all(row):
            raise InputError(f"The row has {len(row)} cells", at_line(path, line), "write marker,x_m,y_m,z_m")
        positions[row[0]] = [number(cell, "a place", at_line(path, line), decimal) for cell in row[1:]]
    return positions
