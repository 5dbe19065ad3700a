"""How far off a simulation is so long after a lead-in: the error that a user of a model meets.

At many moments of a recording the state is estimated from the `lead` seconds before alone; from there the model is
simulated under the commands, and compared with what was measured 1, 2, 3 s later.
"""

import bisect
import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.errors import InputError
from snakejax.core.local_polynomials import difference_noise
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import AHEAD, HISTORY, Held
from snakejax.dynamics.signals import AbstractSignal
from snakejax.recording.continuous import LEAST_MOTION, continuous_parts, mean_speed
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import simulate

from .batch import Batch
from .many_runs import Ending, solve_starts
from .problem import Problem, Solution
from .replay import ACCURACY, replayed

STRIDE = 0.5
"""Time [s] between the moments from which is predicted."""
MOST_FRAMES = 40
"""Frames of a lead-in that are used, evenly spaced; the last one always is."""
FEWEST_FRAMES = 5
STRENGTHS = (0.0, *np.logspace(0, 9, 28))
"""Model errors that are tried: by how much the variance of the oldest frame of a lead-in is larger than its noise."""
EARLY = 0.6
"""The part of a lead-in by which its end is predicted, to choose the prior of the velocities."""
RATIOS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Strengths of that prior, in multiples of 1 / median deviation of the velocities: from none to their mean itself."""
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

    The state at the end of a lead-in is that of a simulation fitted to it, with the weights of `LeadIn.settled` and the
    prior of `prior_strength`: many vehicles soon move as their commands say, whatever their velocities were, so the
    mean of the start velocities is what they are after `HISTORY` seconds from rest under the commands before.
    """
    problem = Problem.of(model, [_lead_of(w) for w in windows], Noise(jnp.ones(()), jnp.ones(()), source="none"), (), 1)
    noise = np.stack([w.noise for w in windows])[:, None, :]
    measured = np.asarray(problem.batch.weight) > 0
    problem = _weighted(problem, np.where(measured, 1 / noise, 0.0))
    fitted = problem.fit({}, (), range(len(windows)))
    mean = _start_under_commands(problem, fitted.start)
    lead_ins = _lead_ins(problem, fitted, mean)
    strength = prior_strength([*lead_ins.values()])
    factor = np.ones(measured.shape[:2])
    for k, lead_in in lead_ins.items():
        factor[k, measured[k, :, 0]] = lead_in.settled(strength)[1]
    problem = _weighted(problem, np.where(measured, factor[..., None] / noise, 0.0))
    starts = _starts_under_prior(problem, fitted.start, mean, strength)
    poses = replayed(model, [w.run for w in windows], starts)
    return [pose[w.lead_frames + np.array(w.known)] for pose, w in zip(poses, windows, strict=True)]


def _lead_of(window: PredictionWindow) -> Run:
    """The run of a window without its horizons."""
    run = window.run
    return dataclasses.replace(run, times=run.times[: window.lead_frames], pose=run.pose[: window.lead_frames])


def _weighted(problem: Problem, weight: np.ndarray) -> Problem:
    return eqx.tree_at(lambda p: p.batch.weight, problem, jnp.asarray(weight))


class LeadIn(NamedTuple):
    """The linear problem of one lead-in of n frames at a start state of S numbers: `age` (n,) [s] of its frames,
    `residual` (n, 3) and `jacobian` (n, 3, S) in multiples of the noise, and `deviation` (S,) of the start state from
    the mean of its prior."""

    age: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, "n 3"]
    jacobian: Float[np.ndarray, "n 3 S"]
    deviation: Float[np.ndarray, " S"]

    def of(self, frames: np.ndarray) -> "LeadIn":
        """The same with these `frames` alone."""
        age = self.age[frames]
        return LeadIn(age - age[-1], self.residual[frames], self.jacobian[frames], self.deviation)

    def settled(self, strength: Float[np.ndarray, " S"]) -> tuple[np.ndarray, np.ndarray]:
        """The step (S,) of the start state under a prior with 1 / standard deviation `strength` (S,), and the factors
        (n,) of the weights of the frames.

        Where the model leaves more than noise, its error grows with time: the variance of a frame of age a is taken as
        noise^2 (1 + c (a / lead)^3), that of a random acceleration, with the least c of `STRENGTHS` under which no more
        than noise is left.
        """
        share = (self.age / max(self.age[0], 1e-9)) ** 3

        def under(c: float) -> tuple[np.ndarray, np.ndarray, bool]:
            factor = 1 / np.sqrt(1 + c * share)
            weight = np.repeat(factor, 3)
            rows, off = self.jacobian.reshape(len(weight), -1) * weight[:, None], self.residual.reshape(-1) * weight
            A, b = np.concatenate([rows, np.diag(strength)]), np.concatenate([off, strength * self.deviation])
            step = -np.linalg.lstsq(A, b, rcond=1e-10)[0]
            left = off + rows @ step
            return step, factor, bool((left**2).sum() <= max(len(left) - np.linalg.matrix_rank(rows), 1))

        least = bisect.bisect_left(STRENGTHS, True, key=lambda c: under(c)[2])
        return under(STRENGTHS[min(least, len(STRENGTHS) - 1)])[:2]


def prior_strength(lead_ins: Sequence[LeadIn]) -> Float[np.ndarray, " S"]:
    """1 / standard deviation (S,) of the prior of the start velocities, zero where it does not help.

    Each of `lead_ins` is predicted by its first `EARLY` alone; the last frames tell the error q, in multiples of the
    noise. The strength, a multiple `RATIOS` of 1 / median deviation for each velocity, is the one of least
    sum of ln(1 + q^2 / s^2), with s^2 the median of q^2 without prior.
    """
    parts = [(one.of(early), one.of(~early)) for one in lead_ins if 3 <= (early := _early(one)).sum() < len(early)]
    if not parts:
        return np.zeros(6)
    unit = np.median([abs(one.deviation) for one, _ in parts], axis=0)
    unit = np.divide(1.0, unit, out=np.zeros_like(unit), where=unit > 0)

    def late_error(ratio: np.ndarray) -> Float[np.ndarray, " R"]:
        steps = [early.settled(ratio * unit)[0] for early, _ in parts]
        off = (late.residual + late.jacobian @ step for step, (_, late) in zip(steps, parts, strict=True))
        return np.array([(q**2).mean() for q in off])

    scale = max(float(np.median(late_error(np.zeros(len(unit))))), LEAST_NOISE)

    def cost(ratio: np.ndarray) -> float:
        return float(np.log1p(late_error(ratio) / scale).sum())

    # All velocities together first: one alone may not help.
    best = min((np.full(len(unit), ratio) for ratio in RATIOS), key=cost)
    for k in np.flatnonzero(unit):
        trials = [np.where(np.arange(len(unit)) == k, ratio, best) for ratio in RATIOS]
        best = min(trials, key=cost)
    return best * unit


def _early(lead_in: LeadIn) -> np.ndarray:
    return lead_in.age >= (1 - EARLY) * lead_in.age[0]


def _lead_ins(problem: Problem, fitted: Solution, mean: Float[np.ndarray, "R S"]) -> dict[int, LeadIn]:
    """The lead-ins by number at the optimum `fitted`, without those that cannot be simulated there."""
    residual, jacobian = (np.asarray(part) for part in fitted.linearised)
    times, measured = np.asarray(problem.batch.times), np.asarray(problem.batch.weight)[..., 0] > 0
    S = mean.shape[1]
    lead_ins = {}
    for k, frames in enumerate(measured):
        r, J, t = residual[k][frames], jacobian[k][frames][..., -S:], times[k][frames]
        if np.isfinite(r).all() and np.isfinite(J).all():
            lead_ins[k] = LeadIn(t[-1] - t, r, J, fitted.start[k] - mean[k])
    return lead_ins


def _start_under_commands(problem: Problem, start: Float[np.ndarray, "R S"]) -> Float[np.ndarray, "R S"]:
    """`start` with the velocities of the model after `HISTORY` seconds from rest under the commands, where it has any
    to estimate."""
    velocities = np.asarray(_velocities_under_commands(problem.model, problem.batch))
    known = np.isfinite(velocities) & (np.asarray(problem.batch.free_start)[:, 3:] > 0)
    return np.concatenate([start[:, :3], np.where(known, velocities, start[:, 3:])], axis=1)


@eqx.filter_jit
def _velocities_under_commands(model: Model, runs: Batch) -> Float[Array, "R 3"]:
    """The velocities (R, 3) at the first frame of every run, from rest `HISTORY` seconds before; NaN where the model
    has fewer or cannot be simulated."""

    def settled(times, gait, payload, codes):
        begins = jnp.stack([times[0] - HISTORY, times[0]])
        moved = simulate(model.in_run(payload, codes), gait, begins, jnp.zeros(6), accuracy=ACCURACY, throw=False)
        velocities = moved.state[0][3:6]
        if len(velocities) < 3:
            return jnp.full(3, jnp.nan)
        return jnp.where(moved.finished, jnp.stack([v[-1] for v in velocities]), jnp.nan)

    return jax.lax.map(lambda run: settled(*run), (runs.times, runs.gait, runs.payload, runs.codes))


def _starts_under_prior(
    problem: Problem, start: np.ndarray, mean: np.ndarray, strength: np.ndarray
) -> Float[np.ndarray, "R S"]:
    """The start states (R, S) of least chi^2 + |strength (start - mean)|^2, from `start`."""
    S = start.shape[1]
    below = np.diag(strength)

    def with_prior(steps: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linearised = problem.evaluate(problem.at({}, (), start + steps), numbers.tolist())
        r, J = (np.asarray(part)[numbers].reshape(len(numbers), -1, *part.shape[3:]) for part in linearised)
        off = (start + steps - mean)[numbers] * strength
        rows = np.broadcast_to(below, (len(numbers), S, S))
        return np.concatenate([r, off], axis=1), np.concatenate([J[..., -S:], rows], axis=1)

    samples = int((np.asarray(problem.batch.weight) > 0).sum())
    free = np.asarray(problem.batch.free_start)
    return start + free * solve_starts(with_prior, lambda parts: parts, free, 0, Ending(0.05, 0.0, samples, 60)).starts


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
