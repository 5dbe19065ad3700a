"""The findings about recordings as text."""

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from snakejax.recording.quality import Inspection, in_brief

from .tables import add_row, indented, plain_table

MOST_FINDINGS = 12
"""The findings listed on a terminal; the JSON has all."""


def quality_report(inspection: Inspection) -> RenderableType:
    """The defects of the recordings and what was done about them, printed before the fit."""
    runs = inspection.case.runs
    frames = sum(len(run.times) for run in runs)
    present = sum(int(np.isfinite(np.asarray(run.pose)).all(axis=1).sum()) for run in runs)
    lost = f"{len(runs)} run{'s' * (len(runs) != 1)}, {frames} frames, {1 - present / max(frames, 1):.1%} of them lost"
    if not inspection.findings:
        return Text(f"recordings: {lost}; no defects", style="dim")
    table = plain_table("run", "from [s]", "to [s]", "defect", "action, or remedy", right=("from [s]", "to [s]"))
    findings = in_brief(inspection.findings)
    for f in findings[:MOST_FINDINGS]:
        when = ("", "") if f.run is None else (f"{f.start:.2f}", f"{f.end:.2f}")
        add_row(table, f.run or "all", *when, f.what, f.done)
    more = len(findings) - MOST_FINDINGS
    end = f"{more} more findings are in the JSON; " if more > 0 else ""
    how = "as recorded" if inspection.as_recorded else f"{sum(inspection.masked.values())} frames masked"
    return Group(Text(f"recordings: {lost}"), Text(), indented(table), Text(f"{end}{how}"), Text())
