"""Covariance of residuals due to noise in the joint logs, by Monte Carlo simulation.

A smoothing spline removes most of the noise of a log. The rest moves the simulated board slowly: an error that does not
average out over camera frames and looks like a missing effect. Here that rest is sampled and simulated; the root of the
covariance of the poses is the `wander` of the run, which whitens its residuals.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.dynamics.inputs import AbstractInputs, logs_of, with_logs
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Logged
from snakejax.recording.quality import Smoothed, smoothed_again
from snakejax.recording.run import Run

from ..replay import replay

DRAWS = 80
"""Samples of the log noise: a standard deviation from 80 samples has a relative error of 8 %."""


def is_noisy(gait: AbstractInputs) -> bool:
    """Whether a log of `gait` has noise."""
    return any(float(log.noise) > 0 for log in logs_of(gait))


def redrawn_log(gait: AbstractInputs, rng: np.random.Generator) -> AbstractInputs:
    """`gait` with another sample of the log noise behind the same smoothing.

    The smoothing acts on signal plus noise, so its bias at a kink of the motion is included.
    """

    def again(log: Logged) -> Logged:
        if not float(log.noise) > 0:
            return log
        times, c = np.asarray(log.knots), np.asarray(log.coefficients)
        angles = np.append(c[3], np.polyval(c[:, -1], times[-1] - times[-2]))
        began = float(log.onset) if log.onset < times[-1] else None
        sampled = times != began
        times, angles = times[sampled], angles[sampled]
        noisy = angles + float(log.noise) * rng.normal(size=times.size)
        smoothed = Smoothed(angles, float(log.noise), float(log.strength), began)
        return Logged.of(times, *smoothed_again(times, noisy, smoothed))

    return with_logs(gait, again)


def log_noise_root(
    model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"], draws: int = DRAWS, seed: int = 0
) -> tuple[Run, ...]:
    """`runs` with their `wander` (n, 3, draws), the root of the covariance of the poses due to noise in the joint logs.

    **Arguments:** `model`, `starts` (R, S): where the simulations start; `draws`: number of samples; `seed`.
    **Raises:** `FitError` if the simulation of a run fails.
    """
    rng = np.random.default_rng(seed)
    with_roots = list(runs)
    noisy = [k for k, run in enumerate(runs) if is_noisy(run.gait)]
    logged = [with_roots[k] for k in noisy]
    reference = replay(model, logged, starts[noisy])
    changes_by_draw = []
    for _ in range(draws):
        drawn = [dataclasses.replace(run, gait=redrawn_log(run.gait, rng)) for run in logged]
        poses = replay(model, drawn, starts[noisy])
        changes_by_draw.append([pose - before for pose, before in zip(poses, reference, strict=True)])
    for k, changes in zip(noisy, zip(*changes_by_draw, strict=True), strict=True):
        with_roots[k] = dataclasses.replace(
            with_roots[k], wander=jnp.asarray(np.stack(changes, axis=-1) / np.sqrt(draws))
        )
    return tuple(with_roots)
