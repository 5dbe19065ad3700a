"""What a vehicle does not repeat: how windows under the same constant commands differ from their mean motion."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import optimize

from snakejax.core.local_polynomials import difference_noise
from snakejax.dynamics.sampled_signals import held_signals
from snakejax.dynamics.signals import angles_at
from snakejax.recording.run import Run

from ..explanation import PoseError

STEADY = 0.02
"""A command is steady where it stays within this share of its largest size in all recordings."""
PARTS = 4
"""Equal parts of a window, whose means are compared where a command is measured and has noise of its own."""
NOISE_RANGE = 3.63
"""The range of the means of `PARTS` parts, in standard deviations, that white noise exceeds in 5% of windows."""
FEWEST = 5
"""The least number of steady windows of which a median is reported."""


def steady_windows(runs: Sequence[Run]) -> list[list[int]]:
    """The numbers of the `runs` throughout which every command is steady, those under the same commands together;
    groups of a single one are left out.

    Windows of one recording are compared with each other, and so are recordings that are a run each, of one label.
    """
    commands = [commands_of(run) for run in runs]
    largest = np.max([np.abs(values).max(axis=0) for values, _ in commands], axis=0)
    groups: list[list[int]] = []
    for k, (run, (values, noise)) in enumerate(zip(runs, commands, strict=True)):
        if not _steady(values, noise, STEADY * largest):
            continue
        for group in groups:
            first = runs[group[0]]
            alike = np.abs(values.mean(axis=0) - commands[group[0]][0].mean(axis=0)) <= STEADY * largest
            if (run.cut_from, run.labels) == (first.cut_from, first.labels) and alike.all():
                group.append(k)
                break
        else:
            groups.append([k])
    return [group for group in groups if len(group) > 1]


def commands_of(run: Run) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, " k"]]:
    """The commands of `run` at its times, and the standard deviation of the noise of each: zero where it is held."""
    times = jnp.asarray(run.times)
    signals = [run.gait.signal(name) for name in run.gait.names]
    values = np.stack([np.asarray(angles_at(signal, times)) for signal in signals], axis=1)
    held = np.array([bool(held_signals(signal)) for signal in signals])
    if len(values) < 2 * PARTS:  # Too few samples do not show their noise.
        return values, np.zeros(len(signals))
    return values, np.where(held, 0.0, difference_noise(values, 2))


def _steady(values: np.ndarray, noise: np.ndarray, allowed: np.ndarray) -> bool:
    """Whether the range of each command is at most `allowed`; where it has noise, the range of the means of the parts
    of the window is, and may be larger by what that noise does."""
    parts = np.array_split(values, PARTS)
    means = np.stack([part.mean(axis=0) for part in parts]) if len(values) >= PARTS else values
    limit = allowed + NOISE_RANGE * noise / np.sqrt(len(parts[-1]))
    return bool((np.where(noise > 0, np.ptp(means, axis=0), np.ptp(values, axis=0)) <= limit).all())


def repeatability_errors(runs: Sequence[Run], noise: Float[np.ndarray, "3"]) -> Float[np.ndarray, "W 2"]:
    """Root mean square errors [m, rad] of `runs` under the same commands about a motion with the mean yaw rate of all.

    u = u_0 + u_1 t, v = v_0, r = the mean of all runs; start pose, u_0, u_1 and v_0 are those of the run. The speed
    settles over seconds; sideways velocity and yaw rate do within a tenth of one, so that a model knows them by the
    commands alone.
    """
    free = [_fitted_motion(run, np.asarray(noise), None) for run in runs]
    rate = float(np.mean([motion[-1] for motion, _ in free]))
    # Of R runs the mean takes up a share 1 / R of the variance.
    unbiased = np.sqrt(len(runs) / (len(runs) - 1))
    return unbiased * np.array([_fitted_motion(run, np.asarray(noise), rate)[1] for run in runs])


def _fitted_motion(run: Run, noise: np.ndarray, rate: float | None) -> tuple[np.ndarray, tuple[float, float]]:
    """The numbers (7,) of the motion of one run, the last of which is its yaw `rate` unless given; and its errors."""
    times, pose = np.asarray(run.times), np.asarray(run.pose)
    measured = np.isfinite(pose).all(axis=1)
    t, pose = times[measured] - times[measured][0], pose[measured]

    def complete(p: np.ndarray) -> np.ndarray:
        return p if rate is None else np.append(p, rate)

    def residual(p: np.ndarray) -> np.ndarray:
        x, y, angle, u, change, v, turning = complete(p)
        heading, speed = angle + turning * t, u + change * t
        moved = np.stack([speed * np.cos(heading) - v * np.sin(heading), speed * np.sin(heading) + v * np.cos(heading)])
        path = np.pad(np.cumsum(0.5 * (moved[:, 1:] + moved[:, :-1]) * np.diff(t), axis=1), ((0, 0), (1, 0)))
        return (pose - np.column_stack([x + path[0], y + path[1], heading])) / noise

    turned = np.polyfit(t, pose[:, 2], 1)
    speed = np.hypot(*np.diff(pose[:, :2], axis=0).T).sum() / max(t[-1], 1e-9)
    start = np.array([*pose[0, :2], turned[1], speed, 0.0, 0.0, turned[0]])
    optimum = optimize.least_squares(lambda p: residual(p).ravel(), start if rate is None else start[:-1], method="lm")
    error = residual(optimum.x) * noise
    # Each of the three channels has a third of the numbers.
    samples = max(len(t) - len(optimum.x) / 3, 1)
    rms = np.sqrt((error[:, :2] ** 2).sum() / samples), np.sqrt((error[:, 2] ** 2).sum() / samples)
    return complete(optimum.x), (float(rms[0]), float(rms[1]))


def repeatability_floor(runs: Sequence[Run], noise: Float[np.ndarray, "3"]) -> PoseError | None:
    """The median error of steady windows about their mean motion; None where they are fewer than `FEWEST`."""
    groups = steady_windows(runs)
    if sum(len(group) for group in groups) < FEWEST:
        return None
    errors = np.concatenate([repeatability_errors([runs[k] for k in group], noise) for group in groups])
    middle = np.median(errors, axis=0)
    return PoseError(float(middle[0]), float(middle[1]), "vehicle and cameras under constant commands")
