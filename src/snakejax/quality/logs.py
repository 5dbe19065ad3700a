"""Joint logs with noise: an encoder's steps, taken for motion, would be accelerations far beyond any joint's."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .kinematics import bend, scale

FEWEST = 50
FINE = 1e-6
"""Noise [rad] that no derivative suffers from."""
WEAK_AND_STRONG = (-12.0, 40.0)
"""Logarithms of strengths between which every smoothing spline lies."""
GENTLY = 0.1
"""The spline that predicts best bends what the joint did about as far as noise does, and nobody knows which way; a
weaker one leaves a little more noise, whose size is known, and so can be in the standard errors of a fit."""
WHITE = -0.5
"""White noise bends a curve to one side and back: neighbouring bends correlate by -3/4, and those of motion by +1."""


class Smoothed(NamedTuple):
    """`angles` [rad] (n,) with less noise; the `noise` [rad] of one sample before, and the `strength` of the spline."""

    angles: Float[np.ndarray, " n"]
    noise: float
    strength: float


def smoothed(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"]) -> Smoothed:
    """`angles` [rad] as they are, or where they are noisy a smoothing spline through them: `GENTLY` times as strong as
    the one that predicts each sample best from all others (generalised cross validation,
    `scipy.interpolate.make_smoothing_spline`).
    """
    from scipy.optimize import root_scalar

    bends = bend(times, angles[:, None])
    noise = scale(bends)[0]
    if len(times) < FEWEST or not noise > FINE:
        return Smoothed(angles, 0.0, 0.0)
    before, after = bends[:-1, 0], bends[1:, 0]
    if not (before * after).sum() < WHITE * (bends[:, 0] ** 2).sum():
        return Smoothed(angles, 0.0, 0.0)
    # scipy keeps its strength to itself: it is the one that leaves as much.
    left = np.std(angles - splined(times, angles))

    def more(log_strength: float) -> float:
        return float(np.std(angles - splined(times, angles, np.exp(log_strength))) - left)

    strength = GENTLY * float(np.exp(root_scalar(more, bracket=WEAK_AND_STRONG).root))
    return Smoothed(splined(times, angles, strength), float(noise), strength)


def splined(
    times: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], strength: float | None = None
) -> Float[np.ndarray, " n"]:
    """The cubic smoothing spline of `strength` through `values`, which is linear in them; of the strength that
    generalised cross validation finds, where none is given.
    """
    from scipy.interpolate import make_smoothing_spline

    # Cross validation asks for equal units of time and angle.
    frames = (times - times[0]) / float(np.median(np.diff(times)))
    return make_smoothing_spline(frames, values, lam=strength)(frames)
