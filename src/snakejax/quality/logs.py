"""Joint logs with noise: an encoder's steps, taken for motion, would be accelerations far beyond any joint's."""

import numpy as np
from jaxtyping import Float

from .kinematics import bend, scale

FEWEST = 50
FINE = 1e-6
"""Noise [rad] that no derivative suffers from."""
WHITE = -0.5
"""White noise bends a curve to one side and back: neighbouring bends correlate by -3/4, and those of motion by +1."""


def smoothed(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """`angles` [rad] as they are, or where they are noisy the smoothing spline through them that predicts each sample
    best from all others (generalised cross validation, `scipy.interpolate.make_smoothing_spline`).
    """
    from scipy.interpolate import make_smoothing_spline

    bends = bend(times, angles[:, None])
    if len(times) < FEWEST or not scale(bends)[0] > FINE:
        return angles
    before, after = bends[:-1, 0], bends[1:, 0]
    if not (before * after).sum() < WHITE * (bends[:, 0] ** 2).sum():
        return angles
    # Cross validation asks for equal units of time and angle.
    frame = float(np.median(np.diff(times)))
    return make_smoothing_spline((times - times[0]) / frame, angles)((times - times[0]) / frame)
