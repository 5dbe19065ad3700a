"""What is found in a recording, one defect after the other, and the recording with the safe remedies applied."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.tabular import counted
from snakejax.vehicles.snakeboard.board import Board

from ..readers import FEWEST_SAMPLES
from ..run import Case, Run
from .conventions import conventions
from .finding import Finding, PoseSeries
from .frames import copied, frozen, gaps
from .frequency import frequencies
from .heading import flips, half_turns, unflipped
from .measures import measures
from .outliers import jumps
from .plausibility import area, shaking, start, units, up_axis
from .steering_unit import steering_units
from .timestamps import backward, stray
from .windows import judged_together

Corners = tuple[float, float, float, float]


class Inspection(NamedTuple):
    """`findings` in the runs of a case, and the `case` with their safe remedies applied, unless `as_recorded`."""

    case: Case
    findings: tuple[Finding, ...]
    as_recorded: bool = False

    def __repr__(self) -> str:
        lines = [f"  {f.run or self.case.name}: {f.what} - {f.remedy}" for f in self.findings]
        return "\n".join([f"{self.case!r}; {counted(len(lines), 'finding')}", *lines])

    @property
    def masked(self) -> dict[str, int]:
        """How many seen frames count as lost, in each run in which there are any."""
        counts: dict[str, int] = {}
        for f in self.findings:
            if f.applied and f.action == "mask" and f.run is not None:
                counts[f.run] = counts.get(f.run, 0) + f.frames.size
        return counts

    def require_sound(self) -> "Inspection":
        """This. **Raises:** `InputError` for the first finding with which nothing should be fitted."""
        for f in self.findings:
            if f.severity == "refused" and not self.as_recorded:
                where = f"{self.case.name}, run {f.run}" if f.run is not None else self.case.name
                raise InputError(
                    f"{f.what[0].upper()}{f.what[1:]}", where, f"{f.remedy}; --as-recorded fits it as it is"
                )
        return self


def find_defects(track: PoseSeries, corners: Corners | None = None) -> tuple[PoseSeries, list[Finding]]:
    """What is wrong with `track`, and the track with what may safely be done about it.

    Each detector sees what the remedies of those before it have left.
    """
    findings: list[Finding] = backward(track)
    if findings:
        return track, findings

    def apply(detector: Callable[[PoseSeries], list[Finding]], current: PoseSeries) -> PoseSeries:
        for f in detector(current):
            left = int(current.present.sum()) - np.intersect1d(f.frames, np.flatnonzero(current.present)).size
            if f.action == "mask" and left < FEWEST_SAMPLES:
                f = f._replace(action="none", severity="refused")
            findings.append(f._replace(applied=f.action != "none"))
            if f.action == "mask":
                current = current.without(f.frames)
            elif f.action == "turn":
                current = unflipped(current)
        return current

    for look in (gaps, stray, units, up_axis):
        apply(look, track)
    if any(f.severity == "refused" for f in findings):
        return track, findings
    mended = apply(lambda t: area(t, corners), track) if corners is not None else track
    apply(copied, mended)
    for detector in (frozen, flips, jumps):
        mended = apply(detector, mended)
        if any(f.severity == "refused" for f in findings):
            return mended, findings
    for look in (half_turns, start, shaking):
        apply(look, mended)
    return mended, findings


def inspect_run(run: Run, corners: Corners | None = None) -> tuple[Run, list[Finding]]:
    """`find_defects` for a `Run`, which is returned as it is where nothing was done."""
    track = PoseSeries.of(run)
    mended, findings = find_defects(track, corners)
    findings = [f._replace(run=run.name) for f in findings]
    if mended is track:
        return run, findings
    return eqx.tree_at(lambda r: r.pose, run, jnp.asarray(mended.pose)), findings


def inspect(case: Case, as_recorded: bool = False) -> Inspection:
    """Inspect the runs of `case`: the findings, and the case with safe remedies applied.

    `as_recorded`: leave the case unchanged.
    """
    runs: list[Run] = []
    findings: list[Finding] = []
    for run in case.runs:
        repaired, of_run = inspect_run(run, case.area)
        runs.append(repaired)
        findings += of_run
    findings = judged_together(case.runs, findings)
    if isinstance(case.board, Board) and not any(f.severity == "refused" for f in findings):
        # What one of them finds would mislead those after it.
        findings += (
            steering_units(runs) or frequencies(runs, case.board) or conventions(runs) or measures(runs, case.board)
        )
    if as_recorded:
        return Inspection(case, tuple(f._replace(applied=False) for f in findings), True)
    touched = any(a is not b for a, b in zip(runs, case.runs, strict=True))
    omitted = {f.run for f in findings if f.action == "omit"}
    kept = tuple(run for run in runs if run.name not in omitted)
    return Inspection(eqx.tree_at(lambda c: c.runs, case, kept) if touched or omitted else case, tuple(findings))
