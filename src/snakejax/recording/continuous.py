"""Parts of a recording without a gap and without a jump, and windows of them chosen by what happens there."""

import itertools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

LONGEST_GAP = 0.1
"""Frames further apart [s] than this, and than three usual ones, are not of one part."""
FASTEST, JITTER = 15.0, 0.05
"""A part ends where the vehicle would have moved faster than this [m/s], beyond an error of this size [m]."""
LEAST_MOTION = 0.1
"""Speed [m/s] below which a vehicle stands; its yaw rate counts as the speed at `LEVER` [m]."""
LEVER = 0.2
SPEED_CLASSES = 3
"""Length [m] that turns a yaw rate into a speed, half that of a small vehicle; and the number of classes of speed."""


def continuous_parts(times: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]) -> list[np.ndarray]:
    """The numbers of the measured frames of each part without a gap or a jump."""
    measured = np.flatnonzero(np.isfinite(pose).all(axis=1))
    if not measured.size:
        return []
    dt = np.diff(times[measured])
    step = np.hypot(*np.diff(pose[measured, :2], axis=0).T)
    usual = float(np.median(dt)) if dt.size else 0.0
    ends = (dt > max(LONGEST_GAP, 3 * usual)) | (step > FASTEST * dt + JITTER)
    return np.split(measured, np.flatnonzero(ends) + 1)


def jumps(times: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]) -> list[float]:
    """The times [s] at which a recording jumps."""
    parts = continuous_parts(times, pose)
    jump_times = []
    for earlier, later in itertools.pairwise(parts):
        a, b = earlier[-1], later[0]
        if np.hypot(*(pose[b, :2] - pose[a, :2])) > FASTEST * (times[b] - times[a]) + JITTER:
            jump_times.append(float(times[b]))
    return jump_times


def mean_speed(times: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]) -> float:
    """The mean speed [m/s] by the path of ten pieces, plus `LEVER` times the mean yaw rate."""
    k = np.unique(np.linspace(0, len(times) - 1, 11).astype(int))
    steps = np.diff(pose[k], axis=0)
    path = np.hypot(steps[:, 0], steps[:, 1]).sum() + LEVER * np.abs(steps[:, 2]).sum()
    return float(path / max(times[k[-1]] - times[k[0]], 1e-9))


def chosen_windows(
    times: Float[np.ndarray, " n"],
    pose: Float[np.ndarray, "n 3"],
    inputs: tuple[Float[np.ndarray, " m"], Mapping[str, Float[np.ndarray, " m"]]],
    length: float,
    most: int,
) -> list[np.ndarray]:
    """Frames of at most `most` windows of `length` [s] that do not overlap, from all parts in which the vehicle moves.

    They are spread over classes by content: `SPEED_CLASSES` of speed, each with steady and with varying `inputs`
    (times (m,) and values by name), and within a class over the recording.
    """
    windows = [w for part in continuous_parts(times, pose) for w in _tiled(times, part, length)]
    windows = [w for w in windows if mean_speed(times[w], pose[w]) > LEAST_MOTION]
    if len(windows) <= most:
        return windows
    speed = np.array([mean_speed(times[w], pose[w]) for w in windows])
    change = np.array([_change(times[w], *inputs) for w in windows])
    order = np.argsort(np.argsort(speed, kind="stable"), kind="stable")
    classes = 2 * (order * SPEED_CLASSES // len(windows)) + (change > np.median(change))
    waiting = [_spread(np.flatnonzero(classes == c)) for c in range(2 * SPEED_CLASSES)]
    taken: list[int] = []
    while len(taken) < most:
        for one in waiting:
            if one and len(taken) < most:
                taken.append(one.pop(0))
    return [windows[k] for k in sorted(taken)]


def _tiled(times: np.ndarray, part: np.ndarray, length: float) -> list[np.ndarray]:
    first, last = times[part[0]], times[part[-1]]
    starts = first + length * np.arange(int((last - first) / length + 1e-6))
    return [part[(times[part] >= s - 1e-9) & (times[part] <= s + length + 1e-9)] for s in starts]


def _change(times: np.ndarray, at: np.ndarray, values: Mapping[str, np.ndarray]) -> float:
    """How far the inputs range within a window, in standard deviations of the whole recording."""
    inside = (at >= times[0]) & (at <= times[-1])
    return float(sum(np.ptp(v[inside]) / max(float(v.std()), 1e-9) for v in values.values() if inside.any()))


def _spread(numbers: np.ndarray) -> list[int]:
    """`numbers` in an order of which every beginning is spread over all of them (van der Corput)."""
    size = len(numbers)
    bits = max(size - 1, 1).bit_length()
    reverse = sorted(range(1 << bits), key=lambda k: int(f"{k:0{bits}b}"[::-1], 2))
    return [int(numbers[k]) for k in reverse if k < size]
