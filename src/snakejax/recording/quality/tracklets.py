"""The longest chain of stretches that one body can have gone through.

Where frames are off the path, or the cameras follow another body for a while, what was seen falls into stretches. Two
of them can be of one body if it can get from the end of one to the beginning of the other in time, with the speed and
acceleration seen elsewhere in the run. Stretches shortly after each other that meet so are joined first, one body each;
of all chains of bodies, one after the other, that can be one body the longest is the board.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .finding import PoseSeries
from .kinematics import LONG, TAIL, Bounds, End, bounds, end_of, local_scale, third_difference

FLAG = 5.0
"""A bend this many standard deviations large may be a break: the ways between stretches then tell."""
SURE = 7.0
"""Ends that miss each other by this many standard deviations are not of one body."""
SKIP = 3.5
"""A pause of this many frames may hide a break."""
STRAYS = 4
"""So many frames may stray before a body is seen again where it was going."""
PAUSE = 0.15
"""After so long [s] a heading is known but for whole turns, and only the position tells of another body."""
BY_CHANCE = 0.01
"""Two bodies hardly meet by chance where the way may swerve by this share of the room in which they move."""


class Chain(NamedTuple):
    """`kept` (n,): which of the seen frames are of the board; `rival`: how many frames the next best chain has that
    shares none of them, as a share of theirs.
    """

    kept: Bool[np.ndarray, " n"]
    bounds: Bounds
    rival: float


def stretches(track: PoseSeries) -> tuple[list[Int[np.ndarray, " k"]], Bounds]:
    """The frames of `track`, all of them seen, in stretches between possible breaks."""
    bends = third_difference(track.times, track.pose)
    noise = local_scale(bends)
    flagged = np.flatnonzero((np.abs(bends) > FLAG * noise[1:-2]).any(axis=1))
    pauses = np.flatnonzero(np.diff(track.times) > SKIP * np.median(np.diff(track.times)))
    breaks = np.unique(np.concatenate([flagged, flagged + 1, flagged + 2, pauses]))
    return np.split(np.arange(len(track.times)), breaks + 1), bounds(track, noise, breaks)


def miss(before: End, after: End, limits: Bounds) -> Float[np.ndarray, "..."]:
    """By how many standard deviations the way from `before` to `after` is too far for one body; 0 where it is not.

    With speeds v at both ends and an acceleration within a, p_after - p_before - tau (v_before + v_after) / 2 stays
    within a tau^2 / 4; with one speed known, p_after - p_before - tau v within a tau^2 / 2; and the whole way within
    the greatest speed times tau. A stamp may be off by as much as it is off the beat of the frames.

    From one frame to the next the heading of long stretches that meet in the plane only stays within the greatest yaw
    rate times tau: a wheel that is turned at once changes the yaw rate at once, and another body would be elsewhere.
    """
    tau = np.asarray(after.time - before.time)
    late = np.abs(tau - limits.frame * np.maximum(1, np.round(tau / limits.frame)))[..., None] * limits.speed
    both, either = before.known & after.known, before.known | after.known
    half_before, half_after = (np.where(both, 0.5, np.where(end.known, 1.0, 0.0)) for end in (before, after))
    displacement = after.place - before.place
    mean = half_before[..., None] * before.speed + half_after[..., None] * after.speed
    swerve = np.where(both, 0.25, 0.5)[..., None] * limits.acceleration * tau[..., None] ** 2
    reach = np.where(either[..., None], swerve, limits.speed * tau[..., None])
    variance = before.place_variance + after.place_variance
    drift = half_before**2 * before.speed_variance + half_after**2 * after.speed_variance
    sd = np.maximum(np.maximum(before.noise, after.noise), 1e-12)
    bent = (np.abs(displacement - mean * tau[..., None]) - reach - late) / (
        sd * np.sqrt(variance + tau**2 * drift)[..., None]
    )
    far = (np.abs(displacement) - limits.speed * tau[..., None] - late) / (sd * np.sqrt(variance)[..., None])
    worst = np.maximum(bent, far)
    at_once = (tau < 1.5 * limits.frame) & before.long & after.long
    worst[..., 2] = np.where(at_once, far[..., 2], worst[..., 2])
    # Across a pause the heading may have turned either way.
    worst[..., 2] = np.where(tau > PAUSE, 0.0, worst[..., 2])
    return np.maximum(0.0, worst.max(axis=-1))


class _Body:
    """The stretches of one body as they come; `size`, how many frames they have."""

    def __init__(self, piece: Int[np.ndarray, " k"]) -> None:
        self.pieces, self.size = [piece], piece.size

    def tail(self, less: int) -> Int[np.ndarray, " k"]:
        """Its last frames, less those of the last `less` stretches."""
        taken = self.pieces[len(self.pieces) - less - 1 :: -1][:LONG] if less < len(self.pieces) else []
        return np.concatenate(taken[::-1])[-LONG:] if taken else np.zeros(0, int)

    def cut(self, less: int) -> list[Int[np.ndarray, " k"]]:
        """Take the last `less` stretches out."""
        out = self.pieces[len(self.pieces) - less :] if less else []
        del self.pieces[len(self.pieces) - less :]
        self.size -= sum(piece.size for piece in out)
        return out


def bodies(track: PoseSeries, pieces: list[Int[np.ndarray, " k"]], limits: Bounds) -> list[Int[np.ndarray, " k"]]:
    """The stretches `pieces` joined where they meet shortly after each other: the frames of each body.

    A body whose last few frames a stretch does not meet, but those before them, is joined without them.
    """
    room = np.quantile(track.pose, 0.98, axis=0) - np.quantile(track.pose, 0.02, axis=0)
    swerve = max(BY_CHANCE * float(room[:2].max()), SURE * float(np.median(limits.noise[:, :2])))
    shortly = max(2 * STRAYS * limits.frame, 2 * float(np.sqrt(swerve / max(limits.acceleration[:2].max(), 1e-9))))
    linked: list[_Body] = []
    near: list[_Body] = []
    for piece in pieces:
        begins = {most: end_of(track, limits.noise, piece, False, most) for most in (TAIL, LONG)}
        near = [body for body in near if track.times[piece[0]] - track.times[body.pieces[-1][-1]] <= shortly]
        met: list[tuple[float, int, _Body]] = []
        for body in near:
            off = np.inf
            for less in range(min(STRAYS, len(body.pieces) - 1) + 1):
                if sum(part.size for part in body.pieces[len(body.pieces) - less :]) > STRAYS:
                    break
                tail = body.tail(less)
                tail = tail[track.times[tail[-1]] - track.times[tail] <= 2 * LONG * limits.frame]
                wait = float(track.times[piece[0]] - track.times[tail[-1]])
                if piece.size == 1 and wait > (STRAYS + 0.5) * limits.frame:
                    break
                most = LONG if wait > STRAYS * limits.frame else TAIL
                now = float(miss(end_of(track, limits.noise, tail, True, most), begins[most], limits))
                # Without a frame that strayed it is met well; without good frames its place is only known less well.
                if now < (SURE if not less else min(SURE, off / 3)):
                    met.append((wait, less, body))
                    break
                off = min(off, now)
        if met:
            # The one seen last; a stray frame of just now may be met as well as the body that it strayed from.
            soonest = min(wait for wait, _, _ in met) + STRAYS * limits.frame
            _, less, body = max((one for one in met if one[0] <= soonest), key=lambda one: (one[2].size, -one[1]))
            linked += map(_Body, body.cut(less))
            body.pieces.append(piece)
            body.size += piece.size
        else:
            near.append(_Body(piece))
            linked.append(near[-1])
    joined = (np.concatenate(body.pieces) for body in linked)
    return sorted(joined, key=lambda frames: int(frames[0]))


def longest_chain(track: PoseSeries) -> Chain:
    """The frames of `track`, all of them seen, that the board can have gone through."""
    pieces, limits = stretches(track)
    tracklets = bodies(track, pieces, limits) if len(pieces) > 1 else pieces
    kept = np.zeros(len(track.times), bool)
    best = _heaviest(track, tracklets, limits)
    kept[np.concatenate([tracklets[k] for k in best])] = True
    rest = [body for k, body in enumerate(tracklets) if k not in set(best)]
    rival = sum(rest[k].size for k in _heaviest(track, rest, limits)) if rest else 0
    return Chain(kept, limits, rival / int(kept.sum()))


def _heaviest(track: PoseSeries, tracklets: list[Int[np.ndarray, " k"]], limits: Bounds) -> list[int]:
    """The numbers of the bodies in the longest chain, one after the other."""
    first, last = (
        End(*map(np.array, zip(*(end_of(track, limits.noise, b, side) for b in tracklets), strict=True)))
        for side in (0, 1)
    )
    total, came = np.array([body.size for body in tracklets]), np.full(len(tracklets), -1)
    for k in range(1, len(tracklets)):
        before, after = End(*(part[:k] for part in last)), End(*(part[k] for part in first))
        able = (before.time < after.time) & (miss(before, after, limits) < SURE)
        j = int(np.where(able, total[:k], -1).argmax())
        if able[j]:
            total[k], came[k] = total[k] + total[j], j
    k, chain = int(total.argmax()), []
    while k >= 0:
        chain.append(k)
        k = int(came[k])
    return chain[::-1]
