"""When a joint that stood still begins to move: there its acceleration jumps, which no smooth curve follows."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import fminbound

REST = 5
"""Samples at rest that a joint must show first."""
CLEARLY = 8.0
"""So many standard deviations from where it stood, a joint has moved."""
STILL = 1e-6
"""Angles [rad] nearer than this are the same."""
WINDOWS = (8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450)
"""Samples after a joint has clearly moved, in the windows that tell when it began."""
HALF = 2
"""Steps in `WINDOWS` from one to the one of about half as many samples."""
MORE, BETTER = 1.15, 0.5
"""A window that leaves more than so many times the noise is too long; without a kink twice as much must be left."""
POWERS = (2, 3, 4, 5)
GRID = 30
"""Powers of the time since the onset that describe a joint, and trial onsets before the refinement."""


def onset(times: Float[np.ndarray, " n"], angles: Float[np.ndarray, " n"], noise: float) -> float | None:
    """The time [s] at which a joint that stood still begins to move; None where `angles` [rad] (n,) with `noise` [rad]
    show neither rest first nor a kink.

    Around it the joint is fitted as c + sum_{k=2..5} b_k s^k with s = max(t - t0, 0): at rest, then accelerated. The
    window is about half as long as the longest one over which this leaves no more than noise.
    """
    away = np.abs(angles - np.median(angles[:REST])) > max(CLEARLY * noise, STILL)
    if len(times) < REST + WINDOWS[0] or away[:REST].any() or not away.any():
        return None
    moved = int(np.flatnonzero(away)[0])
    candidates: list[tuple[float, bool]] = []
    least = noise
    for count in WINDOWS:
        part = slice(max(0, moved - max(count, 20)), moved + count)
        t, samples = times[part], angles[part]
        if moved + count > len(times):
            break
        began = _best(t, samples, times[max(0, moved - count)], times[moved])
        left = _left(t, samples, began)
        rms = np.sqrt(left / (len(t) - len(POWERS) - 2))
        least = max(least, rms) if count == WINDOWS[0] else least
        if candidates and rms > MORE * least:
            break
        smooth = np.polynomial.Polynomial.fit(t, samples, POWERS[-1])(t) - samples
        candidates.append((began, left < BETTER * float(smooth @ smooth)))
    if not candidates:
        return None
    began, kinked = candidates[max(0, len(candidates) - 1 - HALF)]
    return began if kinked else None


def _best(t: Float[np.ndarray, " m"], samples: Float[np.ndarray, " m"], low: float, high: float) -> float:
    grid = np.linspace(low, high, GRID)
    k = int(np.argmin([_left(t, samples, began) for began in grid]))
    bounds = grid[max(0, k - 1)], grid[min(grid.size - 1, k + 1)]
    return float(fminbound(lambda began: _left(t, samples, began), *bounds, xtol=1e-7))


def _left(t: Float[np.ndarray, " m"], samples: Float[np.ndarray, " m"], began: float) -> float:
    """The sum of squares that a joint which began to move at `began` leaves."""
    s = np.maximum(t - began, 0.0) / (t[-1] - t[0])
    basis = np.stack([np.ones_like(s), *(s**k for k in POWERS)], axis=1)
    rest = samples - basis @ np.linalg.lstsq(basis, samples, rcond=None)[0]
    return float(rest @ rest)
