"""What a case holds, and what in it is doubtful."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np

from ._errors import InputError
from ._gait import AbstractSignal, Tracked
from ._recording import Case, Run
from .quality import CONVENTIONS, Finding, Inspection, angles, clocks, estimate_noise, inspected

Severity = Literal["note", "doubtful"]

STEEPEST = np.deg2rad(80)
NOISE_FACTOR = 2.0


class Doubt(NamedTuple):
    """Something doubtful in `run`, or in the whole case where that is None; `remedy`, what is or can be done."""

    run: str | None
    what: str
    severity: Severity
    remedy: str = ""


class Holding(NamedTuple):
    """What one run holds: its duration [s], frame rate [Hz], frames, and how many of them are lost."""

    run: str
    role: str
    duration: float
    rate: float
    samples: int
    lost: int


def holding(run: Run) -> Holding:
    """What `run` holds."""
    times = np.asarray(run.times)
    lost = int((~_present(run)).sum())
    return Holding(run.name, run.role, float(times[-1] - times[0]), _rate(run), times.size, lost)


def check(case: Case, folder: Path | str | None = None, inspection: Inspection | None = None) -> list[Doubt]:
    """Everything doubtful in `case`, the case as a whole first; `folder`, where given, is searched for unused files.

    `inspection`: what `inspected(case)` found, where that is known already.
    """
    seen = inspection or inspected(case)
    found = [*_whole(case), *_noise(seen.case), *(_unused(case, Path(folder)) if folder is not None else ())]
    found += [_doubt(f) for f in seen.findings if f.run is None]
    turned = {f.run for f in seen.findings if f.kind in CONVENTIONS}
    for run, mended in zip(case.runs, seen.case.runs, strict=True):
        of_run = [f for f in seen.findings if f.run == run.name]
        # Clocks show only where axes and signs are right.
        if not (any(f.severity == "refused" for f in of_run) or run.log is not None or turned & {None, run.name}):
            of_run += clocks(mended)
        found += [_doubt(f._replace(run=run.name)) for f in of_run]
        found += _steering(run)
    return found


def _doubt(f: Finding) -> Doubt:
    return Doubt(f.run, f.what, "note" if f.severity == "note" else "doubtful", f.remedy)


def check_text(case: Case, doubts: Sequence[Doubt]) -> str:
    """What `case` holds and the `doubts` about it, as text to read."""
    holdings = [holding(run) for run in case.runs]
    width = max(len(h.run) for h in holdings)
    train, heldout = len(case.having("train")), len(case.having("heldout"))
    lines = [f"{case.name}: {case.title}", f"{train} train and {heldout} heldout runs, skid {case.skid}", ""]
    lines += [f"{'run':{width}}  {'role':7}  {'duration':>9}  {'rate':>9}  {'samples':>7}  {'lost':>5}"]
    lines += [
        f"{h.run:{width}}  {h.role:7}  {h.duration:7.2f} s  {h.rate:6.1f} Hz  {h.samples:7d}  {h.lost:5d}"
        for h in holdings
    ]
    lines += ["", "doubtful:" if doubts else "nothing is doubtful"]
    for d in doubts:
        lines.append(f"  {'? ' if d.severity == 'doubtful' else '  '}{d.run or 'the case'}: {d.what}")
        lines += [f"      {d.remedy}"] if d.remedy else []
    return "\n".join(lines)


def _present(run: Run) -> np.ndarray:
    return np.asarray(np.isfinite(run.pose).all(axis=1))


def _rate(run: Run) -> float:
    return 1.0 / float(np.median(np.diff(np.asarray(run.times))))


def _whole(case: Case) -> Iterator[Doubt]:
    if not case.having("heldout"):
        yield Doubt(None, "no run is held out: nothing will check what a fit predicts", "doubtful")
    if len(case.having("train")) == 1:
        yield Doubt(None, "there is only one train run", "note")
    train = case.having("train")
    if len(train) > 1 and all(bool(eqx.tree_equal(train[0].gait, run.gait)) for run in train[1:]):
        yield Doubt(None, "the gait is the same in all train runs: few effects can be told apart", "doubtful")
    for i, run in enumerate(case.runs):
        for other in case.runs[:i]:
            if run.pose.shape == other.pose.shape and np.array_equal(run.pose, other.pose, equal_nan=True):
                yield Doubt(run.name, f"holds the same poses as {other.name}", "doubtful")


def _noise(case: Case) -> Iterator[Doubt]:
    try:
        seen = estimate_noise(case.runs)
    except InputError as error:
        yield Doubt(None, f"the noise cannot be estimated: {error.what}", "note")
        return
    source = f" ({seen.source})" if "share it" in seen.source else ""
    for name, unit in (("position", "m"), ("heading", "rad")):
        estimated = float(getattr(seen, name))
        if case.noise is None:
            yield Doubt(None, f"no {name} noise is given; the recordings say {estimated:.3g} {unit}{source}", "note")
            continue
        given = float(getattr(case.noise, name))
        if not 1 / NOISE_FACTOR <= given / estimated <= NOISE_FACTOR:
            what = f"{name} noise is given as {given:.3g} {unit}, but the recordings say {estimated:.3g} {unit}{source}"
            yield Doubt(None, what, "doubtful")


def _unused(case: Case, folder: Path) -> Iterator[Doubt]:
    for path in sorted(folder.glob("*.csv")):
        if path.name not in case.sha256:
            yield Doubt(None, f"{path.name} lies in the folder, but no run uses it", "note")


def _steering(run: Run) -> Iterator[Doubt]:
    for name in ("phi", "phi_back"):
        signal: AbstractSignal | None = getattr(run.gait, name)
        command = signal.command if isinstance(signal, Tracked) else signal
        if command is None:
            continue
        steepest = float(np.abs(angles(command, np.asarray(run.times))).max())
        if steepest > STEEPEST:
            what = f"{name} is commanded to {np.rad2deg(steepest):.0f} degrees: beyond 80 wheels may hit"
            yield Doubt(run.name, what, "doubtful")
