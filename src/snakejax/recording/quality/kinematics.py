"""How a body moves, from what was seen of it alone: its noise, and the bounds of its speed and acceleration."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .finding import PoseSeries

MAD_TO_SD = 1.4826
TAIL, LONG = 7, 17
"""Frames at the end of a stretch that say where it is and how fast: few for the next frame, more across a pause."""
BRIEF = 0.165
"""Within this time [s] a parabola is good for the way of a board."""
BLOCK = 60
"""Bends, one after the other, that show the noise where they are."""
LEAST_NOISE = np.array([1e-4, 1e-4, 1e-3])
"""Of x, y [m] and heading [rad]: cameras that see finer see wheels pass a grain of sand, and that is no defect."""
WINDOW = 0.12
"""Length [s] of the stretches whose quadratics show the body's speed and acceleration."""


def robust_sd(values: Float[np.ndarray, " n"]) -> float:
    """The standard deviation that the median absolute deviation of `values` has for a normal distribution."""
    return MAD_TO_SD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def third_difference(times: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n-3 c"]:
    """What four samples in a row show beside a parabola, in units of the noise of one sample.

    The combination sum_j c_j p_j with c_j = 1 / prod_{k != j} (t_j - t_k), the third divided difference, over
    sqrt(sum c_j^2): its standard deviation is that of one sample, and no parabola contributes, however spaced in time.
    """
    if len(times) < 4:
        return np.zeros((0, pose.shape[1]))
    four = np.lib.stride_tricks.sliding_window_view(times, 4)
    apart = four[:, :, None] - four[:, None, :]
    apart[:, range(4), range(4)] = np.median(np.diff(times))
    weights = 1 / np.prod(apart / np.median(np.diff(times)), axis=2)
    weights /= np.sqrt((weights**2).sum(axis=1, keepdims=True))
    n = len(times) - 3
    return np.sum([weights[:, j, None] * pose[j : j + n] for j in range(4)], axis=0)


def scale(bends: Float[np.ndarray, "m c"]) -> Float[np.ndarray, " c"]:
    """The noise of one sample in each channel, as far as `bends` show it; samples that repeat tell nothing."""
    return np.array([MAD_TO_SD * float(np.median(np.abs(b[b != 0]))) if (b != 0).any() else 0.0 for b in bends.T])


def local_scale(bends: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "m+3 c"]:
    """The noise of each of the m + 3 samples: that of `BLOCK` bends around it, and no less than that of all.

    Nor is it less than `LEAST_NOISE`. A body that shakes while it moves is noisier than the same body at rest.
    """
    blocks = max(1, len(bends) // BLOCK)
    each = np.array([MAD_TO_SD * np.median(np.abs(part), axis=0) for part in np.array_split(bends, blocks)])
    padded = np.pad(each, ((1, 1), (0, 0)), mode="edge")
    around = np.max([padded[:-2], each, padded[2:]], axis=0)
    which = np.minimum(np.arange(len(bends) + 3) * blocks // max(1, len(bends)), blocks - 1)
    return np.maximum(np.maximum(around[which], scale(bends)), LEAST_NOISE[: bends.shape[1]])


class Bounds(NamedTuple):
    """Of each sample the `noise` (n, c); of each channel (c,) the `speed` and the `acceleration` that the body does not
    exceed; and the usual time `frame` [s] from one frame to the next.
    """

    noise: Float[np.ndarray, "n c"]
    speed: Float[np.ndarray, " c"]
    acceleration: Float[np.ndarray, " c"]
    frame: float


def bounds(track: PoseSeries, noise: Float[np.ndarray, "n c"], breaks: Int[np.ndarray, " b"]) -> Bounds:
    """Twice what all but a hundredth of the stretches of `WINDOW` show that hold no break.

    `track` holds seen frames alone; a break k stands between its frames k and k + 1.
    """
    frame = float(np.median(np.diff(track.times)))
    size = max(6, round(WINDOW / frame))
    starts = np.arange(0, len(track.times) - size + 1, max(1, size // 2))
    broken = np.searchsorted(breaks, starts) < np.searchsorted(breaks, starts + size - 1)
    unbroken = starts[~broken]
    if not unbroken.size:
        steps = np.abs(np.diff(track.pose, axis=0)) / np.diff(track.times)[:, None]
        speed = 2 * np.median(steps, axis=0) + np.median(noise, axis=0) / frame
        return Bounds(noise, speed, speed / WINDOW, frame)
    rows = unbroken[:, None] + np.arange(size)
    t = track.times[rows] - track.times[rows].mean(axis=1, keepdims=True)
    basis = np.stack([np.ones_like(t), t, t**2], axis=-1)
    solved = np.linalg.pinv(basis) @ track.pose[rows]
    speed, acceleration = (np.quantile(np.abs(part), 0.99, axis=0) for part in (solved[:, 1], 2 * solved[:, 2]))
    usual = np.median(noise, axis=0)
    noise = np.hypot(noise, robust_sd(np.diff(track.times)) * speed)  # of stamps that stray
    # A body at rest may start at any time, with a speed that these frames cannot tell from noise.
    return Bounds(noise, 2 * speed + usual / WINDOW, 2 * acceleration + 2 * usual / WINDOW**2, frame)


class End(NamedTuple):
    """Where a stretch is and how fast, at one of its ends, or many side by side: `place` and `speed` (..., c), with
    variances for unit noise, and the `noise` there; `known` is whether its frames show the speed at all, `long` whether
    the stretch has `LONG` frames.
    """

    time: np.ndarray
    place: Float[np.ndarray, "... c"]
    speed: Float[np.ndarray, "... c"]
    place_variance: np.ndarray
    speed_variance: np.ndarray
    noise: Float[np.ndarray, "... c"]
    known: np.ndarray
    long: np.ndarray


def end_of(
    track: PoseSeries, noise: Float[np.ndarray, "n c"], frames: Int[np.ndarray, " k"], last: bool, most: int = LONG
) -> End:
    """The end of the stretch `frames` (its beginning, unless `last`): of a parabola through the `most` nearest."""
    near = frames[-most:] if last else frames[:most]
    end = track.times[near[-1] if last else near[0]]
    soon = np.abs(track.times[near] - end) <= BRIEF
    near = near[soon] if soon.sum() >= 4 else near[-4:] if last else near[:4]
    at = track.times[near[-1] if last else near[0]]
    if near.size == 1:
        place, speed, variances = track.pose[near[0]], np.zeros(track.pose.shape[1]), np.array([1.0, 0.0])
    else:
        inverse = np.linalg.pinv(np.vander(track.times[near] - at, min(3, near.size), increasing=True))
        place, speed = (inverse @ track.pose[near])[:2]
        variances = (inverse[:2] ** 2).sum(axis=1)
    sure = (
        variances[0],
        variances[1],
        noise[near].max(axis=0),
        np.asarray(near.size > 1),
        np.asarray(frames.size >= LONG),
    )
    return End(np.asarray(at), place, speed, *sure)
