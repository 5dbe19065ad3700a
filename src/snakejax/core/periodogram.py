"""The fundamental frequency of a signal."""

import numpy as np
from jaxtyping import Float
from scipy import optimize

OVERSAMPLING = 8
"""Frequencies of the periodogram per cycle over the whole duration."""
AROUND = 4
"""Frequencies of the periodogram to both sides of its peak, between which the sine that fits best is searched."""


def fundamental_frequency(times: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> float:
    """The angular frequency [rad/s] of the sine with offset that fits `values` best, near the peak of the periodogram.

    **Arguments:** `times` [s], evenly spaced.
    """
    size = OVERSAMPLING * times.size
    step = (times[-1] - times[0]) / (times.size - 1)
    power = np.abs(np.fft.rfft(values - values.mean(), size))
    spacing = 2 * np.pi / (size * step)
    peak = spacing * max(int(np.argmax(power[1:])) + 1, 1)

    def squares(frequency: float) -> float:
        turn = frequency * times
        sines = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
        return float(np.sum((values - sines @ np.linalg.lstsq(sines, values)[0]) ** 2))

    ends = (peak - AROUND * spacing, peak + AROUND * spacing)
    best = optimize.minimize_scalar(squares, bounds=ends, method="bounded")
    return float(best.x)  # type: ignore[attr-defined]
