"""Recorded runs cut into segments of a quarter of a second."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from snakejax.recording.run import Run

LENGTH = 0.25
"""Length of a segment [s]: the force may change from one to the next. Tyres let a sideways velocity decay within a
fifth of that, and the forces that a model lacks change with the gait, over seconds."""
FEWEST = 3
"""Least number of samples of a segment."""


class SegmentedRuns(NamedTuple):
    """The S segments of R runs, n samples each.

    `run` (S,): number of the run; `times` (S, n + 1) [s], the last is the first of the next segment; `pose` (S, n, 3),
    zero where lost; `present` (S, n, 3); `first` (S,): whether it is the first of its run; `rest` (S,): whether it
    begins at rest; `begins` (S,) [s]: time at which a start at rest is; `payload` (S, 2);
    `codes` (S, 4): the labels of its run.
    """

    run: Int[np.ndarray, " S"]
    times: Float[np.ndarray, "S n1"]
    pose: Float[np.ndarray, "S n 3"]
    present: Float[np.ndarray, "S n 3"]
    first: np.ndarray
    rest: np.ndarray
    begins: Float[np.ndarray, " S"]
    payload: Float[np.ndarray, "S 2"]
    codes: Float[np.ndarray, "S 4"]

    @property
    def runs(self) -> int:
        """The number of runs."""
        return int(self.run[-1]) + 1


def cut_segments(runs: Sequence[Run], length: float = LENGTH) -> SegmentedRuns:
    """`runs` in segments of `length` [s], of as many samples each; the last of a run is filled with lost samples."""
    frame = min(float(np.median(np.diff(np.asarray(run.times)))) for run in runs)
    n = max(FEWEST, round(length / frame))
    columns: list[tuple] = []
    for k, run in enumerate(runs):
        t, recorded = np.asarray(run.times), np.asarray(run.pose)
        begins = float(run.gait.begins())
        at_rest = not run.moving and begins >= t[0] - 1e-9
        missing = -len(t) % n
        t = np.concatenate([t, t[-1] + frame * np.arange(1, missing + 2)])
        recorded = np.concatenate([recorded, np.full((missing, 3), np.nan)])
        for s in range(len(recorded) // n):
            part = recorded[s * n : (s + 1) * n]
            present = np.isfinite(part)
            times = t[s * n : (s + 1) * n + 1]
            rest = at_rest and s == 0
            payload, codes = np.asarray(run.payload), np.asarray(run.codes)
            columns.append(
                (k, times, np.where(present, part, 0.0), present * 1.0, s == 0, rest, begins, payload, codes)
            )
    return SegmentedRuns(*(np.array(column) for column in zip(*columns, strict=True)))
