"""The names of columns: one name for one quantity, in the terminal and on pages."""

POSITION, HEADING = "position [mm]", "heading [mrad]"
"""Root mean square errors of the train runs."""
ERROR = "error / noise"
"""The same over x, y and heading together, in multiples of the noise."""
CHANNELS = ("x / noise", "y / noise", "heading / noise")
FALL = "fall of chi^2"
"""By how much a candidate lowers chi^2, by the linear model of its test."""
WINDOWS, PREDICTED, REFIT = "windows / noise", "predicted / noise", "refit / noise"
"""The error that a candidate leaves: of short windows, of whole runs by the linear model, of whole runs refitted."""
EXPECTED, DETECTS = "expected", "detects"
"""Titles of a value, and of the smallest one that would show."""

ORDER = "Refitted candidates come first, the smallest error first; then the others, in the order of the test."
"""The order of a table of candidates."""
P_AND_SD = "+- may include the differences between runs, p does not: a small p can occur with a large +-."
"""Why p and +- of a candidate need not agree."""


def of_heldout(name: str) -> str:
    """The column `name` of held-out runs."""
    return f"held-out {name}"


def narrow(name: str) -> str:
    """A name in two lines, for a terminal of 80 columns."""
    quantity, slash, unit = name.partition(" / ")
    if slash:
        return f"{quantity} /\n{unit}" if len(quantity) < len("noise") else f"{quantity}\n/ {unit}"
    return name.replace(" [", "\n[")
