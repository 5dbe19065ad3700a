"""Joint logs with noise: an encoder's steps, taken for motion, would be accelerations far beyond any joint's."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.dynamics.signals import split_at_onset

from .kinematics import scale, third_difference
from .onsets import onset

FEWEST = 50
FINE = 1e-6
"""Noise [rad] that no derivative suffers from."""
WEAK_AND_STRONG = (-12.0, 40.0)
"""Logarithms of strengths between which every smoothing spline lies."""
GENTLY = 0.1
"""The spline that predicts best bends what the joint did about as far as noise does, and nobody knows which way; a
weaker one leaves a little more noise, whose size is known, and so can be in the standard errors of a fit."""
MIRRORED = 100
"""Samples after an onset that are mirrored in time."""
WHITE = -0.5
"""White noise bends a curve to one side and back: neighbouring bends correlate by -3/4, and those of motion by +1."""


class Smoothed(NamedTuple):
    """`angles` [rad] (n,) with less noise; the `noise` [rad] of one sample before, and the `strength` of the spline;
    the `onset` [s] at which the joint begins to move, where it was looked for and seen.
    """

    angles: Float[np.ndarray, " n"]
    noise: float
    strength: float
    onset: float | None


def smoothed(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"], starts: bool = False) -> Smoothed:
    """`angles` [rad] as they are, or where they are noisy a smoothing spline through them: `GENTLY` times as strong as
    the one that predicts each sample best from all others (generalised cross validation,
    `scipy.interpolate.make_smoothing_spline`). `starts`: look for the onset of a joint, which has no rate there.
    """
    from scipy.optimize import root_scalar

    noise = _noise(times, angles)
    began = onset(times, angles, noise) if starts else None
    if not noise > 0:
        return Smoothed(angles, 0.0, 0.0, began)
    # scipy keeps its strength to itself: it is the one that leaves as much.
    left = np.std(angles - splined(times, angles, None, began))

    def more(log_strength: float) -> float:
        return float(np.std(angles - splined(times, angles, np.exp(log_strength), began)) - left)

    strength = GENTLY * float(np.exp(root_scalar(more, bracket=WEAK_AND_STRONG).root))
    return Smoothed(splined(times, angles, strength, began), noise, strength, began)


def smoothed_again(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"], like: Smoothed) -> Smoothed:
    """Another draw of the log that was smoothed to `like`, smoothed as strongly."""
    began = None if like.onset is None else onset(times, angles, like.noise)
    return Smoothed(splined(times, angles, like.strength, began), like.noise, like.strength, began)


def splined(
    times: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    strength: float | None = None,
    began: float | None = None,
) -> Float[np.ndarray, " n"]:
    """The cubic smoothing spline of `strength` through `values`, which is linear in them; of the strength that
    generalised cross validation finds, where none is given. A joint that `began` then is constant before, and after it
    a spline through the samples and their mirror images in time, whose rate there is zero.
    """
    from scipy.interpolate import make_smoothing_spline

    # Cross validation asks for equal units of time and angle.
    frame = float(np.median(np.diff(times)))
    if began is None:
        frames = (times - times[0]) / frame
        return make_smoothing_spline(frames, values, lam=strength)(frames)
    rest, moving = split_at_onset(times, began)
    after, sampled = (times[moving] - began) / frame, values[moving]
    mirrored = np.concatenate([-after[:MIRRORED][::-1], [0.0], after])
    through = np.concatenate([sampled[:MIRRORED][::-1], [values[rest].mean()], sampled])
    weights = np.where(mirrored == 0, float(rest.sum()), 1.0)
    spline = make_smoothing_spline(mirrored, through, weights, lam=strength)
    return spline(np.maximum(times - began, 0.0) / frame)


def _noise(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"]) -> float:
    """The noise [rad] of one sample; 0 where no derivative suffers from it, or what looks like it is motion."""
    bends = third_difference(times, angles[:, None])
    noise = float(scale(bends)[0])
    if len(times) < FEWEST or not noise > FINE:
        return 0.0
    before, after = bends[:-1, 0], bends[1:, 0]
    return noise if (before * after).sum() < WHITE * (bends[:, 0] ** 2).sum() else 0.0
