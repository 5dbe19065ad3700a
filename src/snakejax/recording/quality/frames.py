"""Frames that are not there, or are there more than once."""

import numpy as np

from .finding import Finding, PoseSeries, finding

LOST_SHARE = 0.2
LONG_GAP = 0.5
LATE_START = 0.1
FROZEN_FRAMES = 4
FEWEST = 20
"""A run in which fewer frames than these differ from the one before holds no motion."""
HELD = "a frame that repeats the one before was not measured: it counts as lost"


def gaps(track: PoseSeries) -> list[Finding]:
    """Lost frames: a late first one, a large share, a long gap."""
    present, times = np.flatnonzero(track.present), track.times
    findings = []
    if (late := times[present[0]] - (times[0] if track.moving else 0.0)) > LATE_START:
        what = f"the first sample comes {late:.2f} s after the start"
        findings.append(
            finding(
                "late_start", track, present[:1], what, "begin to record before the start", size=float(late), unit="s"
            )
        )
    share = 1 - present.size / (times.size - present[0])
    if share > LOST_SHARE:
        lost = np.flatnonzero(~track.present)
        what = f"{share:.0%} of the frames are lost"
        findings.append(finding("lost_frames", track, lost, what, "lost frames do not count", size=float(share)))
    if present.size > 1:
        steps = np.diff(times[present])
        k = int(steps.argmax())
        if steps[k] > LONG_GAP:
            what = f"a gap of {steps[k]:.2f} s at {times[present[k]]:.2f} s"
            frames = present[[k, k + 1]]
            findings.append(
                finding("gap", track, frames, what, "lost frames do not count", size=float(steps[k]), unit="s")
            )
    return findings


def frozen(track: PoseSeries) -> list[Finding]:
    """Frames that repeat the pose before them to the last digit, which no measurement with noise does."""
    same = (track.pose[1:] == track.pose[:-1]).all(axis=1)
    if _coarse(track):
        same = _in_a_row(same, FROZEN_FRAMES - 1)
    if not same.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, lengths = edges[::2], edges[1::2] - edges[::2] + 1
    frames, longest = np.flatnonzero(same) + 1, int(lengths.argmax())
    still = int(track.present.sum()) - frames.size < FEWEST
    count = int(lengths[longest])
    if count >= FROZEN_FRAMES:
        kind = "frozen"
        where = f"{count} frames at {track.times[starts[longest]]:.2f} s"
        what = f"the pose is frozen for {where} ({same.sum()} repeats in all)"
    else:
        kind, what = "duplicate", f"{same.sum()} frames repeat the pose before them"
    remedy = "the recording holds no motion: leave the run out" if still else HELD
    return [
        finding(
            kind,
            track,
            frames,
            what,
            remedy,
            size=float(count),
            unit="frames",
            action="none" if still else "mask",
            severity="refused" if still else "doubtful",
        )
    ]


def _coarse(track: PoseSeries) -> bool:
    """Whether the digits are so few that poses repeat by chance: once in twenty such runs, or more often."""
    steps = np.abs(np.diff(track.complete().pose, axis=0))
    if not (steps > 0).any(axis=0).all():
        return False
    least = np.array([column[column > 0].min() for column in steps.T])
    usual = np.maximum(np.median(steps, axis=0), least)
    return bool(np.prod(np.minimum(1.0, least / (2 * usual))) * len(steps) > 0.05)


def _in_a_row(flags: np.ndarray, fewest: int) -> np.ndarray:
    """Those of `flags` that stand with at least `fewest` in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    kept = np.zeros(flags.size, bool)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        kept[a:b] = b - a >= fewest
    return kept


def copied(track: PoseSeries) -> list[Finding]:
    """Poses that occur again elsewhere in the run, several in a row."""
    present = np.flatnonzero(track.present)
    poses = track.pose[present]
    apart = np.concatenate([[True], (poses[1:] != poses[:-1]).any(axis=1)])
    poses, present = poses[apart], present[apart]
    _, first = np.unique(poses, axis=0, return_index=True)
    new = np.zeros(len(poses), bool)
    new[first] = True
    again = np.flatnonzero(_in_a_row(~new, FROZEN_FRAMES))
    if not again.size:
        return []
    what = f"{again.size} poses occur again elsewhere in the run, as if copied"
    return [
        finding("copied", track, present[again], what, "export the file again", size=float(again.size), unit="frames")
    ]
