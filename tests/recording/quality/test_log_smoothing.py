"""Noise in joint logs and the onset of their motion, against joints that are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.joint_onset import started
from helpers.logged_case import LEVEL
from scipy.interpolate import CubicSpline

from snakejax import load_case, simulate, simulate_many, stacked, starting_model
from snakejax.dynamics.inputs import Gait, on_clock
from snakejax.dynamics.signals import Logged
from snakejax.recording.quality import smoothed


@pytest.mark.slow
def test_a_noisy_log_is_smoothed_and_a_clean_one_is_not():
    rng = np.random.default_rng(0)
    t = np.arange(0, 12, 0.005)
    true = 0.9 * np.sin(4 * t) + 0.2 * np.cos(7 * t)
    assert smoothed(t, true).angles is true
    for rough in (true + 5e-4 * rng.normal(size=t.size), np.round(true / 1.5e-3) * 1.5e-3):
        better = smoothed(t, rough).angles
        assert np.std(better - true) < 0.5 * np.std(rough - true)
        inner = slice(100, -100)
        raw, good, exact = (CubicSpline(t, a)(t, 2)[inner] for a in (rough, better, true))
        assert np.std(good - exact) < 0.05 * np.std(raw - exact)


@pytest.mark.slow
def test_the_onset_of_a_joint_is_found():
    rng = np.random.default_rng(0)
    found = []
    for k in range(30):
        rate, noise = ((100.0, 0.0), (1000.0, 0.0), (100.0, 5e-4))[k % 3]
        t, at = np.arange(-1, 4, 1 / rate), rng.uniform(-0.4, 0.4)
        seen = started(t, at) + noise * rng.normal(size=t.size)
        found.append((smoothed(t, seen, starts=True).onset - at, noise))
    exact = [abs(off) for off, noise in found if noise == 0]
    assert len(exact) == 20 and max(exact) < 5e-5
    rough = np.array([off for off, noise in found if noise > 0])
    assert np.sqrt((rough**2).mean()) < 2e-3


def test_what_has_no_onset():
    t = np.arange(-1, 4, 0.01)
    for joint in (np.full(t.size, 0.3), np.sin(4 * t), started(t, -0.99), started(t, 3.97)):
        assert smoothed(t, joint, starts=True).onset is None
    assert smoothed(t, started(t, 0.1)).onset is None


@pytest.mark.slow
def test_a_joint_is_followed_through_its_onset():
    """100 samples a second: the rate within 3e-4 rad/s; without the kink it is ten times as far off."""
    t, fine = np.arange(-1, 4, 0.01), jnp.arange(-0.2, 1.0, 1e-3)
    seen = started(t, 0.1234)
    kinked, smooth = Logged.of(t, *smoothed(t, seen, starts=True)), Logged.of(t, seen)
    moving = np.maximum(np.asarray(fine) - 0.1234, 0.0)
    angle, rate, _ = jax.vmap(kinked.at)(fine)
    np.testing.assert_allclose(angle, started(np.asarray(fine), 0.1234), atol=3e-5)
    np.testing.assert_allclose(rate, 3.0 * np.sin(4 * moving), atol=3e-4)
    assert np.abs(jax.vmap(smooth.at)(fine).rate - 3.0 * np.sin(4 * moving)).max() > 3e-3
    assert np.abs(jax.vmap(kinked.at)(fine[fine < 0.12]).rate).max() == 0.0


@pytest.mark.long
def test_a_board_at_rest_begins_with_its_joints():
    """A clock that is late moves a run in time, and changes nothing else."""
    t = np.arange(-1, 5, 0.01)
    gait = Gait(*(Logged.of(t, *smoothed(t, size * (started(t, 0.05) - 0.2), starts=True)) for size in (0.5, 1.0)))
    model = starting_model(load_case(LEVEL))
    times = jnp.arange(0.5, 3.0, 0.1)
    for offset in (0.02, 0.08, 0.3):
        early = on_clock(gait, jnp.asarray(offset), jnp.asarray(0.0))
        assert float(early.begins()) == pytest.approx(min(0.0, 0.05 - offset), abs=1e-5)
        for start, resting in ((jnp.zeros(3), False), (jnp.zeros(6), True)):
            moved = simulate(model, early, times, start, resting=resting).pose
            np.testing.assert_allclose(moved, simulate(model, gait, times + offset).pose, atol=1e-6)
    many = simulate_many(stacked([model, model]), early, np.asarray(times), workers=1)
    np.testing.assert_allclose(many, np.stack([simulate(model, early, times).pose] * 2), atol=1e-5)
