"""A joint that rests and then starts, as logs show it."""

import numpy as np


def started(t: np.ndarray, at: float) -> np.ndarray:
    """A joint that rests at 0.2 rad until `at` [s], and is then accelerated with 12 rad/s^2."""
    s = np.maximum(t - at, 0.0)
    return 0.2 + 0.75 * (1 - np.cos(4 * s))
