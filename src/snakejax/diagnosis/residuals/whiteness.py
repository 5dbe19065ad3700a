"""Is it noise? The portmanteau test of a residual with gaps."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.dynamics.observation import CHANNELS

from .replays import ResidualSeries

LAGS = 20
"""Lags of the portmanteau test, in samples: 0.2 s at 100 Hz."""


class Whiteness(NamedTuple):
    """The portmanteau test of one channel of one run; see `portmanteau`."""

    run: str
    channel: str
    statistic: float
    lags: int
    p_value: float


def whiteness(track: ResidualSeries, lags: int = LAGS) -> tuple[Whiteness, ...]:
    """The `portmanteau` test of each channel that was seen."""
    return tuple(
        Whiteness(track.run, channel, *portmanteau(track.residual[:, c], lags))
        for c, channel in enumerate(CHANNELS)
        if np.isfinite(track.residual[:, c]).sum() > 1
    )


def portmanteau(residual: Float[np.ndarray, " n"], lags: int = LAGS) -> tuple[float, int, float]:
    """(statistic, lags, p-value) of the hypothesis that the present samples of `residual` are white with mean zero.

    With N present samples of mean square s^2, and the n_k pairs at lag k of which both are present,

        Q = (N + 2) / N  sum_k c_k^2 / (n_k s^4)        c_k = sum over the pairs of e_t e_{t+k}

    is chi^2 of `lags` degrees of freedom. Without gaps it is Ljung and Box's (Biometrika 1978, eq. 1.3). Independent
    samples of any distribution will do: a product of two has variance s^4. The mean is not taken out.
    """
    present = np.isfinite(residual)
    e, N = np.where(present, residual, 0.0), int(present.sum())
    square = float((e**2).sum()) / max(N, 1)
    lags = max(min(lags, N // 4), 1)
    if square == 0.0:
        return 0.0, lags, 1.0
    pairs = np.array([(present[k:] & present[:-k]).sum() for k in range(1, lags + 1)])
    products = np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)])
    used = pairs > 0
    statistic = (N + 2) / N * float((products[used] ** 2 / (pairs[used] * square**2)).sum())
    return statistic, int(used.sum()), float(stats.chi2.sf(statistic, used.sum()))


def autocorrelation(
    residuals: Sequence[Float[np.ndarray, " n"]], lags: int
) -> tuple[Float[np.ndarray, " lags"], float]:
    """The autocorrelation (lags,) of the residuals of several runs together at lags from 0 on, and its 95% bound.

    With the n_k pairs of samples at lag k of which both are present, in all runs, and the mean square s^2,

        rho_k = sum of e_t e_{t+k} / (n_k s^2)

    The mean is not taken out. White noise stays within the bound 1.96 / sqrt(n_1) at 95% of the lags. NaN where there
    are no pairs.
    """
    products, pairs = np.zeros(lags), np.zeros(lags)
    for residual in residuals:
        present = np.isfinite(residual)
        e = np.where(present, residual, 0.0)
        for k in range(min(lags, e.size)):
            products[k] += e[k:] @ e[: e.size - k]
            pairs[k] += (present[k:] & present[: e.size - k]).sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        square = products[0] / pairs[0]
        return products / (pairs * square), float(1.96 / np.sqrt(pairs[1]))
