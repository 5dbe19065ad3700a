"""Figures as files."""

import io
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from snakejax.core.files import write_whole

DPI = 150
"""Resolution of the PNG files [dots per inch]."""


def save(figure: Figure, folder: Path | str, name: str) -> list[Path]:
    """Write `figure` to NAME.png and NAME.svg in `folder`, which is created if necessary; return their paths.

    **Raises:** `InputError` where they cannot be written.
    """
    written = []
    # No date and no random names: the same figure is the same file.
    with matplotlib.rc_context({"svg.hashsalt": "snakejax"}):
        for kind in ("png", "svg"):
            drawn = io.BytesIO()
            figure.savefig(drawn, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
            # The places of axes and texts are found once, for both files.
            figure.set_layout_engine("none")
            written.append(write_whole(Path(folder) / f"{name}.{kind}", drawn.getvalue()))
    return written
