"""Stamps: when the frames were taken, and when their clock says they were."""

import numpy as np

from .finding import Finding, PoseSeries, finding
from .kinematics import third_difference

STRAY = 0.05
"""Time stamps that deviate by this share of a frame are reported."""
BETTER = 0.8
"""The constant frame rate is taken if the third differences of one channel fall to this share, and rise in none."""
LONG = 5.0
"""A pause between two stamps of so many frames is one in which the clock may have jumped."""


def steady(track: PoseSeries) -> PoseSeries:
    """`track`, all of whose frames were seen, with the stamps of a steady beat where the path is the smoother for it.

    Cameras take frames at a beat; a stamp given where they arrive strays from it.
    """
    steps = np.diff(track.times)
    frame = float(np.median(steps))
    if len(track.times) < 20 or np.abs(steps / frame - np.round(steps / frame)).max() < 1e-3:
        return track
    k = np.arange(len(track.times), dtype=float)
    if steps.max() > 2.5 * frame:
        k = np.cumsum(np.concatenate([[0.0], np.maximum(1.0, np.round(steps / frame))]))
    rate = np.median(track.times[len(k) // 2 :] - track.times[: len(k) - len(k) // 2]) / np.median(
        k[len(k) // 2 :] - k[: len(k) - len(k) // 2]
    )
    beat = track.times[0] + np.median(track.times - track.times[0] - k * rate) + k * rate
    stamped, beaten = (
        np.quantile(np.abs(third_difference(times, track.pose)), 0.99, axis=0) for times in (track.times, beat)
    )
    return track._replace(times=beat) if (beaten <= BETTER * stamped).any() and (beaten <= stamped).all() else track


def stray(track: PoseSeries) -> list[Finding]:
    """Stamps that do not go with the beat of the frames, though the poses do."""
    present = track.complete()
    off = present.times - steady(present).times
    if not np.abs(off).max() > STRAY * np.median(np.diff(track.times)):
        return []
    worst = float(np.abs(off).max())
    what = f"time stamps deviate by up to {1e3 * worst:.2g} ms from a constant frame rate"
    remedy = "compute the time stamps as frame number over frame rate"
    frames = np.flatnonzero(track.present)[np.abs(off) > STRAY * np.median(np.diff(track.times))]
    return [finding("stray_stamps", track, frames, what, remedy, size=worst, unit="s")]


def backward(track: PoseSeries) -> list[Finding]:
    """Stamps that stand still or run backwards."""
    wrong = np.flatnonzero(~(np.diff(track.times) > 0)) + 1
    if not wrong.size:
        return []
    size = float(-np.diff(track.times).min())
    what = f"{wrong.size} time stamps do not increase, by up to {size:.3g} s"
    remedy = "sort the rows by time and keep one row for each"
    return [finding("clock_backward", track, wrong, what, remedy, size=size, unit="s", severity="refused")]
