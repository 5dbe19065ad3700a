"""Figures as files."""

from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

DPI = 150


def save(figure: Figure, folder: Path | str, name: str) -> list[Path]:
    """Write `figure` to NAME.png and NAME.svg in `folder`, made where it is not there; the paths written."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"{name}.png", folder / f"{name}.svg"]
    # No date and no random names: the same figure is the same file.
    with matplotlib.rc_context({"svg.hashsalt": "snakejax"}):
        for path in written:
            figure.savefig(path, dpi=DPI, metadata={"Date": None} if path.suffix == ".svg" else None)
    return written
