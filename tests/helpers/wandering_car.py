"""Windows of a made-up car that wanders: its yaw rate and its speed are disturbed, as those of a real one are."""

from collections import OrderedDict

import jax.numpy as jnp
import numpy as np

from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.tyres import Pacejka
from snakejax.recording.run import Case, Noise, Run
from snakejax.simulation.integrate import simulate
from snakejax.vehicles.car import DART, Car

YAW, SPEED, TIME = 0.05, 0.015, 0.1
"""Standard deviations [rad/s, m/s] of what disturbs yaw rate and speed, and its time constant [s]."""
FRAME, WINDOW, SECONDS = 0.05, 1.5, 12.0
NOISE = Noise(jnp.asarray(0.008), jnp.asarray(0.01), "stated")
CONSTANTS = {"steering_ratio": 0.4, "force_gain": 8.0, "dead_band": 0.1, "speed_loss": 1.0}
ESTIMATED = tuple(CONSTANTS)
TYRE = FrontRear(Pacejka(6.0, 1.4, 7.0, 0.0), Pacejka(8.0, 1.4, 5.5, 0.0))


def disturbed(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`pose` (n, 3) with first-order noise on yaw rate and speed, each step turned by what has been added so far."""
    decay = np.exp(-FRAME / TIME)
    rates = np.zeros((len(pose), 2))
    for k in range(1, len(pose)):
        rates[k] = decay * rates[k - 1] + np.sqrt(1 - decay**2) * rng.normal(size=2) * [YAW, SPEED]
    turned = np.concatenate([[0.0], np.cumsum(rates[:-1, 0]) * FRAME])
    heading = pose[:, 2] + turned
    steps = np.diff(pose[:, :2], axis=0)
    c, s = np.cos(turned[:-1]), np.sin(turned[:-1])
    moved = np.column_stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]])
    moved += (rates[:-1, 1] * FRAME)[:, None] * np.column_stack([np.cos(heading[:-1]), np.sin(heading[:-1])])
    path = np.concatenate([pose[:1, :2], pose[:1, :2] + np.cumsum(moved, axis=0)])
    return np.column_stack([path, heading])


def commands(rng: np.random.Generator) -> Inputs:
    """Steering and drive that last 0.4 to 1.2 s each, sent every 0.1 s."""
    at = np.arange(round(10 * SECONDS) + 10) / 10

    def levels(low: float, high: float) -> np.ndarray:
        values = np.concatenate([np.full(rng.integers(4, 13), rng.uniform(low, high)) for _ in range(len(at) // 4)])
        return values[: len(at)]

    return Inputs(OrderedDict(steer=Held.of(at, levels(-0.8, 0.8)), drive=Held.of(at, levels(0.25, 0.55))))


def windows(truth: Model, recordings: int, heldout: int, seed: int) -> Case:
    """A case of windows of `recordings` train and `heldout` held-out recordings of `truth`; its car does not slip."""
    rng, runs = np.random.default_rng(seed), []
    times = np.arange(round(SECONDS / FRAME)) * FRAME
    for number in range(recordings + heldout):
        gait = commands(rng)
        pose = np.asarray(simulate(truth, gait, jnp.asarray(times), (0.0, 0.0, 0.0, 1.2, 0.0, 0.0)).pose)
        pose = disturbed(pose, rng) + rng.normal(size=pose.shape) * [6e-5, 6e-5, 7e-4]
        role, name, n = "train" if number < recordings else "heldout", f"lap{number}", round(WINDOW / FRAME)
        for first in range(0, len(times) - n + 1, n):
            cut = slice(first, first + n)
            where = f"{name}@{times[first]:.1f}"
            run = Run(where, role, jnp.asarray(times[cut]), jnp.asarray(pose[cut]), gait, moving=True, cut_from=name)
            runs.append(run)
    board = Car(**DART, **CONSTANTS, creep_speed=0.1, unknown=ESTIMATED)
    return Case("made-up", "a made-up car", "ideal", board, tuple(runs), NOISE)
