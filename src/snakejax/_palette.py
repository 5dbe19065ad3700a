"""One look for each thing in every picture: the recording, the base model, and each effect.

Colours are those of Okabe and Ito, which people who cannot tell red from green can tell apart, light enough for a dark
page and dark enough for a white one; where there are more effects than colours the dash differs.
"""

import zlib
from typing import NamedTuple

from .effects import LIBRARY


class Look(NamedTuple):
    """A colour, and a dash as both plotting libraries name it: "solid", "dash", "dot" or "dashdot"."""

    colour: str
    dash: str


MEASURED = Look("#808080", "solid")
BASE = Look("#2b7bba", "dash")
TRAIN, HELDOUT = "#56789a", "#d55e00"
COLOURS = ("#d55e00", "#009e73", "#c060a0", "#b8860b", "#3aa0d8", "#7a5cc0", "#8a8a20", "#b03030")
FORCES = (Look("#d55e00", "solid"), Look("#2b7bba", "dash"), Look("#009e73", "dot"))
"""X, Y and N of a force."""
DASHES = ("solid", "dashdot", "dot")
MATPLOTLIB = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}


def look(effect: str) -> Look:
    """The look of an effect, or of the model once it is added; that of "" is the base's."""
    if not effect:
        return BASE
    names = ["lateral_skid", *LIBRARY]
    number = names.index(effect) if effect in names else zlib.crc32(effect.encode())
    return Look(COLOURS[number % len(COLOURS)], DASHES[number // len(COLOURS) % len(DASHES)])
