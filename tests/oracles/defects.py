"""Clean recordings spoiled in one way each, at a stated size, and where: the truth that the detectors are held to."""

from typing import NamedTuple

import numpy as np

from snakejax.recording.quality import PoseSeries


class Spoiled(NamedTuple):
    """A track with a defect; `frames`, those that hold it; the `kinds` of finding that name it (none: the recording
    is not one that can have it).
    """

    track: PoseSeries
    frames: np.ndarray
    kinds: tuple[str, ...]


def _middle(track, length, rng):
    """The first of `length` frames somewhere between a tenth and nine tenths of the run."""
    n = len(track.times)
    return int(rng.integers(n // 10, max(n // 10 + 1, 9 * n // 10 - length)))


def _with(track, pose):
    return track._replace(pose=pose)


def _seen(track, frames):
    return frames[track.present[frames]]


def teleport(track, size, rng):
    """One frame `size` [m] off the path, in any direction."""
    pose, k = track.pose.copy(), _middle(track, 1, rng)
    while not track.present[k]:
        k = _middle(track, 1, rng)
    turn = rng.uniform(0, 2 * np.pi)
    pose[k, :2] += size * np.array([np.cos(turn), np.sin(turn)])
    return Spoiled(_with(track, pose), np.array([k]), ("teleport", "reordered"))


def teleports(track, size, rng):
    """Twenty of them."""
    pose, frames = track.pose.copy(), np.sort(rng.choice(np.flatnonzero(track.present)[5:-5], 20, replace=False))
    turn = rng.uniform(0, 2 * np.pi, 20)
    pose[frames, :2] += size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Spoiled(_with(track, pose), frames, ("teleport", "swap", "reordered"))


def wild_heading(track, size, rng):
    """One heading `size` [rad] off."""
    pose = track.pose.copy()
    k = int(rng.choice(np.flatnonzero(track.present)[5:-5]))
    pose[k, 2] += size * rng.choice([-1, 1])
    return Spoiled(_with(track, pose), np.array([k]), ("teleport",))


def swap(track, size, rng, frames=40):
    """Another body, at rest half a metre off, followed for `size` frames."""
    pose, length = track.pose.copy(), int(size)
    k = _middle(track, length, rng)
    turn = rng.uniform(0, 2 * np.pi)
    away = np.array([0.5 * np.cos(turn), 0.5 * np.sin(turn), rng.uniform(-1, 1)])
    place = np.nanmean(pose[k : k + 20], axis=0) + away
    noise = np.array([4e-4, 4e-4, 2.5e-3])
    pose[k : k + length] = place + rng.normal(size=(length, 3)) * noise
    return Spoiled(_with(track, pose), np.arange(k, k + length), ("swap",))


def near_swap(track, size, rng):
    """Another body that goes beside the board, `size` [m] off, followed for 50 frames."""
    pose, k = track.pose.copy(), _middle(track, 50, rng)
    turn = rng.uniform(0, 2 * np.pi)
    pose[k : k + 50, :2] += size * np.array([np.cos(turn), np.sin(turn)])
    frames = np.arange(k, k + 50)
    return Spoiled(_with(track, pose), _seen(track, frames), ("swap",))


def frozen(track, size, rng):
    """A pose held for `size` frames more."""
    pose, length = track.pose.copy(), int(size)
    k = _middle(track, length, rng)
    while not track.present[k]:
        k = _middle(track, length, rng)
    pose[k : k + length + 1] = pose[k]
    return Spoiled(_with(track, pose), np.arange(k + 1, k + length + 1), ("frozen", "duplicate"))


def reordered(track, size, rng):
    """Two neighbouring blocks of frames, as long that the board goes `size` [m] in one, in the wrong order."""
    pose = track.pose.copy()
    for _ in range(1000):
        k = _middle(track, 60, rng)
        way = np.linalg.norm(pose[k : k + 30, :2] - pose[k, :2], axis=1)
        far = np.flatnonzero(way > size)
        if far.size and np.isfinite(pose[k : k + 2 * far[0]]).all():
            break
    else:
        return Spoiled(track, np.zeros(0, int), ())
    length = int(far[0])
    frames = np.arange(k, k + 2 * length)
    pose[frames] = np.concatenate([pose[frames[length:]], pose[frames[:length]]])
    return Spoiled(_with(track, pose), frames, ("reordered", "teleport", "swap", "clock_jump"))


def clock_jump(track, size, rng):
    """Frames left out without a trace, in which the board goes `size` [m]."""
    pose, n = track.pose, len(track.times)
    for _ in range(1000):
        k = int(rng.integers(n // 4, 3 * n // 4))
        way = np.linalg.norm(pose[k : k + 100, :2] - pose[k, :2], axis=1)
        far = np.flatnonzero(way > size)
        if far.size:
            break
    else:
        return Spoiled(track, np.zeros(0, int), ())
    short = np.concatenate([pose[:k], pose[k + far[0] :]])
    frames = np.arange(k, len(short))
    return Spoiled(PoseSeries(track.times[: len(short)], short, track.moving), frames, ("clock_jump", "swap"))


def flip(track, size, rng):
    """`size` headings turned by pi."""
    pose, length = track.pose.copy(), int(size)
    k = _middle(track, length, rng)
    frames = np.arange(k, k + length)
    pose[frames, 2] += np.pi * rng.choice([-1, 1])
    return Spoiled(_with(track, pose), _seen(track, frames), ("flipped_heading",))


def jitter(track, size, rng):
    """A second in which the noise is `size` times as large."""
    pose, k = track.pose.copy(), _middle(track, 100, rng)
    extra = np.sqrt(size**2 - 1) * np.array([4e-4, 4e-4, 2.5e-3])
    pose[k : k + 100] += rng.normal(size=(100, 3)) * extra
    return Spoiled(_with(track, pose), np.arange(k, k + 100), ("jitter",))


def stray(track, size, rng):
    """Stamps that stray from the beat of the frames by `size` [s]."""
    times = track.times + size * rng.normal(size=len(track.times))
    times = np.maximum.accumulate(times) + 1e-9 * np.arange(len(times))
    return Spoiled(track._replace(times=times - times[0]), np.arange(len(times)), ("stray_stamps",))


def length_unit(track, size, rng):
    """Lengths `size` times too large."""
    del rng
    return Spoiled(_with(track, track.pose * [size, size, 1.0]), np.flatnonzero(track.present), ("units",))


def angle_unit(track, size, rng):
    """Angles `size` times too large."""
    del rng
    return Spoiled(_with(track, track.pose * [1.0, 1.0, size]), np.flatnonzero(track.present), ("units",))


def up_axis(track, size, rng):
    """The floor seen from the side: a height for y, and a heading that is only noise."""
    noise = size * rng.normal(size=(len(track.times), 2)) * [4e-4, 2.5e-3]
    pose = np.column_stack([track.pose[:, 0], 0.06 + noise[:, 0], noise[:, 1]])
    return Spoiled(_with(track, np.where(track.present[:, None], pose, np.nan)), np.arange(3), ("up_axis",))


def late(track, size, rng):
    """A recording that begins where the board already moves at `size` [m/s] or more."""
    del rng
    seen = np.where(np.isfinite(track.pose), track.pose, 0)
    box = 15
    speed = np.linalg.norm(seen[box:, :2] - seen[:-box, :2], axis=1) / (track.times[box] - track.times[0])
    whole = np.array([track.present[k : k + 25].all() for k in range(len(speed))])
    fast = np.flatnonzero((speed > size) & whole)
    if not fast.size:
        return Spoiled(track, np.zeros(0, int), ())
    k = int(fast[0])
    return Spoiled(
        PoseSeries(track.times[: len(track.times) - k], track.pose[k:], False), np.arange(3), ("not_at_rest",)
    )


def gap(track, size, rng):
    """`size` [s] without a frame."""
    length = round(size / float(np.median(np.diff(track.times))))
    k = _middle(track, length, rng)
    return Spoiled(track.without(np.arange(k, k + length)), np.arange(k, k + length), ("gap",))
