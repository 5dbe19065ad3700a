"""Replays: what a model says of recorded runs, at every frame of theirs, lost ones too."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ._batch import Batch, batch
from ._errors import FitError, InputError
from ._fit import Fit
from ._model import Model
from ._recording import Noise, Run
from ._simulate import Accuracy, simulate

ACCURACY = Accuracy(derivative="forward")
UNIT_NOISE = Noise(np.asarray(1.0), np.asarray(1.0), source="none")


def replay(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> list[Float[np.ndarray, "n 3"]]:
    """The pose (n, 3), x, y [m] and unwrapped heading [rad], at the frames of each of `runs` from its start.

    **Arguments:** `starts` (R, 3), poses at rest, or (R, 6) where a run is under way, as `simulate` takes them.
    **Raises:** `FitError` where the simulation of a run fails.
    """
    poses, finished = _replay(model, side_by_side(runs, starts), np.asarray(starts, float))
    found = []
    for run, pose, done in zip(runs, np.asarray(poses), np.asarray(finished), strict=True):
        pose = pose[: run.times.shape[0]]
        if not (done and np.isfinite(pose).all()):
            raise FitError(
                f"The simulation of run `{run.name}` does not get to its end in {ACCURACY.max_steps} steps: check its"
                " parameters, above all for a tyre too stiff (its limit is the ideal board) and steering by 90 degrees."
            )
        found.append(pose)
    return found


def side_by_side(runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> Batch:
    """`runs` as one block, their start for a pose: nothing of what was seen matters, and a preset has seen nothing."""
    poses = (np.broadcast_to(start[:3], (run.times.shape[0], 3)) for run, start in zip(runs, starts, strict=True))
    placed = [eqx.tree_at(lambda r: r.pose, run, pose) for run, pose in zip(runs, poses, strict=True)]
    return batch(placed, UNIT_NOISE)


@eqx.filter_jit
def _replay(model: Model, runs: Batch, starts: Float[np.ndarray, "R S"]):
    def one(times, gait, payload, start, resting):
        loaded = eqx.tree_at(lambda m: m.board, model, replace_fn=lambda b: b.loaded(*payload))
        done = simulate(loaded, gait, times, start, accuracy=ACCURACY, throw=False, resting=resting)
        return done.pose, done.finished

    return jax.lax.map(lambda mine: one(*mine), (runs.times, runs.gait, runs.payload, starts, runs.resting))


def fitted_starts(found: Fit) -> Float[np.ndarray, "R S"]:
    """Where each run of the study starts: (R, 3), or (R, 6) where one is under way."""
    starts = np.array(found.optimum.start)
    if found.heldout_optimum is not None:
        rows = found.study.numbered("heldout")
        starts[rows] = found.heldout_optimum.start[rows]
    return starts


def starts_of(runs: Sequence[Run], pose: Sequence[float]) -> Float[np.ndarray, "R 3"]:
    """Every run at rest at one `pose`. **Raises:** `InputError` where a run was under way at its first sample."""
    for run in runs:
        if run.moving:
            what = f"Run `{run.name}` was under way at its first sample, so that a pose alone is no start of it"
            raise InputError(what, "option --start", "leave it out, and the start is estimated from the recording")
    return np.tile(np.asarray(pose, float), (len(runs), 1))
