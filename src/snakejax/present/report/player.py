"""The frames of the player: the measured vehicle and that of each model."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snakejax.diagnosis.residuals.replays import RunReplay
from snakejax.dynamics.vehicle import AbstractVehicle, Stroke

from ..as_json.values import Json
from ..style import MEASURED
from ..views import ModelView
from .chart import plain

RATE = 20.0
"""Frame rate [Hz]."""
MOST = 1500
"""The largest number of frames of a run; a longer run has a lower frame rate."""
LONGEST_SKID = 1.2
"""The bar of the fastest slip in a movie, in lengths of the vehicle."""


def movie(models: Sequence[ModelView], vehicle: AbstractVehicle) -> Json:
    """The frames of every run, measured and under each of `models`.

    {length, outline: [{points, part, pivot}], wheels: [wheelset][{points}], measured, skid: length of a bar [m] for a
    slip speed of 1 m/s, runs: [{run, t, x, y, heading, models: {key: {x, y, heading, joints: {part: [frame]}, wheels:
    [wheelset]{x, y, angle}, slip: [wheelset][frame], colour}}}]}; what does not change is a number in place of a list.
    """
    fastest = max(float(np.abs(scene.slip_speed).max()) for model in models for scene in model.scenes)
    length, outline = float(vehicle.length), vehicle.outline()
    parts = {stroke.part for stroke in outline} - {"base"}
    return {
        "length": length,
        "outline": [_stroke(stroke) for stroke in outline],
        "wheels": [[_stroke(stroke) for stroke in vehicle.wheel_outline(one)] for one in vehicle.wheelsets],
        "measured": MEASURED.colour,
        "skid": LONGEST_SKID * length / max(fastest, 1e-9),
        "runs": [_run(k, scene, models, parts) for k, scene in enumerate(models[0].scenes)],
    }


def _stroke(stroke: Stroke) -> Json:
    points = [plain(np.array(point)) for point in stroke.points]
    return {"points": points, "part": stroke.part, "pivot": plain(np.array(stroke.pivot))}


def pictures(times: np.ndarray) -> np.ndarray:
    """The indices of the samples that are shown."""
    step = float(times[-1] - times[0]) / (times.size - 1)
    stride = max(round(1 / (RATE * step)), -(-times.size // MOST), 1)
    return np.arange(0, times.size, stride)


def _run(k: int, scene: RunReplay, models: Sequence[ModelView], parts: set[str]) -> Json:
    shown = pictures(scene.times)
    own = _pose(scene.measured[shown])
    return {
        "run": scene.run,
        "t": plain(scene.times[shown]),
        **own,
        "models": {m.key: _model(m, k, shown, parts) for m in models},
    }


def _model(model: ModelView, k: int, shown: np.ndarray, parts: set[str]) -> Json:
    scene = model.scenes[k]
    return {
        **_pose(scene.pose[shown]),
        "joints": {part: _frames(scene.joints[part][shown]) for part in sorted(parts)},
        "wheels": [
            {name: _frames(column) for name, column in zip(("x", "y", "angle"), wheel, strict=True)}
            for wheel in scene.wheels[shown].transpose(1, 2, 0)
        ],
        "slip": [plain(column) for column in scene.slip_speed[shown].T],
        "colour": model.look.colour,
    }


def _frames(values: np.ndarray) -> Any:
    """A list with one number for each frame, or the number where all are the same."""
    return plain(values) if np.ptp(values) else plain(values)[0]


def _pose(pose: np.ndarray) -> dict[str, Any]:
    return {name: plain(column) for name, column in zip(("x", "y", "heading"), pose.T, strict=True)}
