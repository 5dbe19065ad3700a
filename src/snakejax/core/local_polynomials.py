"""Smoothed values and derivatives of samples, from local polynomials (Savitzky and Golay 1964).

`derivative` filters even samples without gaps; `local_cubics` takes uneven ones with gaps; `even_local_cubics` takes
even ones with gaps, and says how uncertain the second derivative is. `difference_noise` is what they leave.
"""

from math import comb

import numpy as np
from jaxtyping import Float

# `scipy.signal` is imported where it is used: that takes a tenth of the time of a sweep, which smooths nothing.

FEWEST = 8
"""Least number of samples of a local cubic."""
EVEN = 1e-3
"""Frames count as evenly spaced if every interval is within this fraction of the median interval."""


def window_of(width: float, frame: float) -> int:
    """The odd number of samples, at least 5, in a window of `width` [s] with a sample each `frame` [s]."""
    return max(5, round(width / frame) // 2 * 2 + 1)


def derivative(values: Float[np.ndarray, "n c"], frame: float, window: int, order: int) -> Float[np.ndarray, "n c"]:
    """The derivative of `order` 0 or 1 by cubics through `window` samples, of order 2 by quartics.

    A sample each `frame` [s].
    """
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(values, window, 3 + order // 2, deriv=order, delta=frame, axis=0))


def derivative_gain(frame: float, window: int, order: int) -> float:
    """The variance of `derivative` for samples with independent errors of variance one."""
    from scipy.signal import savgol_coeffs

    weights = savgol_coeffs(window, 3 + order // 2, deriv=order, delta=frame)
    return float(weights @ weights)


def local_cubics(
    t: Float[np.ndarray, " n"], recorded: Float[np.ndarray, "n c"], half_width: float
) -> tuple[Float[np.ndarray, "n c"], Float[np.ndarray, "n c"]]:
    """Smoothed value (n, c) of `recorded` and its rate [1/s], from cubics through the complete samples within
    `half_width` [s], or the `FEWEST` nearest ones.

    NaN marks what is missing. The times may be uneven.
    """
    present = np.flatnonzero(np.isfinite(recorded).all(axis=1))
    known, values = t[present], recorded[present]
    value, rate = np.empty_like(recorded), np.empty_like(recorded)
    frame = float(np.median(np.diff(known)))
    half = int(half_width / frame + 1e-6)
    steady = np.zeros(len(known), bool)
    if half >= 4 and len(known) > 2 * half:
        # Where no frame is missing the cubic is one linear filter.
        uneven = np.concatenate([[0], np.cumsum(np.abs(np.diff(known) - frame) > EVEN * frame)])
        steady[half : len(known) - half] = uneven[2 * half :] == uneven[: -2 * half]
        for out, order in ((value, 0), (rate, 1)):
            smoothed = derivative(values, frame, 2 * half + 1, order)
            out[present[steady]] = smoothed[steady]
    reach = (half + 0.5) * frame
    for k in np.delete(np.arange(len(t)), present[steady]):
        time = t[k]
        first, middle, last = np.searchsorted(known, [time - reach, time, time + reach])
        if last - first < FEWEST:
            candidates = np.arange(max(0, middle - FEWEST), min(len(known), middle + FEWEST))
            neighbours = candidates[np.argsort(np.abs(known[candidates] - time))[:FEWEST]]
        else:
            neighbours = np.arange(first, last)
        c = np.polyfit(known[neighbours] - time, values[neighbours], min(3, len(known[neighbours]) - 1))
        value[k], rate[k] = c[-1], c[-2]
    return value, rate


def even_local_cubics(
    times: Float[np.ndarray, " n"], values: Float[np.ndarray, "n c"], sd: Float[np.ndarray, " c"], half_width: float
) -> tuple[Float[np.ndarray, "n 3 c"], Float[np.ndarray, "n c"]]:
    """Value, rate and acceleration (n, 3, c) of `values` from cubics through what lies within `half_width` [s].

    The second part is the standard deviation (n, c) of the acceleration for samples of standard deviation `sd`. NaN
    where less than half of the samples around are present. Frames are taken to be equally far apart.
    """
    step = float(np.median(np.diff(times)))
    half = max(round(half_width / step), 4)
    tau = np.arange(-half, half + 1) * step
    present = np.isfinite(values)
    known = np.where(present, values, 0.0)
    derivatives = np.full((*values.shape[:1], 3, values.shape[1]), np.nan)
    error = np.full(values.shape, np.nan)
    for c in range(values.shape[1]):

        def moment(power: int, column: np.ndarray) -> np.ndarray:
            return np.convolve(column, (tau**power)[::-1], "full")[half : half + column.size]

        sums = [moment(p, present[:, c] * 1.0) for p in range(7)]
        normal = np.stack([np.stack([sums[i + j] for j in range(4)], axis=-1) for i in range(4)], axis=-2)
        right = np.stack([moment(p, known[:, c]) for p in range(4)], axis=-1)
        enough = sums[0] >= half
        inverse = np.linalg.inv(normal[enough])
        coefficients = np.einsum("nij,nj->ni", inverse, right[enough])
        derivatives[enough, :, c] = coefficients[:, :3] * np.array([1.0, 1.0, 2.0])
        error[enough, c] = 2 * np.sqrt(np.maximum(inverse[:, 2, 2], 0.0)) * sd[c]
    return derivatives, error


def difference_noise(values: Float[np.ndarray, "n c"], order: int) -> Float[np.ndarray, " c"]:
    """The standard deviation of the white noise of `values`, n > `order`, by their differences of `order` k.

    The median of |difference| over 0.6745 sqrt(binomial(2 k, k)): white noise of standard deviation one has differences
    of variance binomial(2 k, k), and half of a normal distribution lies within 0.6745. No polynomial of a lower degree
    contributes.
    """
    return np.median(np.abs(np.diff(values, order, axis=0)), axis=0) / (0.6745 * np.sqrt(comb(2 * order, order)))
