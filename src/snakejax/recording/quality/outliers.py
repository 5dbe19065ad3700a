"""Frames off the board's path: teleports, frames out of order, other bodies, and clocks that jump."""

import numpy as np
from jaxtyping import Float, Int

from .finding import Finding, PoseSeries, finding
from .kinematics import LONG, end_of
from .timestamps import steady
from .tracklets import SURE, Chain, longest_chain

RUNNER_UP_SHARE = 0.6
"""Another body seen for this share of the board's frames may as well be the board."""
FEW = 3
"""So many frames off the path are a teleport, more another body."""
BRIEF = 0.08
"""Across four times this [s] the path can be interpolated."""
LATEST = 1.0
"""Clocks that jump by more than this [s] are not distinguished from other bodies."""
SHORTEST = 1.0
"""A run cut off at a jump of its clock is worth fitting from this length [s] on."""
UNLIKE = "such frames count as lost; window_s selects the good part of a run"


def jumps(track: PoseSeries) -> list[Finding]:
    """Frames that the board cannot have been at, by how it moves before and after; all of them may be masked."""
    present = steady(track.complete())
    if len(present.times) < 10:
        return []
    chain = longest_chain(present)
    if chain.kept.all():
        return []
    away = [group for group in _groups(chain.kept) if not _on_either_side(present, chain, group)]
    for group in away:
        if (clock_jump := _clock_jump(track, present, chain, group)) is not None:
            return [clock_jump, *jumps(track.without(clock_jump.frames))]
    return [_off_path(track, present, chain, group) for group in away]


def _off_path(track: PoseSeries, present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> Finding:
    """A group of frames beside the path, by how many they are and whether they lie on it at other times."""
    frames = np.flatnonzero(track.present)[group]
    size, unit = _distance(present, chain, group)
    where = f"{size:.3g} {unit} off the path at {track.times[frames[0]]:.2f} s"
    action, severity = "mask", "doubtful"
    if group.size <= FEW:
        kind, what = "teleport", f"{'one frame lies' if group.size == 1 else f'{group.size} frames lie'} {where}"
    elif _reordered(present, chain, group):
        kind, what = "reordered", f"{group.size} frames from {track.times[frames[0]]:.2f} s on are not in their order"
    else:
        kind, what = "swap", f"{group.size} frames lie {where}, as if the cameras followed another body"
        # What goes on where a clock that jumped might have left it would be late for the gait.
        late = group[0] == 0 and _within(present, chain, group)
        if late or chain.rival > RUNNER_UP_SHARE:
            action, severity = "none", "refused"
            what += "; it is not clear which is the board"
    return finding(kind, track, frames, what, UNLIKE, size=size, unit=unit, action=action, severity=severity)


def _groups(kept: np.ndarray) -> list[Int[np.ndarray, " k"]]:
    off = np.flatnonzero(~kept)
    return np.split(off, np.flatnonzero(np.diff(off) > 1) + 1)


def _around(chain: Chain, group: Int[np.ndarray, " k"]) -> tuple[Int[np.ndarray, " b"], Int[np.ndarray, " a"]]:
    """The frames of the board before and after `group`."""
    kept = np.flatnonzero(chain.kept)
    return kept[kept < group[0]], kept[kept > group[-1]]


def _on_either_side(present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> bool:
    """Whether few frames go on as the board moved before, or come from where it moves after: it changed its speed or
    yaw rate at once, and is on its path."""
    before, after = _around(chain, group)
    if group.size > FEW or not before.size or not after.size:
        return False
    ways = []
    for frames, last in ((before, True), (after, False)):
        end = end_of(present, chain.bounds.noise, frames, last)
        late = (present.times[group] - end.time)[:, None]
        sd = end.noise * np.sqrt(end.place_variance + 1 + late**2 * end.speed_variance)
        swerve = chain.bounds.acceleration * late**2 / 2
        ways.append((np.abs(present.pose[group] - end.place - late * end.speed) - swerve) / np.maximum(sd, 1e-12))
    return bool((np.minimum(*ways) < SURE).all())


def _within(present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> bool:
    """Whether the board gets from the last frame of `group` to the next in `LATEST`."""
    displacement = np.abs(present.pose[group[-1] + 1] - present.pose[group[-1]])
    return bool((displacement[:2] <= LATEST * chain.bounds.speed[:2]).all())


def _path_between(present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    """Where the board was meanwhile: the cubic from how it left to how it came back, or its nearest place."""
    before, after = _around(chain, group)
    times = present.times[group]
    if not before.size or not after.size:
        nearest = present.pose[before[-1] if before.size else after[0]]
        return np.broadcast_to(nearest, (group.size, 3))
    a, b = end_of(present, chain.bounds.noise, before, True), end_of(present, chain.bounds.noise, after, False)
    tau = b.time - a.time
    s = ((times - a.time) / tau)[:, None]
    bend_ = s**2 * (3 - 2 * s)
    # Beyond a second the speeds at the ends say nothing of what lies between.
    ease = tau if tau < 1.0 else 0.0
    turn = ease * (s * (1 - s) ** 2 * a.speed - s**2 * (1 - s) * b.speed)
    return (1 - bend_) * a.place + bend_ * b.place + turn


def _distance(present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> tuple[float, str]:
    off = present.pose[group] - _path_between(present, chain, group)
    noise = np.maximum(np.median(chain.bounds.noise, axis=0), 1e-12)
    far, turned = float(np.linalg.norm(off[:, :2], axis=1).max()), float(np.abs(off[:, 2]).max())
    return (far, "m") if far / np.hypot(*noise[:2]) > turned / noise[2] else (turned, "rad")


def _reordered(present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> bool:
    """Whether the frames of `group` lie on the path between what was kept around them, at other times."""
    kept = np.flatnonzero(chain.kept)
    if not (kept[0] < group[0] and group[-1] < kept[-1]):
        return False
    span = present.times[group[-1]] - present.times[group[0]]
    if span > 0.5:
        return False
    path = _path_between(present, chain, group)
    noise = np.maximum(np.median(chain.bounds.noise, axis=0), 1e-12)
    reach = SURE * noise + chain.bounds.acceleration * span**2 / 16
    apart = np.abs(present.pose[group][:, None] - path[None]) / reach
    nearest = apart.max(axis=2).argmin(axis=1)
    off, put_right = (np.abs(present.pose[group] - places).sum(axis=0) for places in (path, path[nearest]))
    return bool((apart.max(axis=2).min(axis=1) < 1).all() and (put_right[:2].sum() < off[:2].sum() / 3))


def _clock_jump(track: PoseSeries, present: PoseSeries, chain: Chain, group: Int[np.ndarray, " k"]) -> Finding | None:
    """A step at one end of `group`, up to where the run ends or begins, that is the way of some time T."""
    last = len(present.times) - 1
    if group[0] > 0 and group[-1] == last:
        before, after = np.flatnonzero(chain.kept[: group[0]]), group
    elif group[0] == 0 and group[-1] < last:
        before, after = group, group[-1] + 1 + np.flatnonzero(chain.kept[group[-1] + 1 :])
    else:
        return None
    if before.size < 4 or after.size < 4:
        return None
    noise = chain.bounds.noise
    a, b = end_of(present, noise, before, True), end_of(present, noise, after, False)
    tau = float(b.time - a.time)
    if tau > LATEST / 4:
        return None
    speed, displacement = (a.speed + b.speed) / 2, b.place - a.place
    sd = np.maximum(np.maximum(a.noise, b.noise), 1e-12)
    spread = a.place_variance + b.place_variance + tau**2 * (a.speed_variance + b.speed_variance) / 4
    weight = 1 / (sd**2 * spread)
    T = float((weight * speed * (displacement - tau * speed)).sum() / (weight * speed**2).sum())
    apart = np.abs(displacement - (tau + T) * speed)
    reach = chain.bounds.acceleration * (tau + abs(T)) ** 2 / 4
    noisy = SURE * sd * np.sqrt(spread + T**2 * (a.speed_variance + b.speed_variance) / 4)
    explains = (np.abs(displacement - tau * speed) > 2 * (apart + 0.5 * noisy)).any()
    if not ((apart <= reach + noisy).all() and explains and abs(T) <= LATEST):
        return None
    frames = np.flatnonzero(track.present)
    around = np.abs(present.times - b.time) < 2 * abs(T) + 2.5 * chain.bounds.frame
    if abs(T) < BRIEF and abs(_lag(present, np.flatnonzero(around))) < abs(T) / 2:
        what = f"{around.sum()} frames from {present.times[around][0]:.2f} s on are not in their order"
        size = float(np.hypot(*(T * speed[:2])))
        return finding("reordered", track, frames[around], what, UNLIKE, size=size, unit="m", action="mask")
    frames = frames[after[0] :]
    short = track.times[frames[0]] - track.times[0] < SHORTEST
    ahead = "frames are missing" if T > 0 else "there are too many frames"
    what = f"the clock jumps by {1e3 * T:.3g} ms at {track.times[frames[0]]:.2f} s, as if {ahead} there"
    remedy = "later frames no longer match the gait and are masked; split the file into two parts"
    return finding(
        "clock_jump",
        track,
        frames,
        what,
        remedy,
        size=abs(T),
        unit="s",
        action="none" if short else "mask",
        severity="refused" if short else "doubtful",
    )


def _lag(present: PoseSeries, frames: Int[np.ndarray, " k"]) -> float:
    """By what time [s] the motion after `frames` is ahead of that before them.

    Of parabolas through 17 frames on either side, the way between them is tau (v + v') / 2 - tau^2 (b' - b) / 6 for
    speeds v and half accelerations b, up to the fifth power of tau.
    """
    if frames[0] < LONG or frames[-1] + LONG >= len(present.times):
        return np.inf
    before, after = np.arange(frames[0] - LONG, frames[0]), np.arange(frames[-1] + 1, frames[-1] + 1 + LONG)
    sides = []
    for side, end in ((before, -1), (after, 0)):
        at = present.times[side] - present.times[side[end]]
        sides.append(np.linalg.lstsq(np.vander(at, 3, increasing=True), present.pose[side], rcond=None)[0])
    (p, v, b), (p_, v_, b_) = sides
    tau = present.times[after[0]] - present.times[before[-1]]
    off = (p_ - p - tau * (v + v_) / 2 + tau**2 * (b_ - b) / 6)[:2]
    mean = ((v + v_) / 2)[:2]
    return float(off @ mean / (mean @ mean))
