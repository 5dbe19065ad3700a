"""What is found in a recording, one defect after the other, and the recording with the safe remedies applied."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._recording import Case, Run
from .clock import backward, stray
from .conventions import conventions
from .finding import Finding, Track
from .frames import copied, frozen, gaps
from .heading import flips, half_turns, turned_back
from .jumps import jumps
from .plausible import area, shaking, start, units, up_axis

FEWEST_SAMPLES = 10

Corners = tuple[float, float, float, float]


class Inspection(NamedTuple):
    """`findings` in the runs of a case, and the `case` with their safe remedies applied, unless `as_recorded`."""

    case: Case
    findings: tuple[Finding, ...]
    as_recorded: bool = False

    @property
    def masked(self) -> dict[str, int]:
        """How many seen frames count as lost, in each run in which there are any."""
        found: dict[str, int] = {}
        for f in self.findings:
            if f.applied and f.action == "mask" and f.run is not None:
                found[f.run] = found.get(f.run, 0) + f.frames.size
        return found

    def require_sound(self) -> "Inspection":
        """This. **Raises:** `InputError` for the first finding with which nothing should be fitted."""
        for f in self.findings:
            if f.severity == "refused" and not self.as_recorded:
                where = f"{self.case.name}, run {f.run}"
                raise InputError(
                    f"{f.what[0].upper()}{f.what[1:]}", where, f"{f.remedy}; --as-recorded fits it as it is"
                )
        return self


def inspect(track: Track, corners: Corners | None = None) -> tuple[Track, list[Finding]]:
    """What is wrong with `track`, and the track with what may safely be done about it.

    Each detector sees what the remedies of those before it have left.
    """
    found: list[Finding] = backward(track)
    if found:
        return track, found

    def apply(detector: Callable[[Track], list[Finding]], now: Track) -> Track:
        for f in detector(now):
            left = int(now.present.sum()) - np.intersect1d(f.frames, np.flatnonzero(now.present)).size
            if f.action == "mask" and left < FEWEST_SAMPLES:
                f = f._replace(action="none", severity="refused")
            found.append(f._replace(applied=f.action != "none"))
            if f.action == "mask":
                now = now.without(f.frames)
            elif f.action == "turn":
                now = turned_back(now)
        return now

    for look in (gaps, stray, units, up_axis):
        apply(look, track)
    if any(f.severity == "refused" for f in found):
        return track, found
    mended = apply(lambda t: area(t, corners), track) if corners is not None else track
    apply(copied, mended)
    for detector in (frozen, flips, jumps):
        mended = apply(detector, mended)
        if any(f.severity == "refused" for f in found):
            return mended, found
    for look in (half_turns, start, shaking):
        apply(look, mended)
    return mended, found


def inspect_run(run: Run, corners: Corners | None = None) -> tuple[Run, list[Finding]]:
    """`inspect` for a `Run`, which is returned as it is where nothing was done."""
    track = Track.of(run)
    mended, found = inspect(track, corners)
    found = [f._replace(run=run.name) for f in found]
    if mended is track:
        return run, found
    return eqx.tree_at(lambda r: r.pose, run, jnp.asarray(mended.pose)), found


def inspected(case: Case, as_recorded: bool = False) -> Inspection:
    """What is found in the runs of `case`, and the case as it may be fitted; with `as_recorded`, untouched."""
    runs, findings = [], []
    for run in case.runs:
        better, found = inspect_run(run, case.area)
        runs.append(better)
        findings += found
    if not any(f.severity == "refused" for f in findings):
        findings += conventions(runs)
    if as_recorded:
        return Inspection(case, tuple(f._replace(applied=False) for f in findings), True)
    touched = any(a is not b for a, b in zip(runs, case.runs, strict=True))
    return Inspection(eqx.tree_at(lambda c: c.runs, case, tuple(runs)) if touched else case, tuple(findings))
