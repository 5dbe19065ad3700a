"""What a case holds, what in it is doubtful, and how noisy it is."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ._errors import InputError
from ._gait import AbstractSignal, Tracked
from ._recording import Case, Noise, Run

Severity = Literal["note", "doubtful"]

LOST_SHARE = 0.2
LONG_GAP = 0.5
LATE_START = 0.1
JUMP_SDS = 8.0
FROZEN_FRAMES = 4
NEAR_PI = 0.8 * np.pi
STEEPEST = np.deg2rad(80)
FARTHEST, NEAREST = 100.0, 1e-3
NOISE_FACTOR = 2.0
REST_WINDOW = 0.25
REST_SPEED = {"x": 0.05, "y": 0.05, "heading": 0.3}
ORDER = 5
CLIP = 4.0
FEWEST_DIFFERENCES = 30
MAD_TO_SD = 1.4826
CHANNELS = ("x", "y", "heading")


class Doubt(NamedTuple):
    """Something doubtful in `run`, or in the whole case where that is None."""

    run: str | None
    what: str
    severity: Severity


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


def check(case: Case, folder: Path | str | None = None) -> list[Doubt]:
    """Everything doubtful in `case`, the case as a whole first; `folder`, where given, is searched for unused files."""
    found = [*_whole(case), *_noise(case), *(_unused(case, Path(folder)) if folder is not None else ())]
    for run in case.runs:
        for test in (_gaps, _jumps, _repeats, _half_turns, _start, _range, _steering):
            found += [Doubt(run.name, what, severity) for what, severity in test(run)]
    return found


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
    lines += [f"  {'? ' if d.severity == 'doubtful' else '  '}{d.run or 'the case'}: {d.what}" for d in doubts]
    return "\n".join(lines)


Findings = Iterator[tuple[str, Severity]]


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
    for name, unit in (("position", "m"), ("heading", "rad")):
        estimated = float(getattr(seen, name))
        if case.noise is None:
            yield Doubt(None, f"no {name} noise is given; the recordings say {estimated:.3g} {unit}", "note")
            continue
        given = float(getattr(case.noise, name))
        if not 1 / NOISE_FACTOR <= given / estimated <= NOISE_FACTOR:
            what = f"{name} noise is given as {given:.3g} {unit}, but the recordings say {estimated:.3g} {unit}"
            yield Doubt(None, what, "doubtful")


def _unused(case: Case, folder: Path) -> Iterator[Doubt]:
    for path in sorted(folder.glob("*.csv")):
        if path.name not in case.sha256:
            yield Doubt(None, f"{path.name} lies in the folder, but no run uses it", "note")


def _gaps(run: Run) -> Findings:
    present, times = np.flatnonzero(_present(run)), np.asarray(run.times)
    if (late := times[present[0]] - (times[0] if run.moving else 0.0)) > LATE_START:
        yield f"the first sample comes {late:.2f} s after the start", "doubtful"
    share = 1 - present.size / (times.size - present[0])
    if share > LOST_SHARE:
        yield f"{share:.0%} of the frames are lost", "doubtful"
    if present.size > 1:
        steps = np.diff(times[present])
        longest = int(steps.argmax())
        if steps[longest] > LONG_GAP:
            yield f"a gap of {steps[longest]:.2f} s at {times[present[longest]]:.2f} s", "doubtful"


def _jumps(run: Run) -> Findings:
    """A frame far off its neighbours: its second difference stands out by 8 robust standard deviations."""
    pose, times = np.asarray(run.pose), np.asarray(run.times)
    for name, channel in zip(CHANNELS, pose.T, strict=True):
        bend = np.diff(channel, 2)
        bend[~np.isfinite(bend)] = 0.0
        limit = JUMP_SDS * _robust_sd(bend[bend != 0.0])
        far = np.abs(bend) > limit
        peaks = np.flatnonzero(far & (np.abs(bend) >= _neighbours(np.abs(bend))))
        if limit > 0 and peaks.size:
            worst = peaks[np.abs(bend[peaks]).argmax()]
            where = f"{name} jumps by {np.abs(bend[worst]) / 2:.3g} {'rad' if name == 'heading' else 'm'}"
            yield f"{where} in one frame at {times[worst + 1]:.2f} s ({peaks.size} in all)", "doubtful"


def _neighbours(values: np.ndarray) -> np.ndarray:
    """The larger of the two values beside each."""
    padded = np.pad(values, 1)
    return np.maximum(padded[:-2], padded[2:])


def _repeats(run: Run) -> Findings:
    pose, times = np.asarray(run.pose), np.asarray(run.times)
    same = (pose[1:] == pose[:-1]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, lengths = edges[::2], edges[1::2] - edges[::2] + 1
    if lengths.size and lengths.max() >= FROZEN_FRAMES:
        longest = int(lengths.argmax())
        where = f"{lengths[longest]} frames at {times[starts[longest]]:.2f} s"
        yield f"the pose is frozen for {where} ({same.sum()} repeats in all)", "doubtful"
    elif same.any():
        yield f"{same.sum()} frames repeat the pose before them", "doubtful"
    apart = pose[_present(run)]
    apart = apart[np.concatenate([[True], (apart[1:] != apart[:-1]).any(axis=1)])]
    copies = len(apart) - len(np.unique(apart, axis=0))
    if copies:
        yield f"{copies} poses occur again elsewhere in the run, as if copied", "doubtful"


def _half_turns(run: Run) -> Findings:
    present, times = np.flatnonzero(_present(run)), np.asarray(run.times)
    turns = np.abs(np.diff(np.asarray(run.pose)[present, 2]))
    for i in np.flatnonzero(turns > NEAR_PI)[:1]:
        what = f"the heading turns by {turns[i]:.2f} rad between samples"
        yield f"{what} at {times[present[i]]:.2f} s: which way?", "doubtful"


def _start(run: Run) -> Findings:
    """The speed at time 0, from a cubic through the first quarter second."""
    early = _present(run) & (np.asarray(run.times) <= REST_WINDOW)
    times = np.asarray(run.times)[early]
    if run.moving or times.size < 12 or times[0] > REST_WINDOW / 5:
        return
    basis = np.vander(times, 4, increasing=True)
    for name, channel in zip(CHANNELS, np.asarray(run.pose)[early].T, strict=True):
        coefficients, *_ = np.linalg.lstsq(basis, channel, rcond=None)
        rest = channel - basis @ coefficients
        variance = float(rest @ rest) / (times.size - 4) * np.linalg.inv(basis.T @ basis)[1, 1]
        if abs(coefficients[1]) > REST_SPEED[name] + 5 * np.sqrt(variance):
            unit = "rad/s" if name == "heading" else "m/s"
            what = f"{name} already moves at {coefficients[1]:.2g} {unit} at the start"
            yield f'{what}, which is to be at rest: start = "moving"?', "doubtful"


def _range(run: Run) -> Findings:
    position = np.asarray(run.pose)[_present(run), :2]
    far = float(np.linalg.norm(position - position[0], axis=1).max())
    if far > FARTHEST:
        yield f"the board goes {far:.3g} m away: is the unit of length right?", "doubtful"
    if far < NEAREST:
        yield f"the board goes only {far:.2g} m away: did it move, and is the unit of length right?", "doubtful"


def _steering(run: Run) -> Findings:
    for name in ("phi", "phi_back"):
        signal: AbstractSignal | None = getattr(run.gait, name)
        command = signal.command if isinstance(signal, Tracked) else signal
        if command is None:
            continue
        steepest = float(np.abs(jax.vmap(lambda t, c=command: c.at(t).angle)(run.times)).max())
        if steepest > STEEPEST:
            yield f"{name} is commanded to {np.rad2deg(steepest):.0f} degrees: beyond 80 wheels may hit", "doubtful"


def _robust_sd(values: Float[np.ndarray, " n"]) -> float:
    """The standard deviation that the median absolute deviation of `values` has for a normal distribution."""
    return MAD_TO_SD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def noise_of(case: Case) -> Noise:
    """The noise that `case` states, else what its recordings show. **Raises:** as `estimate_noise`."""
    return case.noise or estimate_noise(case.runs)


def estimate_noise(runs: Sequence[Run]) -> Noise:
    """The standard deviation of one sample of position (x and y pooled) and of heading over all `runs`.

    White noise of variance s^2 on a smooth motion has k-th differences of variance C(2k, k) s^2, and the motion's own
    k-th difference falls with the k-th power of the frame time. k = 5, over frames that are all present; what lies
    beyond 4 robust standard deviations is left out, and the share of a normal distribution out there restored.

    **Raises:** `InputError` where fewer than 30 differences are whole, or the samples repeat so that no noise is seen.
    """
    poses = [np.asarray(run.pose) for run in runs]
    position = np.concatenate([_differences(pose[:, i]) for pose in poses for i in (0, 1)])
    heading = np.concatenate([_differences(pose[:, 2]) for pose in poses])
    return Noise(*(np.asarray(_clipped_sd(d)) for d in (position, heading)), source="estimated from the recordings")


def _differences(channel: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    difference = np.diff(channel, ORDER)
    return difference[np.isfinite(difference)] / math.sqrt(math.comb(2 * ORDER, ORDER))


def _clipped_sd(difference: Float[np.ndarray, " m"]) -> float:
    if difference.size < FEWEST_DIFFERENCES:
        what = f"Only {difference.size} stretches of {ORDER + 1} frames are whole: too few to estimate the noise"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    limit = CLIP * _robust_sd(difference)
    inside = difference[np.abs(difference) <= limit]
    # Variance of a standard normal cut off at +-CLIP.
    left = 1 - 2 * CLIP * math.exp(-(CLIP**2) / 2) / math.sqrt(2 * math.pi) / math.erf(CLIP / math.sqrt(2))
    sd = float(np.sqrt(np.mean(inside**2) / left))
    if not sd > 0:
        what = "Most samples repeat the one before, so that no noise can be estimated"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    return sd
