"""The contents of a case, and its doubtful values."""

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np

from snakejax.core.errors import InputError
from snakejax.dynamics.signals import Tracked
from snakejax.vehicles.snakeboard.board import Board

from .case import load_case
from .continuous import LEAST_MOTION, mean_speed
from .quality import CONVENTIONS, Finding, Inspection, clocks, estimate_noise, farthest_steering, inspect
from .quality.joint_motion import angles
from .quality.noise import SLOW_NOISE
from .run import Case, Run

Severity = Literal["note", "doubtful"]

STEEPEST = np.deg2rad(80)
NOISE_FACTOR = 2.0
SETTLED = 3.0
"""After so many time constants 5% of an error is left: exp(-3)."""
JOINT_UNITS = ("angle_unit", "frequency_unit")
"""Findings after which the clocks of cameras and joints cannot be compared."""


class Issue(NamedTuple):
    """A doubtful value in `run`, or in the whole case if that is None.

    `remedy`: what was done or can be done; `kind`: that of a finding in the recording.
    """

    run: str | None
    what: str
    severity: Severity
    remedy: str = ""
    kind: str = ""

    @property
    def alike(self) -> Hashable:
        """What issues that are shortened to one have in common, see `quality.in_brief`."""
        return self.kind or self.what, self.severity, self.remedy


class RunSummary(NamedTuple):
    """The duration [s], frame rate [Hz], number of frames and of lost frames of one run."""

    run: str
    role: str
    duration: float
    rate: float
    samples: int
    lost: int


def run_summary(run: Run) -> RunSummary:
    """What `run` holds."""
    times = np.asarray(run.times)
    lost = int((~_present(run)).sum())
    return RunSummary(run.name, run.role, float(times[-1] - times[0]), _rate(run), times.size, lost)


def check(
    case: Case | Path | str, folder: Path | str | None = None, inspection: Inspection | None = None
) -> list[Issue]:
    """The doubtful values of `case`, those of the whole case first.

    `case`: a `Case`, or its folder, which is then also searched for unused files. `folder`: searched for unused files,
    if given. `inspection`: the result of `inspect(case)`, if it exists already. **Raises:** as `load_case`.
    """
    if isinstance(case, Path | str):
        folder = case if folder is None else folder
        case = load_case(case)
    inspected = inspection or inspect(case)
    issues = [*_whole(case), *_noise(inspected.case), *(_unused(case, Path(folder)) if folder is not None else ())]
    issues += [_issue(f) for f in inspected.findings if f.run is None]
    turned = {f.run for f in inspected.findings if f.kind in (*CONVENTIONS, *JOINT_UNITS)}
    in_degrees = any(f.kind == "angle_unit" for f in inspected.findings)
    mended = {run.name: run for run in inspected.case.runs}
    for run in case.runs:
        of_run = [f for f in inspected.findings if f.run == run.name]
        # Clocks show only where axes, signs and frequencies are right.
        if not (any(f.severity == "refused" for f in of_run) or run.log is not None or turned & {None, run.name}):
            of_run += clocks(mended.get(run.name, run))
        issues += [_issue(f._replace(run=run.name)) for f in of_run]
        issues += () if in_degrees else _steering(run)
    return issues


def _issue(f: Finding) -> Issue:
    return Issue(f.run, f.what, "note" if f.severity == "note" else "doubtful", f.remedy, f.kind)


def _readings(case: Case) -> dict[str, list[str]]:
    """What reading the files decided, and the runs of which it did."""
    runs_of_note: dict[str, list[str]] = {}
    for run, notes in case.reading.items():
        for note in notes:
            runs_of_note.setdefault(note, []).append(run)
    return runs_of_note


def _which(names: Sequence[str], runs: int) -> str:
    return "all runs" if len(names) == runs else ", ".join(names)


def _present(run: Run) -> np.ndarray:
    return np.asarray(np.isfinite(run.pose).all(axis=1))


def _rate(run: Run) -> float:
    return 1.0 / float(np.median(np.diff(np.asarray(run.times))))


def _whole(case: Case) -> Iterator[Issue]:
    if not case.having("heldout"):
        yield Issue(None, "no run is held out: the fit cannot be validated", "doubtful")
    if len(case.having("train")) == 1:
        yield Issue(None, "there is only one train run", "note")
    train = case.having("train")
    if len(train) > 1 and all(bool(eqx.tree_equal(train[0].gait, run.gait)) for run in train[1:]):
        yield Issue(None, "the gait is the same in all train runs: few effects can be distinguished", "doubtful")
    yield from _still_rotor(case)
    yield from _creeping(case)
    yield from _slow_joints(case)
    for i, run in enumerate(case.runs):
        for other in case.runs[:i]:
            if run.pose.shape == other.pose.shape and np.array_equal(run.pose, other.pose, equal_nan=True):
                yield Issue(run.name, f"holds the same poses as {other.name}", "doubtful")


def _still_rotor(case: Case) -> Iterator[Issue]:
    """A snakeboard whose rotor stands still in all runs, but which sets off from rest."""
    if not isinstance(case.board, Board):
        return
    for run in case.runs:
        turned = angles(run.gait.signal("psi"), np.asarray(run.times))
        if run.moving or np.ptp(turned) > 0 or _speed(run) < LEAST_MOTION:
            return
    what = "nothing turns the rotor, and the board starts at rest, but it moves: what drives it?"
    remedy = 'write psi; start = "moving" for a board that was pushed; `snakejax new --vehicle car` for another vehicle'
    yield Issue(None, what, "doubtful", remedy)


def _slow_joints(case: Case) -> Iterator[Issue]:
    """Joints whose controller still has 5% of its first error when the longest run ends."""
    longest = max(float(run.times[-1]) for run in case.runs)
    slow: dict[str, float] = {}
    for run in case.runs:
        for name in run.gait.names:
            if isinstance(signal := run.gait.signal(name), Tracked):
                decay = float(signal.decay)
                if decay * longest < SETTLED:
                    slow[name] = SETTLED / decay if decay > 0 else np.inf
    for name, seconds in slow.items():
        when = f"only after {seconds:.2g} s" if np.isfinite(seconds) else "never"
        what = f"{name} reaches its command {when}, and the longest run has {longest:.3g} s"
        yield Issue(None, what, "doubtful", "check kp and kd in [actuator]: the slower decay is kp / kd if kd is large")


def _speed(run: Run) -> float:
    present = _present(run)
    return mean_speed(np.asarray(run.times)[present], np.asarray(run.pose)[present])


def _creeping(case: Case) -> Iterator[Issue]:
    """A speed below which slip is smoothed that the vehicle hardly ever exceeds; one that fits estimate may."""
    creep = getattr(case.board, "creep_speed", None)
    if creep is None or "creep_speed" in case.board.stated_sd:
        return
    fastest = max(map(_speed, case.runs))
    if float(creep) > fastest:
        what = f"creep_speed_mps is {float(creep):g}, but the {case.board.noun} moves at {fastest:.2g} m/s"
        yield Issue(None, what, "doubtful", "take a small part of that speed: slip is smoothed below it")


def _noise(case: Case) -> Iterator[Issue]:
    try:
        noise = estimate_noise(case.runs)
    except InputError as error:
        yield Issue(None, f"the noise cannot be estimated: {error.what}", "note")
        return
    source = f" ({noise.source})" if SLOW_NOISE in noise.source else ""
    for name, unit in (("position", "m"), ("heading", "rad")):
        estimated = float(getattr(noise, name))
        if case.noise is None:
            yield Issue(None, f"no {name} noise is given; the recordings give {estimated:.3g} {unit}{source}", "note")
            continue
        given = float(getattr(case.noise, name))
        if not 1 / NOISE_FACTOR <= given / estimated <= NOISE_FACTOR:
            what = (
                f"{name} noise is given as {given:.3g} {unit}, but the recordings give {estimated:.3g} {unit}{source}"
            )
            yield Issue(None, what, "doubtful")


def _unused(case: Case, folder: Path) -> Iterator[Issue]:
    for path in sorted(folder.glob("*.csv")):
        if path.name not in case.sha256:
            yield Issue(None, f"{path.name} is in the folder, but no run uses it", "note")


def _steering(run: Run) -> Iterator[Issue]:
    for name, steepest in farthest_steering(run):
        if steepest > STEEPEST:
            reached = f"{name} is commanded to {np.rad2deg(steepest):.0f} degrees"
            what = f"{reached}: above 80 degrees the wheels may hit the board"
            yield Issue(run.name, what, "doubtful")
