"""Differentiable simulation and parameter fitting for the skidding snakeboard.

Names are imported when first used, so that `snakejax --help` need not wait for JAX.
"""

import importlib
import importlib.metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._align import fit_logged as fit_logged
    from ._bed import Bed as Bed
    from ._bed import bed as bed
    from ._bed import most_confusable as most_confusable
    from ._board import TABLE_II as TABLE_II
    from ._board import Board as Board
    from ._board import Wheelset as Wheelset
    from ._case import load_case as load_case
    from ._check import check as check
    from ._cluster import cluster as cluster
    from ._diagnose import Diagnosis as Diagnosis
    from ._diagnose import diagnose as diagnose
    from ._discriminate import Separation as Separation
    from ._discriminate import Sharpening as Sharpening
    from ._discriminate import separate as separate
    from ._discriminate import sharpen as sharpen
    from ._draws import draws as draws
    from ._effect import Clock as Clock
    from ._effect import Command as Command
    from ._effect import Effect as Effect
    from ._effect import Floor as Floor
    from ._effect import Force as Force
    from ._effect import Grip as Grip
    from ._effect import Layout as Layout
    from ._effect import Linkage as Linkage
    from ._effect import Memory as Memory
    from ._effect import Motion as Motion
    from ._effect import Rolling as Rolling
    from ._effect import Sensor as Sensor
    from ._effect import Wheel as Wheel
    from ._errors import FitError as FitError
    from ._errors import InputError as InputError
    from ._explain import Explanation as Explanation
    from ._explain import explain as explain
    from ._fit import Fit as Fit
    from ._fit import fit as fit
    from ._gait import Gait as Gait
    from ._gait import Logged as Logged
    from ._gait import Sines as Sines
    from ._gait import Tracked as Tracked
    from ._lanes import simulate_many as simulate_many
    from ._lanes import stacked as stacked
    from ._limits import Limits as Limits
    from ._missing import Missing as Missing
    from ._model import Model as Model
    from ._objective import Distance as Distance
    from ._objective import Effort as Effort
    from ._objective import Objective as Objective
    from ._objective import Own as Own
    from ._objective import Ran as Ran
    from ._objective import Reach as Reach
    from ._objective import Turn as Turn
    from ._prepare import prepare_jax as prepare_jax
    from ._presets import Preset as Preset
    from ._presets import preset as preset
    from ._profile import profile as profile
    from ._ran import Driver as Driver
    from ._rayleigh import Polynomial as Polynomial
    from ._rayleigh import nearest_rayleigh as nearest_rayleigh
    from ._rayleigh import polynomial as polynomial
    from ._recording import Case as Case
    from ._recording import LogClock as LogClock
    from ._recording import Noise as Noise
    from ._recording import Run as Run
    from ._shapes import Fourier as Fourier
    from ._shapes import Spline as Spline
    from ._shapes import Sums as Sums
    from ._shapes import spline as spline
    from ._simulate import Accuracy as Accuracy
    from ._simulate import Trajectory as Trajectory
    from ._simulate import motions as motions
    from ._simulate import simulate as simulate
    from ._stage import Stage as Stage
    from ._starter import starter as starter
    from ._starting import starting_model as starting_model
    from ._sweep import Axes as Axes
    from ._sweep import grid as grid
    from ._sweep import sweep as sweep
    from ._sweep import table as table
    from ._torque import effort as effort
    from ._torque import torques as torques
    from ._tune import Tuned as Tuned
    from ._tune import joint_log as joint_log
    from ._tune import tune as tune
    from ._tyre import Bakker as Bakker
    from ._tyre import Pacejka as Pacejka
    from ._tyre import Rayleigh as Rayleigh
    from ._units import Scalar as Scalar
    from ._units import param as param
    from .quality import Finding as Finding
    from .quality import Inspection as Inspection
    from .quality import estimate_noise as estimate_noise
    from .quality import inspected as inspected
    from .quality import marker_noise as marker_noise
    from .quality import noise_of as noise_of
    from .quality import noise_sources as noise_sources
    from .readers import Capture as Capture
    from .readers import Hints as Hints
    from .readers import read_capture as read_capture
    from .readers import read_track as read_track
    from .readers import write_csv as write_csv
    from .readers import write_tum as write_tum

_HOMES = {
    "_align": "fit_logged",
    "_board": "TABLE_II Board Wheelset",
    "_case": "load_case",
    "_check": "check",
    "_cluster": "cluster",
    "_bed": "Bed bed most_confusable",
    "_diagnose": "Diagnosis diagnose",
    "_discriminate": "Separation Sharpening separate sharpen",
    "_draws": "draws",
    "_effect": "Clock Command Effect Floor Force Grip Layout Linkage Memory Motion Rolling Sensor Wheel",
    "_errors": "FitError InputError",
    "_explain": "Explanation explain",
    "_fit": "Fit fit",
    "_gait": "Gait Logged Sines Tracked",
    "_lanes": "simulate_many stacked",
    "_limits": "Limits",
    "_missing": "Missing",
    "_model": "Model",
    "_objective": "Distance Effort Objective Own Ran Reach Turn",
    "_prepare": "prepare_jax",
    "_presets": "Preset preset",
    "_profile": "profile",
    "_ran": "Driver",
    "_rayleigh": "Polynomial nearest_rayleigh polynomial",
    "_recording": "Case LogClock Noise Run",
    "_shapes": "Fourier Spline Sums spline",
    "_simulate": "Accuracy Trajectory motions simulate",
    "_stage": "Stage",
    "_starter": "starter",
    "_starting": "starting_model",
    "_sweep": "Axes grid sweep table",
    "_torque": "effort torques",
    "_tune": "Tuned joint_log tune",
    "_tyre": "Bakker Pacejka Rayleigh",
    "_units": "Scalar param",
    "readers": "Capture Hints read_capture read_track write_csv write_tum",
    "quality": "Finding Inspection estimate_noise inspected marker_noise noise_of noise_sources",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.metadata.version("snakejax")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, "__version__"})
