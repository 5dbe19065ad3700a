"""A defect of a recording, as it was found: what, where, how large, and what is done about it."""

from collections.abc import Hashable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..run import Run

Severity = Literal["note", "doubtful", "refused"]
Action = Literal["mask", "turn", "omit", "none"]


class PoseSeries(NamedTuple):
    """What cameras saw of one run: `times` [s] (n,), `pose` (n, 3) of x [m], y [m] and unwrapped heading [rad], NaN
    where a frame was lost, and whether the run was already `moving` at its first frame.
    """

    times: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    moving: bool = False

    @staticmethod
    def of(run: Run) -> "PoseSeries":
        """The track of `run`, as NumPy arrays."""
        return PoseSeries(np.asarray(run.times), np.asarray(run.pose), run.moving)

    @property
    def present(self) -> Bool[np.ndarray, " n"]:
        """Which frames are present."""
        return np.asarray(np.isfinite(self.pose).all(axis=1))

    def complete(self) -> "PoseSeries":
        """The frames that are present alone."""
        return PoseSeries(self.times[self.present], self.pose[self.present], self.moving)

    def without(self, frames: Int[np.ndarray, " k"]) -> "PoseSeries":
        """This track with `frames` lost."""
        pose = self.pose.copy()
        pose[frames] = np.nan
        return self._replace(pose=pose)


class Finding(NamedTuple):
    """A defect of a recording; docs/quality.md lists the kinds.

    `kind`: its name there; `start`, `end` [s]: where it lies; `size` in `unit`, None if it has no size; `frames`:
    numbers of the frames concerned. `action`: the safe remedy: "mask" the frames as lost, "turn" their heading by a
    multiple of pi, "omit" the run, or "none". With "none", a `severity` "refused" means that no fit should be made
    before the user has followed the `remedy`. `applied`: whether the action was taken. `run`: None for all runs
    together.
    """

    kind: str
    what: str
    remedy: str
    start: float
    end: float
    size: float | None = None
    unit: str = ""
    frames: Int[np.ndarray, " k"] = np.zeros(0, int)
    action: Action = "none"
    severity: Severity = "doubtful"
    applied: bool = False
    run: str | None = None

    @property
    def done(self) -> str:
        """What was done about it, or is to be done."""
        done = {"mask": "masked", "turn": "turned back"}
        return done.get(self.action, self.remedy) if self.applied else self.remedy

    @property
    def alike(self) -> Hashable:
        """What findings that are shortened to one have in common, see `in_brief`."""
        return self.kind, self.action, self.severity, self.applied


def finding(kind: str, track: PoseSeries, frames: Int[np.ndarray, " k"], what: str, remedy: str, **more) -> Finding:
    """A finding on `frames` of `track`, which has at least one."""
    frames = np.asarray(frames, int)
    return Finding(
        kind, what, remedy, float(track.times[frames[0]]), float(track.times[frames[-1]]), frames=frames, **more
    )
