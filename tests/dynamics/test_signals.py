"""Signals of joints as functions of time."""

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.dynamics.inputs import on_clock
from snakejax.dynamics.sampled_signals import samples_between
from snakejax.dynamics.signals import Logged


def test_a_log_on_another_clock_is_the_same_motion():
    t = np.linspace(0, 3, 40)
    signal = Logged.of(t, np.sin(2 * t))
    moved = signal.on_clock(0.3, 0.02)
    for now in (0.2, 1.0, 2.2):
        angle, rate, acceleration = moved.at(jnp.asarray(now))
        there = signal.at(jnp.asarray(now * 1.02 + 0.3))
        np.testing.assert_allclose(angle, there.angle, rtol=1e-12)
        np.testing.assert_allclose(rate, 1.02 * there.rate, rtol=1e-12)
        np.testing.assert_allclose(acceleration, 1.02**2 * there.acceleration, rtol=1e-12)
    assert on_clock((signal, 1.0), 0.0, 0.0)[1] == 1.0


@pytest.mark.parametrize("onset", [-0.5, 0.0, 2.95, 4.0, np.nan])
def test_an_onset_outside_the_log_is_refused(onset):
    t = np.linspace(0, 3, 40)
    with pytest.raises(ValueError, match=r"begins at .* s, outside its log from 0 to 3 s"):
        Logged.of(t, np.sin(t), onset=onset)


@pytest.mark.parametrize(
    ("first", "last", "fewest", "kept"),
    [
        (2.5, 4.5, 1, [2, 3, 4, 5]),
        (-9.0, 99.0, 1, [*range(10)]),
        (20.0, 30.0, 1, [9]),
        (20.0, 30.0, 4, [6, 7, 8, 9]),
    ],
)
def test_the_samples_of_a_held_log_that_matter(first: float, last: float, fewest: int, kept: list[int]) -> None:
    """Those inside and one on each side, and no fewer than `fewest`."""
    times = np.arange(10.0)
    assert times[samples_between(times, first, last, fewest)].tolist() == kept
