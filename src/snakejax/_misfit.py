"""How far the runs lie from a model, and whether that is noise alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ._recording import CHANNELS
from ._study import Optimum, Study
from ._whitening import coloured

NOISE_SIGMAS = 4.0
"""Only noise is left where the misfit lies within this many standard deviations of that of noise alone."""


class RunScore(NamedTuple):
    """How far one run lies from the model: misfits are mean squares in units of the noise variance."""

    run: str
    role: str
    misfit: float
    channels: dict[str, float]
    position_m: float
    heading_rad: float
    samples: int
    worst_time_s: float


class Score(NamedTuple):
    """How far several runs lie from the model."""

    misfit: float
    position_m: float
    heading_rad: float
    samples: int


def run_scores(study: Study, optimum: Optimum, runs: Sequence[int]) -> tuple[RunScore, ...]:
    """The score of each of `runs` at `optimum`."""
    weight = np.asarray(study.batch.weight)
    scores = []
    for k in runs:
        r, w = np.asarray(optimum.linearised.residual[k]), weight[k]
        seen = w > 0
        K = None if study.batch.whitening is None else study.batch.whitening[k]
        error = np.where(seen, coloured(r, K) / np.where(seen, w, 1.0), 0.0)
        frames = max(int(seen[:, 0].sum()), 1)
        channels = {name: float((r[:, c] ** 2).sum() / max(seen[:, c].sum(), 1)) for c, name in enumerate(CHANNELS)}
        scores.append(
            RunScore(
                study.runs[k].name,
                study.runs[k].role,
                float((r**2).sum() / max(seen.sum(), 1)),
                channels,
                float(np.sqrt((error[:, :2] ** 2).sum() / frames)),
                float(np.sqrt((error[:, 2] ** 2).sum() / max(seen[:, 2].sum(), 1))),
                int(seen.sum()),
                float(np.asarray(study.batch.times)[k][int(np.argmax((r**2).sum(axis=1)))]),
            )
        )
    return tuple(scores)


def pooled(scores: Sequence[RunScore]) -> Score:
    """Several runs as one, each sample with the same weight."""
    samples = np.array([score.samples for score in scores], float)
    share = samples / samples.sum()
    return Score(
        float(share @ [score.misfit for score in scores]),
        float(np.sqrt(share @ [score.position_m**2 for score in scores])),
        float(np.sqrt(share @ [score.heading_rad**2 for score in scores])),
        int(samples.sum()),
    )


def noise_band(samples: int, estimated_parameters: float) -> tuple[float, float]:
    """The misfits between which a model of `estimated_parameters` leaves only noise, for `samples` numbers."""
    dof = max(samples - estimated_parameters, 1.0)
    centre, width = dof / samples, NOISE_SIGMAS * np.sqrt(2 * dof) / samples
    return centre - width, centre + width


def only_noise(optimum: Optimum) -> bool:
    """Whether the misfit is that of noise alone."""
    return bool(optimum.misfit <= noise_band(optimum.samples, len(optimum.loose))[1])
