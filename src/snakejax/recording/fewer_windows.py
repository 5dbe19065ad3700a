"""A part of the windows of a case, for a first look."""

import dataclasses
from itertools import groupby

from snakejax.core.errors import InputError

from .run import Case, Run

PART = 10
"""One window of so many is kept."""


def with_fewer_windows(case: Case) -> Case:
    """`case` with a tenth of the windows of each recording, evenly spread, and at least one of each.

    **Raises:** `InputError` where a run is no window of a longer recording.
    """
    whole = next((run.name for run in case.runs if run.cut_from is None), None)
    if whole is not None:
        what = f"Run {whole} of case {case.name} is a whole recording, of which no tenth is taken"
        raise InputError(
            what, "option --quick", "leave it out, or cut windows in case.toml: `windows = {length_s = 1.5}`"
        )

    def recording(run: Run) -> tuple[str, str]:
        return run.role, run.recorded_as

    kept: list[Run] = []
    for _, windows in groupby(case.runs, key=recording):
        of_recording = list(windows)
        count = -(-len(of_recording) // PART)
        kept += [of_recording[(2 * k + 1) * len(of_recording) // (2 * count)] for k in range(count)]
    return dataclasses.replace(case, runs=tuple(kept))
