"""What noise in the joint logs does to residuals: a board that is driven by a noisy log goes another way.

A smoothing spline takes most of the noise of a log away, and leaves a part that moves the simulated board slowly: an
error of a fit that no number of camera frames averages out, and that looks like a missing effect. Here that part is
drawn anew, and played; what it does to a run is the run's `wander`, which whitens its residuals.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._gait import Gait, Logged, logs_of, with_logs
from ._model import Model
from ._recording import Run
from ._replay import replay
from .quality import Smoothed, smoothed_again

DRAWS = 80


def is_noisy(gait: Gait) -> bool:
    """Whether a log of `gait` had noise."""
    return any(float(log.noise) > 0 for log in logs_of(gait))


def redrawn(gait: Gait, rng: np.random.Generator) -> Gait:
    """`gait` as another draw of the logs' noise would leave it behind the same smoothing, which takes some of a kink in
    the motion away too.
    """

    def again(log: Logged) -> Logged:
        if not float(log.noise) > 0:
            return log
        times, c = np.asarray(log.knots), np.asarray(log.coefficients)
        angles = np.append(c[3], np.polyval(c[:, -1], times[-1] - times[-2]))
        began = float(log.onset) if log.onset < times[-1] else None
        sampled = times != began
        times, angles = times[sampled], angles[sampled]
        seen = angles + float(log.noise) * rng.normal(size=times.size)
        like = Smoothed(angles, float(log.noise), float(log.strength), began)
        return Logged.of(times, *smoothed_again(times, seen, like))

    return with_logs(gait, again)


def wandering(
    model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"], draws: int = DRAWS, seed: int = 0
) -> tuple[Run, ...]:
    """`runs`, each with the `wander` that noise in its log brings under `model` from its start.

    **Raises:** `FitError` where the simulation of a run fails.
    """
    rng = np.random.default_rng(seed)
    done = list(runs)
    noisy = [k for k, run in enumerate(runs) if is_noisy(run.gait)]
    mine = [done[k] for k in noisy]
    usual = replay(model, mine, starts[noisy])
    off = []
    for _ in range(draws):
        drawn = [dataclasses.replace(run, gait=redrawn(run.gait, rng)) for run in mine]
        poses = replay(model, drawn, starts[noisy])
        off.append([pose - before for pose, before in zip(poses, usual, strict=True)])
    for k, changes in zip(noisy, zip(*off, strict=True), strict=True):
        done[k] = dataclasses.replace(done[k], wander=jnp.asarray(np.stack(changes, axis=-1) / np.sqrt(draws)))
    return tuple(done)
