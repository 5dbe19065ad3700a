"""What runs, noise and presets say of themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.sampled_signals import Held
from snakejax.recording.run import Noise, Run
from snakejax.vehicles.snakeboard.paper_examples import preset


def run(frames: int) -> Run:
    gait = Inputs({"steer": Held.of([0.0], [0.1])})
    return Run("lap", "train", jnp.asarray(np.arange(frames) * 0.1), jnp.zeros((frames, 3)), gait)


def test_a_run_says_its_frames_and_its_length() -> None:
    assert repr(run(61)) == "Run lap: train, 61 frames in 6 s"
    assert repr(run(1)) == "Run lap: train, 1 frame in 0 s"


@pytest.mark.parametrize(("correlation", "end"), [(None, "(case.toml)"), (0.2, "(case.toml), wanders over 0.2 s")])
def test_noise_says_its_size_and_its_source(correlation: float | None, end: str) -> None:
    noise = Noise(jnp.asarray(3e-4), jnp.asarray(1e-3), "case.toml", correlation)
    assert repr(noise) == f"Noise: 0.3 mm, 1 mrad {end}"


def test_they_can_be_shown_while_they_are_traced() -> None:
    shown = []

    @jax.jit
    def trace(one: Run, noise: Noise):
        shown.extend([repr(one), repr(noise)])
        return one.times.sum() + noise.position

    trace(run(5), Noise(jnp.asarray(3e-4), jnp.asarray(1e-3), "stated"))
    assert shown == ["Run lap: train, 5 frames", "Noise (stated)"]


def test_a_preset_says_its_length() -> None:
    assert repr(preset("paper-rotate")) == "Preset paper-rotate: 14 s"
