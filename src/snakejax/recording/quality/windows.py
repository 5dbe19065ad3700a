"""Findings in windows of longer recordings: units are tested by all windows, and a window without use is omitted."""

from collections import Counter
from collections.abc import Sequence

from ..run import Run
from .finding import Finding

FEWEST_WINDOWS = 8
"""So many runs that begin in motion are windows, of which some may be missing."""


def judged_together(runs: Sequence[Run], findings: Sequence[Finding]) -> list[Finding]:
    """The `findings` in `runs`, where these are windows; as they are in other runs.

    A window is too short to tell its units: these are doubtful where they are in half of the windows. A window that
    nothing should be fitted to is left out (action "omit"), unless that would be half of them.
    """
    windows = [run.name for run in runs if run.moving]
    if len(windows) < max(FEWEST_WINDOWS, 0.5 * len(runs)):
        return list(findings)
    few = 0.5 * len(windows)
    of_kind = Counter(f.kind for f in findings)
    kept = [f for f in findings if f.kind != "units" or of_kind["units"] >= few]
    useless = {f.run for f in kept if f.severity == "refused"}
    if not 0 < len(useless) < few or not useless <= set(windows):
        return kept
    omitted = dict(action="omit", severity="doubtful", applied=True, remedy="the window is left out")
    return [f._replace(**omitted) if f.severity == "refused" else f for f in kept]
