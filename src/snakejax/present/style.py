"""One line style for the recording, the base model, and each step, in all figures and charts.

The colours are those of Okabe and Ito, which colour-blind readers can distinguish; they suit dark and white pages. With
more steps than colours the dash differs.
"""

from typing import NamedTuple


class LineStyle(NamedTuple):
    """A colour, and a dash as both plotting libraries name it: "solid", "dash", "dot" or "dashdot"."""

    colour: str
    dash: str


MEASURED = LineStyle("#808080", "solid")
BASE = LineStyle("#2b7bba", "dash")
TRAIN, HELDOUT = "#56789a", "#d55e00"
COLOURS = ("#d55e00", "#009e73", "#c060a0", "#b8860b", "#3aa0d8", "#7a5cc0", "#8a8a20", "#b03030")
FORCES = (LineStyle("#d55e00", "solid"), LineStyle("#2b7bba", "dash"), LineStyle("#009e73", "dot"))
"""X, Y and N of a force."""
COMPONENTS = ("X [N]", "Y [N]", "N [N m]")
DASHES = ("solid", "dashdot", "dot")
MATPLOTLIB = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}


def step_style(step: int) -> LineStyle:
    """The line style of the model after `step` steps; `BASE` for the base model."""
    if step == 0:
        return BASE
    return LineStyle(COLOURS[(step - 1) % len(COLOURS)], DASHES[(step - 1) // len(COLOURS) % len(DASHES)])
