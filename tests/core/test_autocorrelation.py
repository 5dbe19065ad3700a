"""The memory of errors, against the exact one of an autoregressive process and against sums over pairs."""

import numpy as np
import pytest
from scipy.signal import lfilter

from snakejax.core.autocorrelation import memory


@pytest.mark.parametrize("a", [0.8, 0.95])
def test_an_autoregressive_process_forgets_as_its_power_falls(a: float) -> None:
    errors = lfilter([1.0], [1.0, -a], np.random.default_rng(0).normal(size=(4, 200_000)))
    assert memory(errors) == pytest.approx(np.log(0.1) / np.log(a), rel=0.15)


def test_runs_are_pooled_with_gaps_and_a_mean_of_their_own() -> None:
    draw = np.random.default_rng(1)
    errors = lfilter([1.0], [1.0, -0.7], draw.normal(size=(3, 60))) + np.array([[5.0], [-3.0], [0.0]])
    errors[draw.random(errors.shape) < 0.2] = np.nan
    errors[2, 40:] = np.nan
    centred = errors - np.nanmean(errors, axis=1, keepdims=True)
    lagged = [np.nanmean(centred[:, k:] * centred[:, : 60 - k]) for k in range(20)]
    assert memory(errors) == int(np.flatnonzero(np.array(lagged) < 0.1 * lagged[0])[0])


def test_white_errors_forget_at_once_and_missing_ones_have_no_memory() -> None:
    assert memory(np.random.default_rng(0).normal(size=(2, 5000))) == 1
    assert memory(np.full((2, 10), np.nan)) == 1
