"""The error of a simulation a given time after a known pose."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.estimation.fitted_model import FittedModel

HORIZONS = (1.0, 3.0, 10.0)
"""Times [s] after which errors are shown."""
APART = 0.25
"""Time [s] between the poses that are taken as known."""


class HorizonError(NamedTuple):
    """Root mean square error `position_m` and `heading_rad` after `seconds`, over `windows` known poses."""

    seconds: float
    position_m: float
    heading_rad: float
    windows: int


def horizon_errors(fitted: FittedModel, role: str, horizons: Sequence[float] = HORIZONS) -> tuple[HorizonError, ...]:
    """The errors of `fitted` in the runs of `role` after each of `horizons` [s] that these runs are long enough for.

    The simulated path of a whole run is laid on the measured one at each known pose, and compared `seconds` later: with
    pose (x, y, h) the path ahead is R(-h_0) (x - x_0, y - y_0), h - h_0. Velocities are those of the simulation.
    """
    rows = []
    for seconds in horizons:
        errors = [_errors(fitted, k, seconds) for k in fitted.numbered(role)]
        errors = [error for error in errors if len(error)]
        if errors:
            square = np.mean(np.concatenate(errors) ** 2, axis=0)
            count = sum(map(len, errors))
            rows.append(HorizonError(seconds, float(np.sqrt(square[0] + square[1])), float(np.sqrt(square[2])), count))
    return tuple(rows)


def _errors(fitted: FittedModel, run: int, seconds: float) -> Float[np.ndarray, "k 3"]:
    """Measured less simulated path ahead [m, m, rad] of one run, for each known pose."""
    times, measured = (np.asarray(part) for part in (fitted.recordings[run].times, fitted.recordings[run].pose))
    simulated = measured - fitted.residuals[run] * np.asarray(fitted.noise.channels)
    frame = float(np.median(np.diff(times)))
    first = np.arange(0, len(times), max(1, round(APART / frame)))
    last = np.searchsorted(times, times[first] + seconds - 0.5 * frame)
    first, last = first[last < len(times)], last[last < len(times)]
    ahead = _path_ahead(measured, first, last) - _path_ahead(simulated, first, last)
    return ahead[np.isfinite(ahead).all(axis=1)]


def _path_ahead(pose: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    moved, heading = pose[last] - pose[first], pose[first, 2]
    along = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
    across = moved[:, 1] * np.cos(heading) - moved[:, 0] * np.sin(heading)
    return np.stack([along, across, moved[:, 2]], axis=1)
