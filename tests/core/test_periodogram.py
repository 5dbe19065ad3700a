"""The fundamental frequency, against sines whose frequency is known."""

import numpy as np
import pytest

from snakejax.core.periodogram import fundamental_frequency

TIMES = np.arange(1200) / 100


@pytest.mark.parametrize("frequency", [0.9, 2.1, 4.0, 11.3])
def test_a_sine_has_its_frequency(frequency: float) -> None:
    values = 0.3 + 0.7 * np.sin(frequency * TIMES + 0.4)
    assert fundamental_frequency(TIMES + 5.0, values) == pytest.approx(frequency, abs=1e-4)


def test_noise_moves_the_frequency_by_no_more_than_its_standard_error_says() -> None:
    noise = 0.1 * np.random.default_rng(0).normal(size=TIMES.size)
    # The standard error of a frequency is sqrt(24 / n) sd / (amplitude T) = 1.2e-3 rad/s.
    assert fundamental_frequency(TIMES, np.sin(3.0 * TIMES) + noise) == pytest.approx(3.0, abs=5e-3)


def test_the_largest_of_several_sines_wins() -> None:
    """Its harmonic leaks into it where the duration is no whole number of cycles: less than half a cycle in all."""
    values = np.sin(3.0 * TIMES) + 0.5 * np.sin(6.0 * TIMES)
    assert fundamental_frequency(TIMES, values) == pytest.approx(3.0, abs=np.pi / TIMES[-1])
