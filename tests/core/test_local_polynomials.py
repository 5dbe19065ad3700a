"""The noise of samples by their differences, against the noise that was drawn."""

import numpy as np
import pytest

from snakejax.core.local_polynomials import difference_noise


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_noise_is_that_which_was_drawn_and_no_polynomial_is_noise(order: int) -> None:
    times, sd = np.linspace(-1.0, 1.0, 40_000), np.array([0.3, 2.0])
    path = times[:, None] ** (order - 1) * [5.0, -7.0]
    drawn = path + np.random.default_rng(0).normal(size=(times.size, 2)) * sd
    np.testing.assert_allclose(difference_noise(drawn, order), sd, rtol=0.03)
    np.testing.assert_allclose(difference_noise(path, order), 0.0, atol=1e-12)
