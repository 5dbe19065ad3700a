"""What noise in the joint logs does to residuals: a board that is driven by a noisy log goes another way.

A smoothing spline takes most of the noise of a log away, and leaves a part that moves the simulated board slowly: an
error of a fit that no number of camera frames averages out. Here that part is drawn anew, and played.
"""

from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ._batch import stacked_gaits
from ._gait import Gait, Logged, with_logs
from ._study import Optimum, Study
from .quality import splined

DRAWS = 40


def is_noisy(gait: Gait) -> bool:
    """Whether a log of `gait` had noise."""
    parts = jax.tree.leaves(gait, is_leaf=lambda part: isinstance(part, Logged))
    return any(isinstance(part, Logged) and float(part.noise) > 0 for part in parts)


def redrawn(gait: Gait, rng: np.random.Generator) -> Gait:
    """`gait` as another draw of the logs' noise would leave it behind the same smoothing, which takes some of a kink in
    the motion away too.
    """

    def again(log: Logged) -> Logged:
        if not float(log.noise) > 0:
            return log
        times, c = np.asarray(log.knots), np.asarray(log.coefficients)
        angles = np.append(c[3], np.polyval(c[:, -1], times[-1] - times[-2]))
        seen = angles + float(log.noise) * rng.normal(size=times.size)
        return Logged.of(times, splined(times, seen, float(log.strength)), float(log.noise), float(log.strength))

    return with_logs(gait, again)


def replayed(study: Study, optimum: Optimum, numbers: list[int], seed: int = 0) -> Iterator[Float[np.ndarray, "R n 3"]]:
    """How the whitened residuals of the runs `numbers` change where their logs had other noise, `DRAWS` times."""
    rng = np.random.default_rng(seed)
    at = study.at(optimum.values, (), optimum.start)
    until = float(np.asarray(study.batch.times).max())
    before = study.evaluate(at, numbers).residual
    for _ in range(DRAWS):
        gaits = [redrawn(run.gait, rng) if k in numbers else run.gait for k, run in enumerate(study.runs)]
        there = eqx.tree_at(lambda s: s.batch.gait, study, stacked_gaits(gaits, until))
        yield there.evaluate(at, numbers).residual - before
