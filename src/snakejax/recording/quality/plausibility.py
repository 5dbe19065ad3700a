"""What no board does: move at a hundred metres a second, out of its area, on edge, or before it starts."""

import numpy as np

from snakejax.dynamics.observation import CHANNELS, UNITS

from .finding import Finding, PoseSeries, finding
from .kinematics import BLOCK, LEAST_NOISE, scale, third_difference
from .timestamps import steady

FASTEST = 30.0
"""No snakeboard is faster [m/s]."""
FARTHEST, NEAREST = 100.0, 1e-3
"""A board that goes further [m] in a recording, or less far, has hardly been measured in metres."""
ARMS = (0.01, 5.0)
"""How far markers sit from each other [m]: the noise of the position over that of the heading."""
QUIET, LOUD = 1e-7, 0.03
"""Position noise [m] beyond which no camera system is."""
REST_WINDOW = 0.25
REST_SPEED = {"x": 0.05, "y": 0.05, "heading": 0.3}
SHAKY = 3.0
"""Noise that is so many times that of the rest of the run."""
FLAT = 0.01
LEVEL = 3.0
"""A coordinate stands still if it spans less than the first, as a share of the other one, or than the second times its
noise."""


def area(track: PoseSeries, corners: tuple[float, float, float, float]) -> list[Finding]:
    """Frames outside the stated area, from (x, y) to (x, y) [m]."""
    x, y = track.pose[:, 0], track.pose[:, 1]
    outside = [corners[0] - x, corners[1] - y, x - corners[2], y - corners[3]]
    by = np.nanmax(np.where(track.present, np.max(outside, axis=0), -np.inf), initial=-np.inf)
    frames = np.flatnonzero(np.where(track.present, np.max(outside, axis=0), -np.inf) > 0)
    if not frames.size:
        return []
    what = f"{frames.size} frames lie outside area_m, by up to {by:.3g} m"
    wholly = frames.size > 0.5 * track.present.sum()
    remedy = "correct area_m" if wholly else "they count as lost"
    acts = {"severity": "refused"} if wholly else {"action": "mask"}
    return [finding("outside", track, frames, what, remedy, size=float(by), unit="m", **acts)]


def units(track: PoseSeries) -> list[Finding]:
    """Lengths that are no metres, or angles that are no radians: from how fast, how far and how noisily it moves."""
    present = steady(track.complete())
    far = float(np.linalg.norm(present.pose[:, :2] - present.pose[0, :2], axis=1).max())
    speed = np.median(np.linalg.norm(np.diff(present.pose[:, :2], axis=0), axis=1) / np.diff(present.times))
    noise = scale(third_difference(present.times, present.pose))
    position, heading = float(np.hypot(*noise[:2]) / np.sqrt(2)), float(noise[2])
    remedy = "correct the unit that the file states"
    every = np.flatnonzero(track.present)

    def unit_finding(what: str, size: float, unit: str, severity: str = "refused") -> list[Finding]:
        return [finding("units", track, every, what, remedy, size=size, unit=unit, severity=severity)]

    if far > FARTHEST or speed > FASTEST:
        return unit_finding(f"the board goes {far:.3g} m away: is the unit of length right?", far, "m")
    if position > LOUD:
        return unit_finding(
            f"one sample of position is off by {position:.2g} m: is the unit of length right?", position, "m"
        )
    if far < NEAREST:
        what = f"the board goes only {far:.2g} m away: did it move, and is the unit of length right?"
        return unit_finding(what, far, "m", "doubtful")
    if position > QUIET and heading > 0 and not ARMS[0] <= position / heading <= ARMS[1]:
        arm = position / heading
        wrong = "length" if arm > ARMS[1] or heading < 0.05 else "angle"
        what = f"noise of position {position:.2g} m, of heading {heading:.2g} rad, as of markers {arm:.2g} m apart"
        return unit_finding(f"{what}: is the unit of {wrong} right?", arm, "m")
    return []


def up_axis(track: PoseSeries) -> list[Finding]:
    """A floor seen from the side: one coordinate and the heading stand still while the other coordinate moves."""
    present = steady(track.complete())
    noise = scale(third_difference(present.times, present.pose))
    spread = np.quantile(present.pose, 0.98, axis=0) - np.quantile(present.pose, 0.02, axis=0)
    # Of noise alone these quantiles are 4.1 standard deviations apart.
    still = spread <= LEVEL * 4.1 * noise
    along = int(spread[:2].argmax())
    if not (
        still[2]
        and noise[2] > 0
        and spread[along] > 0.05
        and (still[1 - along] or spread[1 - along] < FLAT * spread[along])
    ):
        return []
    what = f"{CHANNELS[along]} changes by {spread[along]:.2g} m, but {CHANNELS[1 - along]} and the heading stand still"
    frames = np.flatnonzero(track.present)
    remedy = "export the file again, so that the axis that it states as vertical points up"
    return [
        finding(
            "up_axis",
            track,
            frames,
            f"{what}, as of a floor seen from the side: is the vertical axis right?",
            remedy,
            size=float(spread[along]),
            unit="m",
            severity="refused",
        )
    ]


def start(track: PoseSeries) -> list[Finding]:
    """The speed at time 0 of a run that is to start at rest, from a cubic through the first quarter second."""
    early = track.present & (track.times <= REST_WINDOW)
    times = track.times[early]
    if track.moving or times.size < 12 or times[0] > REST_WINDOW / 5:
        return []
    basis = np.vander(times, 4, increasing=True)
    findings = []
    for name, unit, channel in zip(CHANNELS, UNITS, track.pose[early].T, strict=True):
        coefficients, *_ = np.linalg.lstsq(basis, channel, rcond=None)
        left = channel - basis @ coefficients
        variance = float(left @ left) / (times.size - 4) * np.linalg.inv(basis.T @ basis)[1, 1]
        speed = float(coefficients[1])
        if abs(speed) > REST_SPEED[name] + 4 * np.sqrt(variance):
            what = f"{name} already moves at {speed:.2g} {unit}/s at the start, which is to be at rest"
            frames, remedy = np.flatnonzero(early), 'write start = "moving" for this run'
            findings.append(finding("not_at_rest", track, frames, what, remedy, size=abs(speed), unit=f"{unit}/s"))
    return findings


def shaking(track: PoseSeries) -> list[Finding]:
    """Stretches in which the noise is several times that of the rest of the run."""
    present = steady(track.complete())
    bends = third_difference(present.times, present.pose)
    findings = []
    if len(bends) < 5 * BLOCK:
        return findings
    blocks = np.array_split(np.arange(len(bends)), len(bends) // BLOCK)
    frames = np.flatnonzero(track.present)
    worst = np.zeros(len(blocks))
    for b, least in zip(bends.T, LEAST_NOISE, strict=True):
        each = np.array([scale(b[block, None])[0] for block in blocks])
        # White noise bends a path from frame to frame; motion does so slowly.
        white = np.array([np.mean(b[block][1:] * b[block][:-1]) < -0.4 * np.mean(b[block] ** 2) for block in blocks])
        usual = float(np.median(each))
        if usual > 0:
            worst = np.maximum(worst, np.where(white, each / max(usual, float(least)), 0.0))
    shaky = worst > SHAKY
    if shaky.any() and shaky.mean() < 0.5:
        where = frames[np.concatenate([blocks[k] for k in np.flatnonzero(shaky)])]
        size = float(worst.max())
        at = f"from {track.times[where[0]]:.2f} s on"
        what = f"{where.size} frames {at} are up to {size:.2g} times as noisy as the others"
        remedy = "--robust counts outliers less; window_s chooses a part of the run"
        findings.append(finding("jitter", track, where, what, remedy, size=size))
    return findings
