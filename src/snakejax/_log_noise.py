"""What noise in the joint logs does to residuals: a board that is driven by a noisy log goes another way.

A smoothing spline takes most of the noise of a log away, and leaves a part that moves the simulated board slowly: an
error of a fit that no number of camera frames averages out. Here that part is drawn anew, and played.
"""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._batch import stacked_gaits
from ._gait import Gait, Logged
from ._study import Optimum, Study
from .quality import splined

DRAWS = 40


def is_noisy(gait: Gait) -> bool:
    """Whether a log of `gait` had noise."""
    return any(float(log.noise) > 0 for log in _logs(gait))


def redrawn(gait: Gait, rng: np.random.Generator) -> Gait:
    """`gait` as another draw of the logs' noise would leave it behind the same smoothing, which takes some of a kink in
    the motion away too.
    """

    def again(part):
        if not isinstance(part, Logged) or not float(part.noise) > 0:
            return part
        times = np.asarray(part.knots)
        c, last = np.asarray(part.coefficients), times[-1] - times[-2]
        angles = np.append(c[3], np.polyval(c[:, -1], last))
        seen = angles + float(part.noise) * rng.normal(size=times.size)
        return Logged.of(times, splined(times, seen, float(part.strength)), float(part.noise), float(part.strength))

    return jax.tree.map(again, gait, is_leaf=lambda part: isinstance(part, Logged))


def replayed(study: Study, optimum: Optimum, numbers: list[int], seed: int = 0) -> Iterator[Float[np.ndarray, "R n 3"]]:
    """How the whitened residuals of the runs `numbers` change where their logs had other noise, `DRAWS` times."""
    rng = np.random.default_rng(seed)
    at = study.at(optimum.values, (), optimum.start)
    until = float(np.asarray(study.batch.times).max())
    before = study.evaluate(at, numbers).residual
    for _ in range(DRAWS):
        gaits = stacked_gaits([redrawn(run.gait, rng) for run in study.runs], until)
        gaits = jax.tree.map(jnp.asarray, gaits)
        yield eqx.tree_at(lambda s: s.batch.gait, study, gaits).evaluate(at, numbers).residual - before


def _logs(gait: Gait) -> list[Logged]:
    parts = jax.tree.leaves(gait, is_leaf=lambda part: isinstance(part, Logged))
    return [part for part in parts if isinstance(part, Logged)]
