"""One line style for the recording, the base model, and each step, in all figures and charts.

The colours are those of Okabe and Ito, which colour-blind readers can distinguish; they suit dark and white pages. All
are equally dark, so the dash tells one step from the next in grey print.
"""

from typing import NamedTuple


class LineStyle(NamedTuple):
    """A colour, and a dash by its name in Plotly; `MATPLOTLIB` has the same dashes for Matplotlib."""

    colour: str
    dash: str


MEASURED = LineStyle("#808080", "solid")
BASE = LineStyle("#2b7bba", "dash")
TRAIN, HELDOUT = "#56789a", "#d55e00"
COLOURS = ("#d55e00", "#009e73", "#c060a0", "#b8860b", "#3aa0d8", "#7a5cc0", "#8a8a20", "#b03030")
FORCES = (LineStyle("#d55e00", "solid"), LineStyle("#2b7bba", "dash"), LineStyle("#009e73", "dot"))
"""X, Y and N of a force."""
LAW = LineStyle("#000000", "solid")
"""The force of a law, over the force that it is a law of."""
COMPONENTS = ("X [N]", "Y [N]", "N [N m]")
DASHES = ("solid", "dashdot", "dot", "longdash", "longdashdot")
"""Of the steps, none of them that of the base model; their number has no factor in common with that of `COLOURS`."""
MATPLOTLIB = {
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (10, 3)),
    "longdashdot": (0, (10, 3, 2, 3)),
}


def step_style(step: int) -> LineStyle:
    """The line style of the model after `step` steps; `BASE` for the base model."""
    if step == 0:
        return BASE
    return LineStyle(COLOURS[(step - 1) % len(COLOURS)], DASHES[(step - 1) % len(DASHES)])
