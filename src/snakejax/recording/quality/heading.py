"""Headings turned by half a turn or by whole ones, and those of which it is not clear which way they turned."""

import numpy as np

from .finding import Finding, PoseSeries, finding
from .kinematics import local_scale, third_difference
from .timestamps import steady

NEAR_PI = 0.8 * np.pi
NEAR = 0.6
"""A step of the heading this near [rad] to a multiple of pi, and not to 0, is one of the axis, not of the board."""
SOON = 0.1
"""Between frames this near in time [s] the board itself does not turn half a turn."""
FAR = 0.02
"""Beside noise, how far [m] the board may go from one frame to the next."""
MINORITY = 1 / 3
"""Turned headings in a greater share of the frames than this may as well be the right ones."""


def _turns(track: PoseSeries) -> np.ndarray:
    """By how many times pi each seen heading is turned, as seen from the greater part of them."""
    present = steady(track.complete())
    steps, soon = np.diff(present.pose[:, 2]), np.diff(present.times) <= SOON
    halves = np.round(steps / np.pi)
    halves = np.where(soon & (np.abs(steps - halves * np.pi) < NEAR), halves, 0.0)
    if not halves.any():
        return np.zeros(len(present.times))
    # Where the position jumps as well, another body came into view, and its heading is none of the board's.
    noise = local_scale(third_difference(present.times, present.pose))
    far = np.abs(np.diff(present.pose[:, :2], axis=0)) > 12 * noise[1:, :2] + FAR
    halves[far.any(axis=1)] = 0.0
    turned = np.concatenate([[0.0], np.cumsum(halves)])
    values, counts = np.unique(turned[turned % 2 == float((turned % 2).mean() > 0.5)], return_counts=True)
    return turned - values[counts.argmax()]


def flips(track: PoseSeries) -> list[Finding]:
    """Headings that jump by multiples of pi: the axis of the body taken for its opposite, or a turn not unwound."""
    turned = _turns(track)
    wrong = np.flatnonzero(turned)
    if not wrong.size:
        return []
    frames = np.flatnonzero(track.present)[wrong]
    count = int((turned % 2 != 0).sum())
    unclear = count > MINORITY * turned.size
    what = f"the heading of {count} frames is turned by pi" if count else "the heading jumps by whole turns"
    return [
        finding(
            "flipped_heading",
            track,
            frames,
            f"{what} from {track.times[frames[0]]:.2f} s on" + ("; it is not clear which are right" if unclear else ""),
            "name the part of the run that is right with window_s" if unclear else "the heading is corrected",
            size=float(np.pi * np.abs(turned).max()),
            unit="rad",
            action="none" if unclear else "turn",
            severity="refused" if unclear else "doubtful",
        )
    ]


def unflipped(track: PoseSeries) -> PoseSeries:
    """`track` with the headings turned by the multiples of pi that `flips` finds."""
    pose = track.pose.copy()
    pose[track.present, 2] -= np.pi * _turns(track)
    return track._replace(pose=pose)


def half_turns(track: PoseSeries) -> list[Finding]:
    """Turns by nearly pi or more across a gap, which may have been the other way round."""
    present = np.flatnonzero(track.present)
    turns = np.abs(np.diff(track.pose[present, 2]))
    far = np.flatnonzero(turns > NEAR_PI)[:1]
    if not far.size:
        return []
    k = int(far[0])
    at = f"at {track.times[present[k]]:.2f} s"
    what = f"{at} the heading turns by {turns[k]:.2f} rad across a gap: its direction is uncertain"
    remedy = "the smaller turn is assumed; window_s selects a part of the run without the gap"
    return [finding("half_turn", track, present[[k, k + 1]], what, remedy, size=float(turns[k]), unit="rad")]
