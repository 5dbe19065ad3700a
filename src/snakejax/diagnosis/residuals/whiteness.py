"""Is it noise? The portmanteau test of a residual with gaps."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.dynamics.observation import CHANNELS

from .replays import ResidualSeries

LAGS = 20


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
