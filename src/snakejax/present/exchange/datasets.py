"""Recorded runs and residuals as xarray datasets and pandas tables."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from snakejax.diagnosis.residuals.replays import replay_runs
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.estimation.fit_record import Fit
from snakejax.recording.run import Case, Run

if TYPE_CHECKING:
    from pandas import DataFrame

UNITS = {"time_s": "s", "x_m": "m", "y_m": "m", "heading_rad": "rad"}
POSE = ("x_m", "y_m", "heading_rad")


def runs_dataset(runs: Case | Run | Sequence[Run]) -> xr.Dataset:
    """The recorded `runs` with the dimensions `run` and `sample`.

    `time_s` [s], `x_m`, `y_m` [m] and the unwrapped `heading_rad` [rad]; `role` is a coordinate of `run`. NaN where a
    frame was lost, and after the end of a run that is shorter than the longest.
    """
    recorded = _runs(runs)
    columns = {name: [np.asarray(run.pose)[:, k] for run in recorded] for k, name in enumerate(POSE)}
    return _dataset(recorded, columns)


def residuals_dataset(fit: Fit | SelectionStep) -> xr.Dataset:
    """Measured, modelled and residual poses of a fitted model with the dimensions `run` and `sample`.

    `x_m`, `y_m`, `heading_rad`: as measured; with `_modelled`: of the model; with `_residual`: measured minus modelled
    [m, m, rad]; with `_residual_sd`: the same in standard deviations of the noise. NaN as in `runs_dataset`.
    """
    fitted = fit.fitted
    replays = replay_runs(fitted)
    tracks = [replay.track for replay in replays]
    columns: dict[str, list[Any]] = {}
    for k, name in enumerate(POSE):
        columns[name] = [replay.measured[:, k] for replay in replays]
        columns[f"{name}_modelled"] = [replay.pose[:, k] for replay in replays]
        columns[f"{name}_residual"] = [track.residual[:, k] * track.sd[k] for track in tracks]
        columns[f"{name}_residual_sd"] = [track.residual[:, k] for track in tracks]
    return _dataset(fitted.recordings, columns)


def runs_dataframe(runs: Case | Run | Sequence[Run]) -> "DataFrame":
    """`runs_dataset` as a pandas table with a row for each frame: run, role, time_s, x_m, y_m, heading_rad."""
    return _table(runs_dataset(runs))


def residuals_dataframe(fit: Fit | SelectionStep) -> "DataFrame":
    """`residuals_dataset` as a pandas table with a row for each frame."""
    return _table(residuals_dataset(fit))


def _runs(runs: Case | Run | Iterable[Run]) -> tuple[Run, ...]:
    if isinstance(runs, Case):
        return runs.runs
    return (runs,) if isinstance(runs, Run) else tuple(runs)


def _dataset(runs: Sequence[Run], columns: dict[str, list[Float[np.ndarray, " n"]]]) -> xr.Dataset:
    length = max(run.times.shape[0] for run in runs)
    parts = {"time_s": [np.asarray(run.times) for run in runs], **columns}
    data = {
        name: (("run", "sample"), np.stack([_padded(row, length) for row in rows]), {"units": _unit(name)})
        for name, rows in parts.items()
    }
    coordinates = {"run": [run.name for run in runs], "role": ("run", [run.role for run in runs])}
    return xr.Dataset(data, coords={**coordinates, "sample": np.arange(length)})


def _unit(name: str) -> str:
    return "1" if name.endswith("_sd") else next(unit for start, unit in UNITS.items() if name.startswith(start))


def _padded(row: Float[np.ndarray, " n"], length: int) -> Float[np.ndarray, " m"]:
    return np.concatenate([row, np.full(length - row.shape[0], np.nan)])


def _table(data: xr.Dataset) -> "DataFrame":
    table = data.to_dataframe().reset_index()
    table = table.dropna(subset=["time_s"]).reset_index(drop=True)
    return table.filter(items=["run", "role", *map(str, data.data_vars)])
