"""A claim of the paper, our number beside it, and the verdict."""

from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure


class Claim(NamedTuple):
    """One row: what the paper says, what we find, whether it holds, and by which criterion."""

    number: str
    claim: str
    ours: str
    verdict: str
    why: str


def verdict(holds: bool, nearly: bool = False) -> str:
    return "reproduced" if holds else "close" if nearly else "not"


def keep(figure: Figure, folder: Path, name: str) -> None:
    figure.savefig(folder / f"{name}.png", dpi=110)
