"""Goodness of fit: misfit and error of each run, and the range of the misfit under noise alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.dynamics.observation import CHANNELS

from .problem import Problem, Solution
from .whitening import coloured

NOISE_SIGMAS = 4.0
"""The misfit is consistent with noise within this many standard deviations of its distribution under noise alone."""
BAND = 1.96
"""Half the width of a band that holds 95% of normal errors, in standard deviations."""


class RunScore(NamedTuple):
    """Score of one run: `misfit` is the mean squared normalised residual, also by channel; `position_m` and
    `heading_rad` are root mean square errors; `worst_time_s` is the time of the largest residual."""

    run: str
    role: str
    misfit: float
    channels: dict[str, float]
    position_m: float
    heading_rad: float
    samples: int
    worst_time_s: float


class Score(NamedTuple):
    """Score of several runs together; fields as in `RunScore`."""

    misfit: float
    position_m: float
    heading_rad: float
    samples: int

    @property
    def times_noise(self) -> float:
        """The root mean square error in multiples of the noise."""
        return float(np.sqrt(self.misfit))


def score_columns(train: Sequence[Score], heldout: Sequence[Score | None]) -> dict[str, list[float | None]]:
    """Scores as the columns of a table."""
    names = ("times_noise", "position_m", "heading_rad")
    sides = (("train", train), ("heldout", heldout))
    return {
        f"{name}_{role}": [None if score is None else getattr(score, name) for score in scores]
        for role, scores in sides
        for name in names
    }


def run_misfits(problem: Problem, solution: Solution, runs: Sequence[int]) -> np.ndarray:
    """The misfit of each of `runs` at `solution`."""
    runs = list(runs)
    present = np.asarray(problem.batch.weight)[runs] > 0
    square = np.where(present, np.asarray(solution.linearised.residual)[runs] ** 2, 0.0)
    return square.sum(axis=(1, 2)) / np.maximum(present.sum(axis=(1, 2)), 1)


def run_scores(problem: Problem, solution: Solution, runs: Sequence[int]) -> tuple[RunScore, ...]:
    """The score of each of `runs` at `solution`."""
    weight = np.asarray(problem.batch.weight)
    scores = []
    for k in runs:
        r, w = np.asarray(solution.linearised.residual[k]), weight[k]
        present = w > 0
        K = None if problem.batch.whitening is None else problem.batch.whitening[k]
        error = np.where(present, coloured(r, K) / np.where(present, w, 1.0), 0.0)
        frames = max(int(present[:, 0].sum()), 1)
        channels = {name: float((r[:, c] ** 2).sum() / max(present[:, c].sum(), 1)) for c, name in enumerate(CHANNELS)}
        scores.append(
            RunScore(
                problem.runs[k].name,
                problem.runs[k].role,
                float((r**2).sum() / max(present.sum(), 1)),
                channels,
                float(np.sqrt((error[:, :2] ** 2).sum() / frames)),
                float(np.sqrt((error[:, 2] ** 2).sum() / max(present[:, 2].sum(), 1))),
                int(present.sum()),
                float(np.asarray(problem.batch.times)[k][int(np.argmax((r**2).sum(axis=1)))]),
            )
        )
    return tuple(scores)


def pooled_score(scores: Sequence[RunScore]) -> Score:
    """The score of several runs together, each sample with the same weight."""
    samples = np.array([score.samples for score in scores], float)
    share = samples / samples.sum()
    return Score(
        float(share @ [score.misfit for score in scores]),
        float(np.sqrt(share @ [score.position_m**2 for score in scores])),
        float(np.sqrt(share @ [score.heading_rad**2 for score in scores])),
        int(samples.sum()),
    )


def largest_noise_misfit(samples: int, estimated_parameters: float = 0, sigmas: float = NOISE_SIGMAS) -> float:
    """The largest misfit under noise alone: (d + `sigmas` sqrt(2 d)) / N with d = N - `estimated_parameters`.

    N is the number of `samples`; N times the misfit follows chi^2 with d degrees of freedom.
    """
    dof = max(samples - estimated_parameters, 1.0)
    return float((dof + sigmas * np.sqrt(2 * dof)) / samples)


def consistent_with_noise(solution: Solution, sigmas: float = NOISE_SIGMAS) -> bool:
    """Whether the misfit is at most the largest that noise alone leaves."""
    return bool(solution.misfit <= largest_noise_misfit(solution.samples, len(solution.loose), sigmas))
