"""How far off a simulation is so long after a lead-in: the error that a user of a model meets.

At many moments of a recording the state is estimated from the `lead` seconds before alone; from there the model is
simulated under the commands, and compared with what was measured 1, 2, 3 s later.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError
from snakejax.core.local_polynomials import difference_noise
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import AHEAD, HISTORY, Held
from snakejax.dynamics.signals import AbstractSignal
from snakejax.recording.continuous import LEAST_MOTION, continuous_parts, mean_speed
from snakejax.recording.run import Noise, Run

from .problem import Problem
from .replay import replayed

STRIDE = 0.5
"""Time [s] between the moments from which is predicted."""
MOST_FRAMES = 40
"""Frames of a lead-in that are used, evenly spaced; the last one always is."""
FEWEST_FRAMES = 5
STRENGTHS = (0.0, *np.logspace(0, 9, 28))
"""Model errors that are tried: by how much the variance of the oldest frame of a lead-in is larger than its noise."""
LEAST_NOISE = 1e-6
"""Lower limit of the noise [m, rad], so that a recording without noise has finite weights."""


class PredictionError(NamedTuple):
    """Errors after one horizon: medians and 90% of distance [m] and of heading [rad], over so many `windows`."""

    position: float
    heading: float
    position_90: float
    heading_90: float
    windows: int


class PredictionWindow(NamedTuple):
    """A lead-in and what was measured after it: `run` holds the `lead_frames` of the lead-in, then NaN at the horizons;
    `known` are the numbers of those that were measured, `measured` (h, 3) the poses there; `noise` (3,) of a frame."""

    group: str
    run: Run
    lead_frames: int
    known: tuple[int, ...]
    measured: Float[np.ndarray, "h 3"]
    noise: Float[np.ndarray, "3"]


def group_of(run: Run) -> str:
    """The group of a run: that of case.toml, or its role."""
    return run.role if run.group is None else run.group


def prediction_windows(recordings: Sequence[Run], lead: float, horizons: Sequence[float]) -> list[PredictionWindow]:
    """All windows of `lead` [s] in the parts of `recordings` without gap or jump, one every `STRIDE` seconds.

    A window counts where the vehicle moves during its lead-in and at least the first of the `horizons` [s] was
    measured. **Raises:** `InputError` where there is none.
    """
    windows = []
    for recording in recordings:
        times, pose = np.asarray(recording.times), np.asarray(recording.pose)
        noise = frame_noise(pose)
        for part in continuous_parts(times, pose):
            first, last = times[part[0]], times[part[-1]]
            count = int(np.floor((last - first - lead - horizons[0]) / STRIDE + 1e-9)) + 1
            for k in range(max(count, 0)):
                window = _window(recording, part, first + lead + k * STRIDE, lead, horizons)
                if window is not None:
                    windows.append(window._replace(noise=noise))
    if not windows:
        what = f"No part of a recording has {lead:g} s of motion and then {horizons[0]:g} s without a gap"
        raise InputError(what, "option --horizon", "take a shorter --lead or --horizon")
    return windows


def _window(
    recording: Run, part: np.ndarray, origin: float, lead: float, horizons: Sequence[float]
) -> PredictionWindow | None:
    times, pose = np.asarray(recording.times)[part], np.asarray(recording.pose)[part]
    lead_frames = np.flatnonzero((times >= origin - lead - 1e-9) & (times <= origin + 1e-9))
    if len(lead_frames) < FEWEST_FRAMES or not mean_speed(times[lead_frames], pose[lead_frames]) > LEAST_MOTION:
        return None
    step = -(-len(lead_frames) // MOST_FRAMES)
    lead_frames = lead_frames[::-1][::step][::-1]
    known = tuple(i for i, h in enumerate(horizons) if origin + h <= times[-1] + 1e-9)
    ends = np.array([origin + horizons[i] for i in known])
    measured = np.stack([np.interp(ends, times, pose[:, c]) for c in range(3)], axis=1)
    # A recording that ends sooner is simulated all the same, so that all windows have one size.
    horizon_times = np.array([origin + h for h in horizons])
    inputs = _kept(recording.gait, times[lead_frames[0]] - HISTORY, horizon_times[-1] + AHEAD)
    at = np.concatenate([times[lead_frames], horizon_times])
    poses = np.concatenate([pose[lead_frames], np.full((len(horizon_times), 3), np.nan)])
    name = f"{recording.name}@{origin:.2f}"
    run_options = {"moving": True, "labels": recording.labels}
    run = Run(name, recording.role, jnp.asarray(at), jnp.asarray(poses), inputs, recording.payload, **run_options)
    return PredictionWindow(group_of(recording), run, len(lead_frames), known, measured, np.ones(3))


def _kept(inputs: AbstractInputs, first: float, last: float) -> AbstractInputs:
    """`inputs` with the samples of bare held commands that matter from `first` to `last` [s]."""

    def cut(part: AbstractSignal) -> AbstractSignal:
        if type(part) is not Held:
            return part
        knots = np.asarray(part.knots)
        a = max(int(np.searchsorted(knots, first, side="right")) - 1, 0)
        b = max(int(np.searchsorted(knots, last)), a + 1)
        return Held(part.knots[a:b], part.values[a:b])

    return jax.tree.map(cut, inputs, is_leaf=lambda part: isinstance(part, AbstractSignal))


def frame_noise(pose: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The noise (3,) of one frame, x and y alike, by the third differences of what was seen. What it is of a vehicle in
    motion counts, so frames that repeat the one before are left out."""
    measured = pose[np.isfinite(pose).all(axis=1)]
    measured = measured[np.concatenate([[True], (np.diff(measured, axis=0) != 0).any(axis=1)])]
    if len(measured) < 8:
        return np.full(3, LEAST_NOISE)
    sd = difference_noise(measured, 3)
    place = float(np.sqrt((sd[0] ** 2 + sd[1] ** 2) / 2))
    return np.maximum([place, place, sd[2]], LEAST_NOISE)


def predicted(model: Model, windows: Sequence[PredictionWindow]) -> list[Float[np.ndarray, "h 3"]]:
    """What `model` predicts at the horizons of each of `windows` that were measured: poses (h, 3).

    The state at the end of a lead-in is that of a simulation fitted to it. Where the model leaves more than noise, its
    error grows with time: the variance of a frame of age a is taken as noise^2 (1 + c (a / lead)^3), that of a random
    acceleration, with the least c of `STRENGTHS` under which no more than noise is left.
    """
    problem = Problem.of(model, [_lead_of(w) for w in windows], Noise(jnp.ones(()), jnp.ones(()), source="none"), (), 1)
    noise = np.stack([w.noise for w in windows])[:, None, :]
    measured = np.asarray(problem.batch.weight) > 0
    problem = _weighted(problem, np.where(measured, 1 / noise, 0.0))
    all_windows = range(len(windows))
    equal_weights = problem.fit({}, (), all_windows)
    factor = _older_counts_less(problem, equal_weights, measured)
    problem = _weighted(problem, np.where(measured, factor[..., None] / noise, 0.0))
    aged_weights = problem.fit({}, (), all_windows, equal_weights.start)
    poses = replayed(model, [w.run for w in windows], np.asarray(aged_weights.start))
    return [pose[w.lead_frames + np.array(w.known)] for pose, w in zip(poses, windows, strict=True)]


def _lead_of(window: PredictionWindow) -> Run:
    """The run of a window without its horizons."""
    run = window.run
    return dataclasses.replace(run, times=run.times[: window.lead_frames], pose=run.pose[: window.lead_frames])


def _weighted(problem: Problem, weight: np.ndarray) -> Problem:
    return eqx.tree_at(lambda p: p.batch.weight, problem, jnp.asarray(weight))


def _older_counts_less(problem: Problem, equal_weights, measured: np.ndarray) -> Float[np.ndarray, "R n"]:
    """1 / sqrt(1 + c (a / lead)^3) of every frame, a its age, by the linear problem at `equal_weights`."""
    times = np.asarray(problem.batch.times)
    factor = np.ones(times.shape)
    for k in range(len(times)):
        frames = np.flatnonzero(measured[k, :, 0])
        age = times[k, frames[-1]] - times[k, frames]
        share = (age / max(age[0], 1e-9)) ** 3
        r = np.asarray(equal_weights.linearised.residual[k])[frames]
        J = np.asarray(equal_weights.linearised.jacobian[k])[frames][..., 1:]
        if not (np.isfinite(r).all() and np.isfinite(J).all()):
            continue
        for c in STRENGTHS:
            factor[k, frames] = 1 / np.sqrt(1 + c * share)
            w = np.repeat(factor[k, frames], 3)
            A, b = J.reshape(len(w), -1) * w[:, None], r.reshape(-1) * w
            left = b - A @ np.linalg.lstsq(A, b, rcond=1e-10)[0]
            if (left**2).sum() <= max(len(w) - np.linalg.matrix_rank(A), 1):
                break
    return factor


def prediction_errors(
    windows: Sequence[PredictionWindow], poses: Sequence[Float[np.ndarray, "h 3"]], horizons: Sequence[float]
) -> dict[str, dict[str, PredictionError]]:
    """{group: {horizon: error}} of the `poses` predicted in `windows`; a horizon that no window has is left out."""
    collected: dict[str, dict[str, list[np.ndarray]]] = {}
    for window, pose in zip(windows, poses, strict=True):
        off = pose - window.measured
        for i, error in zip(window.known, off, strict=True):
            turned = abs(np.angle(np.exp(1j * error[2]))) if np.isfinite(error[2]) else np.inf
            by_horizon = collected.setdefault(window.group, {})
            by_horizon.setdefault(f"{horizons[i]:g}", []).append(np.array([np.hypot(error[0], error[1]), turned]))
    return {g: {h: _pooled(np.array(rows)) for h, rows in by.items()} for g, by in collected.items()}


def _pooled(rows: Float[np.ndarray, "w 2"]) -> PredictionError:
    rows = np.where(np.isfinite(rows), rows, np.inf)
    middle = np.median(rows, axis=0)
    most = np.quantile(rows, 0.9, axis=0, method="higher")
    return PredictionError(float(middle[0]), float(middle[1]), float(most[0]), float(most[1]), len(rows))


Predictions = Mapping[str, Mapping[str, Mapping[str, PredictionError]]]
"""{group: {model: {horizon: error}}}."""
