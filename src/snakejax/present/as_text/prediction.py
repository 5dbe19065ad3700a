"""The errors of predictions as a table."""

from rich.console import Group, RenderableType
from rich.text import Text

from snakejax.estimation.prediction import Predictions

from .errors import milli_text
from .tables import add_row, indented, plain_table


def prediction_report(name: str, groups: Predictions, lead: float) -> RenderableType:
    """A table for each group: median and 90% of the error of each model after each horizon."""
    parts: list[RenderableType] = [Text(name, style="bold")]
    parts.append(
        Text(f"errors of predictions after the stated seconds; the start state is estimated from the {lead:g} s before")
    )
    right = ("after\n[s]", "position\n[mm]", "90%\n[mm]", "heading\n[mrad]", "90%\n[mrad]", "windows")
    for group, models in groups.items():
        table = plain_table(group, *right, right=right)
        for model, by_horizon in models.items():
            for i, (horizon, e) in enumerate(by_horizon.items()):
                errors = (e.position, e.position_90, e.heading, e.heading_90)
                add_row(table, "" if i else model, horizon, *map(milli_text, errors), str(e.windows))
        parts += [Text(), indented(table)]
    return Group(*parts)
