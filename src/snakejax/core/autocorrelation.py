"""How long the errors of samples remember each other."""

import numpy as np
from jaxtyping import Float

FORGOTTEN = 0.1
"""Autocorrelation below which errors have forgotten each other."""


def memory(residuals: Float[np.ndarray, "R n"]) -> int:
    """After how many samples the autocorrelation of the `residuals` of R runs together has fallen below `FORGOTTEN`.

    The mean of each run is taken out; NaN is a sample that is missing. The result is 1 if all are, and n where the
    autocorrelation does not fall so far.
    """
    present = np.isfinite(residuals)
    if not present.any():
        return 1
    counts = np.maximum(present.sum(axis=1, keepdims=True), 1)
    mean = np.where(present, residuals, 0.0).sum(axis=1, keepdims=True) / counts
    errors = np.where(present, residuals - mean, 0.0)
    products, pairs = _lagged(errors), _lagged(present * 1.0)
    correlation = products / np.maximum(pairs, 1.0)
    low = np.flatnonzero(correlation < FORGOTTEN * correlation[0])
    return int(low[0]) if low.size else residuals.shape[1]


def _lagged(parts: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
    """The sum of e_t e_(t+k) over all samples and runs, at each lag k."""
    count = parts.shape[1]
    spectrum = (np.abs(np.fft.rfft(parts, 2 * count)) ** 2).sum(axis=0)
    return np.fft.irfft(spectrum)[:count]
