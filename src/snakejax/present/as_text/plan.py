"""The plan of an explanation as text."""

from rich.console import Group, RenderableType
from rich.text import Text

from snakejax.core.tabular import first_few, listed
from snakejax.diagnosis.plan import Plan

from .tables import add_row, plain_table

MOST_NAMES = 12
"""The names of runs that are listed; the JSON has all."""


def plan_text(plan: Plan) -> RenderableType:
    """The base, the runs, and the candidates with their parameters."""
    first, *others = plan.structures
    then = f", then {listed(others)}" if others else ""
    free = listed(plan.free) if plan.free else "no parameter"
    heldout = first_few(plan.heldout, MOST_NAMES) or "none"
    lines: list[RenderableType] = [
        Text(f"{plan.case}: nothing is fitted."),
        Text(f"An explanation would fit {free} under {first}{then}"),
        Text(f"to {len(plan.train)} train runs ({first_few(plan.train, MOST_NAMES)})"),
        Text(f"and validate the result on {len(plan.heldout)} held-out runs ({heldout})."),
        Text(""),
    ]
    table = plain_table("candidate", "parameters")
    for name, parts in plan.candidates.items():
        add_row(table, name, ", ".join(parts))
    lines.append(table)
    lines += [Text(f"Excluded: {name}: {why.rstrip('.')}.") for name, why in plan.left_out.items()]
    return Group(*lines)
