"""The frames of the player: the measured board and that of each model."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snakejax.diagnosis.residuals.replays import RunReplay
from snakejax.dynamics.vehicle import AbstractVehicle

from ..as_json.values import Json
from ..style import MEASURED
from ..views import ModelView
from .chart import plain

RATE = 20.0
"""Frame rate [Hz]."""
MOST = 1500
"""The largest number of frames of a run; a longer run has a lower frame rate."""
LONGEST_SKID = 1.2
"""The bar of the fastest slip in a movie, in half lengths."""


def movie(models: Sequence[ModelView], board: AbstractVehicle) -> Json:
    """The frames of every run, measured and under each of `models`.

    {half_length, places, measured, skid: length of a bar [m] for a slip speed of 1 m/s, runs: [{run, t, x, y, heading,
    models: {key: {x, y, heading, rotor, steered: [wheelset][frame], slip: the same, colour}}}]}
    """
    fastest = max(float(np.abs(scene.slip_speed).max()) for model in models for scene in model.scenes)
    half = float(board.length)
    return {
        "half_length": half,
        "places": [float(wheelset.place) for wheelset in board.wheelsets],
        "measured": MEASURED.colour,
        "skid": LONGEST_SKID * half / max(fastest, 1e-9),
        "runs": [_run(k, scene, models) for k, scene in enumerate(models[0].scenes)],
    }


def pictures(times: np.ndarray) -> np.ndarray:
    """The indices of the samples that are shown."""
    step = float(times[-1] - times[0]) / (times.size - 1)
    stride = max(round(1 / (RATE * step)), -(-times.size // MOST), 1)
    return np.arange(0, times.size, stride)


def _run(k: int, scene: RunReplay, models: Sequence[ModelView]) -> Json:
    shown = pictures(scene.times)
    own = _pose(scene.measured[shown])
    return {
        "run": scene.run,
        "t": plain(scene.times[shown]),
        **own,
        "models": {m.key: _model(m, k, shown) for m in models},
    }


def _model(model: ModelView, k: int, shown: np.ndarray) -> Json:
    scene = model.scenes[k]
    return {
        **_pose(scene.pose[shown]),
        "rotor": plain(scene.rotor[shown]),
        "steered": [plain(column) for column in scene.steered[shown].T],
        "slip": [plain(column) for column in scene.slip_speed[shown].T],
        "colour": model.look.colour,
    }


def _pose(pose: np.ndarray) -> dict[str, Any]:
    return {name: plain(column) for name, column in zip(("x", "y", "heading"), pose.T, strict=True)}
