"""The noise of one sample, without a model of the board: from neighbouring frames, from rest, from runs of one gait,
and from the markers of a rigid body.

| source | sees | needs |
|---|---|---|
| differences | white noise, and of slower noise only a part | nothing |
| rest | all noise faster than the rest is long | a second in which neither joints nor board move |
| repeats | all noise faster than half a second; from the same start slower noise too | two runs of one gait |
| markers | what the markers do by themselves, not what they do together | each marker's path |
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError
from snakejax.core.rotations import nearest_rotations
from snakejax.dynamics.inputs import Gait

from ..run import Case, Noise, Run
from .kinematics import robust_sd

ORDER = 5
CLIP = 4.0
FEWEST = 30
"""Numbers that an estimate needs."""
COLOURED = 1.15
"""Slower noise is accepted if a source that includes it gives so many times the value of the differences."""
REST = 1.0
"""Length [s] of the stretches that are searched for rest."""
STILL = 1e-3
"""Rate [rad/s] below which a joint stands still."""
SLOWER = {"repeats": "repeated runs", "rest": "times of rest"}
"""The sources that see slow noise too, as a reader knows them."""
SLOW_NOISE = "as a part of the noise is slow and neighbouring frames do not show it"
"""Why one of them was preferred."""
KNOTS = 0.5
"""Two runs of one gait may differ by something as slow as this [s] that is no noise: the floor, the start."""
ALIKE = (0.05, 0.1)
"""Starts that differ by less [m, rad] see the same floor."""


class Source(NamedTuple):
    """One estimate of the noise of one sample: `position` [m], `heading` [rad], from so many `samples` of a channel."""

    position: float
    heading: float
    samples: int


def noise_of(case: Case) -> Noise:
    """The noise that `case` states, or an estimate from its recordings.

    **Raises:** as `estimate_noise`.
    """
    return case.noise or estimate_noise(case.runs)


def estimate_noise(runs: Sequence[Run]) -> Noise:
    """The standard deviation of one sample of position (x and y pooled) and of heading over all `runs`.

    That of rest or repeats where they say clearly more than the differences of neighbouring frames, which miss slow
    noise; otherwise that of the differences, which have by far the most samples. `source` says which.

    **Raises:** `InputError` where too few frames are whole, or the samples repeat so that no noise is seen.
    """
    sources = noise_sources(runs)
    white, slower = sources["differences"], [name for name in SLOWER if name in sources]
    for name in slower:
        one = sources[name]
        margin = COLOURED + 3 / math.sqrt(one.samples)
        above = [slow > margin * fast for slow, fast in zip(one[:2], white[:2], strict=True)]
        if any(above):
            # A channel whose noise is white keeps what the many differences say.
            sds = [slow if coloured else fast for slow, fast, coloured in zip(one[:2], white[:2], above, strict=True)]
            return Noise(*map(np.asarray, sds), source=f"estimated from {SLOWER[name]}, {SLOW_NOISE}")
    agree = f"; {' and '.join(SLOWER[name] for name in slower)} agree" if slower else ""
    return Noise(np.asarray(white.position), np.asarray(white.heading), f"estimated from the recordings{agree}")


def noise_sources(runs: Sequence[Run]) -> dict[str, Source]:
    """The noise of `runs` by source: "differences" always, "rest" and "repeats" if the runs contain them.

    **Raises:** `InputError` as `estimate_noise`.
    """
    sources = {"differences": differences(runs)}
    for name, source in (("rest", rest(runs)), ("repeats", repeats(runs))):
        if source is not None:
            sources[name] = source
    return sources


def differences(runs: Sequence[Run]) -> Source:
    """From neighbouring frames.

    White noise of variance s^2 on a smooth motion has k-th differences of variance C(2k, k) s^2, and the motion's own
    k-th difference falls with the k-th power of the frame time. k = 5, over frames that are all present; what lies
    beyond 4 robust standard deviations is left out, and the share of a normal distribution out there restored.

    **Raises:** `InputError` where fewer than 30 differences are whole, or the samples repeat so that no noise is seen.
    """
    poses = [np.asarray(run.pose) for run in runs]
    position = np.concatenate([_differences(pose[:, i]) for pose in poses for i in (0, 1)])
    heading = np.concatenate([_differences(pose[:, 2]) for pose in poses])
    if min(position.size, heading.size) < FEWEST:
        what = f"Only {heading.size} stretches of {ORDER + 1} frames are whole: too few to estimate the noise"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    sds = _clipped_sd(position), _clipped_sd(heading)
    if not min(sds) > 0:
        what = "Most samples repeat the one before, so that no noise can be estimated"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    return Source(*sds, heading.size // (ORDER + 1))


def _differences(channel: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    difference = np.diff(channel, ORDER)
    return difference[np.isfinite(difference)] / math.sqrt(math.comb(2 * ORDER, ORDER))


def _clipped_sd(values: Float[np.ndarray, " m"]) -> float:
    limit = CLIP * robust_sd(values)
    inside = values[np.abs(values) <= limit]
    # Variance of a standard normal cut off at +-CLIP.
    left = 1 - 2 * CLIP * math.exp(-(CLIP**2) / 2) / math.sqrt(2 * math.pi) / math.erf(CLIP / math.sqrt(2))
    return float(np.sqrt(np.mean(inside**2) / left)) if inside.size else 0.0


def rest(runs: Sequence[Run]) -> Source | None:
    """From stretches of a second in which the joints stand still and the board goes no further than its noise: what is
    left of them beside a straight line. None where there are none.
    """
    left = []
    for run in runs:
        times, pose = np.asarray(run.times), np.asarray(run.pose)
        still: np.ndarray | None = None
        size = max(FEWEST, round(REST / float(np.median(np.diff(times)))))
        k = 0
        while k + size <= len(times):
            piece = slice(k, k + size)
            present = np.isfinite(pose[piece]).all(axis=1)
            if present.sum() < FEWEST:
                k += max(1, size // 10)
                continue
            at, part = times[piece][present], pose[piece][present]
            basis = np.vander(at - at.mean(), 2)
            line, *_ = np.linalg.lstsq(basis, part, rcond=None)
            off = (part - basis @ line) * math.sqrt(len(at) / (len(at) - 2))
            went = np.abs(line[0]) * (at[-1] - at[0])
            unmoved = (went < 3 * off.std(axis=0)).all()
            if unmoved and still is None:
                still = _still(run)
            if unmoved and still is not None and still[piece].all():
                left.append(off)
                k += size
            else:
                k += max(1, size // 10)
    if not left:
        return None
    residuals = np.concatenate(left)
    position, heading = np.sqrt(np.mean(residuals[:, :2] ** 2)), np.sqrt(np.mean(residuals[:, 2] ** 2))
    # Slow noise gives a stretch few independent samples.
    return Source(float(position), float(heading), 8 * len(left))


def _still(run: Run) -> np.ndarray:
    signals = [run.gait.signal(name) for name in run.gait.names]
    if not isinstance(run.gait, Gait):  # A speed or a command at rest may move the vehicle all the same.
        return np.zeros(run.times.shape[0], bool)
    rates = [np.asarray(jax.vmap(lambda t, s=s: s.at(t).rate)(jnp.asarray(run.times))) for s in signals]
    return np.max(np.abs(rates), axis=0) < STILL


def repeats(runs: Sequence[Run]) -> Source | None:
    """From runs of one gait: half the variance of what two of them, laid upon each other, differ by, beside a spline
    with knots every half second. Runs from the same place differ by noise alone, and need no spline but a straight
    line. None where no two runs are alike.
    """
    left, samples = [], 0
    for one, other in itertools.combinations(runs, 2):
        if one.moving or other.moving or not bool(eqx.tree_equal((one.gait, one.payload), (other.gait, other.payload))):
            continue
        if (off := _differ(one, other)) is not None:
            left.append(off)
            samples += len(off)
    if not left:
        return None
    position = np.concatenate([off[:, :2].reshape(-1) for off in left])
    heading = np.concatenate([off[:, 2] for off in left])
    return Source(_clipped_sd(position), _clipped_sd(heading), max(8, samples // 10))


def _differ(one: Run, other: Run) -> Float[np.ndarray, "n 3"] | None:
    """What two runs differ by, over sqrt(2), once the second is laid upon the first."""
    n = min(len(one.times), len(other.times))
    times = np.asarray(one.times)[:n]
    if not np.allclose(times, np.asarray(other.times)[:n], atol=1e-6):
        return None
    a, b = np.asarray(one.pose)[:n], np.asarray(other.pose)[:n]
    present = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if present.sum() < 5 * FEWEST:
        return None
    a, b, times = a[present], b[present], times[present]
    start = (a[:20] - b[:20]).mean(axis=0)
    start[2] -= 2 * np.pi * np.round(start[2] / (2 * np.pi))
    # The turn and shift that lay b on a: the heading says how far it is turned.
    turn = float(np.mean(a[:, 2] - b[:, 2]))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = np.column_stack([b[:, :2] @ rotation.T, b[:, 2] + turn])
    moved[:, :2] += (a - moved)[:, :2].mean(axis=0)
    off = a - moved
    alike = np.hypot(*start[:2]) < ALIKE[0] and abs(start[2]) < ALIKE[1]
    # A small turn left over moves the position in proportion to where it is.
    spin = np.column_stack([-(a - a.mean(axis=0))[:, 1], (a - a.mean(axis=0))[:, 0]])
    smooth = _smooth(times, None if alike else KNOTS)
    for k, extra in ((0, spin[:, 0]), (1, spin[:, 1]), (2, None)):
        basis = smooth if extra is None else np.column_stack([smooth, extra])
        fitted, *_ = np.linalg.lstsq(basis, off[:, k], rcond=None)
        off[:, k] = (off[:, k] - basis @ fitted) * math.sqrt(len(times) / (len(times) - basis.shape[1]))
    return off / math.sqrt(2)


def _smooth(times: Float[np.ndarray, " n"], knots: float | None) -> Float[np.ndarray, "n k"]:
    """A basis of straight lines, or of cubic splines with `knots` [s] between their knots."""
    from scipy.interpolate import BSpline

    if knots is None:
        return np.vander(times, 2)
    inner = np.linspace(times[0], times[-1], max(2, round((times[-1] - times[0]) / knots)) + 1)
    padded = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    basis = BSpline.design_matrix(times, padded, 3).toarray()
    return basis[:, (np.abs(basis) > 0.1).any(axis=0)]


def marker_noise(markers: Float[np.ndarray, "n m d"]) -> Noise:
    """The noise of the pose of a rigid body, from the motion of its `markers` [m] relative to each other.

    `markers`: n frames of m >= 3 markers with d = 2 or 3 coordinates; NaN where one was lost. Each frame is fitted to
    the mean shape by a rigid motion (least squares). The motion takes d (d + 1) / 2 degrees of freedom of each frame,
    and the shape d (m - 1) of all frames together. Let s be the standard deviation of one remaining coordinate. The
    standard deviation of the position is s / sqrt(m). That of the heading, the rotation about the third axis, is s
    times the square root of the last diagonal entry of the inverse of sum (r^2 1 - r r^T). An error common to all
    markers is not included.

    **Raises:** `InputError` for fewer than 3 markers or 10 frames with all of them.
    """
    markers = np.asarray(markers, np.float64)
    if markers.ndim != 3 or markers.shape[1] < 3 or markers.shape[2] not in (2, 3):
        what = f"Markers come as (frames, markers, 2 or 3), but these as {markers.shape}"
        raise InputError(what, "marker_noise", "give three markers or more")
    complete = markers[np.isfinite(markers).all(axis=(1, 2))]
    n, m, d = complete.shape
    if n < 10:
        raise InputError(f"Only {n} frames have all {m} markers", "marker_noise", "leave out markers often lost")
    centred = complete - complete.mean(axis=1, keepdims=True)
    shape = centred[0]
    for _ in range(20):
        laid = centred @ _turns(centred, shape)
        before, shape = shape, laid.mean(axis=0)
        if np.abs(shape - before).max() < 1e-12:
            break
    left = centred @ _turns(centred, shape) - shape
    freedom = n * (d * m - d * (d + 1) // 2) - d * (m - 1) + d * (d - 1) // 2
    sd = math.sqrt(float((left**2).sum()) / freedom)
    # Frames in which a marker was taken for another are no noise.
    each = np.sqrt((left**2).sum(axis=(1, 2)))
    if (good := each < CLIP * np.median(each)).sum() < n:
        return marker_noise(complete[good])
    squares = np.einsum("nmi,nmj->nij", centred, centred)
    size = np.trace(squares, axis1=1, axis2=2)
    about = size[:, None, None] * np.eye(d) - squares
    spread = 1 / size if d == 2 else np.linalg.pinv(about)[:, 2, 2]
    heading = sd * math.sqrt(float(spread.mean()))
    return Noise(np.asarray(sd / math.sqrt(m)), np.asarray(heading), "estimated from the markers")


def _turns(frames: Float[np.ndarray, "n m d"], shape: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n d d"]:
    """The rotations R for which frames @ R comes nearest to `shape` (Kabsch)."""
    return nearest_rotations(np.einsum("nmi,mj->nij", frames, shape)).transpose(0, 2, 1)
