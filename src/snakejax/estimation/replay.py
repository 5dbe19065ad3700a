"""Replay of recorded runs: poses that a model predicts at every frame, also at lost frames."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from snakejax.core.errors import FitError, InputError
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import Accuracy, simulate

from .batch import Batch, batch
from .fit_record import Fit

ACCURACY = Accuracy(derivative="forward")
UNIT_NOISE = Noise(np.asarray(1.0), np.asarray(1.0), source="none")


def replay(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> list[Float[np.ndarray, "n 3"]]:
    """Simulated poses (n, 3), x, y [m] and unwrapped heading [rad], at the frames of each of `runs`.

    **Arguments:** `starts`: start states as in `simulate`, (R, 3) poses at rest or (R, 6) with velocities.
    **Raises:** `FitError` if the simulation of a run fails.
    """
    complete = replayed(model, runs, starts)
    for run, pose in zip(runs, complete, strict=True):
        if not np.isfinite(pose).all():
            raise FitError(
                f"The simulation of run `{run.name}` does not reach its end in {ACCURACY.max_steps} steps: check its"
                " parameters, above all for a tyre too stiff (its limit is the ideal board) and steering by 90 degrees."
            )
    return complete


def replayed(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> list[Float[np.ndarray, "n 3"]]:
    """`replay`, with infinite poses where the simulation of a run fails."""
    poses, finished = _replay(model, batch_of_runs(runs, starts), np.asarray(starts, float))
    poses = np.where(np.asarray(finished)[:, None, None], np.asarray(poses), np.inf)
    return [pose[: run.times.shape[0]] for run, pose in zip(runs, poses, strict=True)]


def batch_of_runs(runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> Batch:
    """`runs` as one batch with their start as recorded pose: a replay uses no recorded pose, and a preset has none."""
    poses = (np.broadcast_to(start[:3], (run.times.shape[0], 3)) for run, start in zip(runs, starts, strict=True))
    placed = [eqx.tree_at(lambda r: r.pose, run, pose) for run, pose in zip(runs, poses, strict=True)]
    return batch(placed, UNIT_NOISE)


@eqx.filter_jit
def _replay(model: Model, runs: Batch, starts: Float[np.ndarray, "R S"]):
    def replay_run(times, gait, payload, codes, start, resting):
        in_run = model.in_run(payload, codes)
        done = simulate(in_run, gait, times, start, accuracy=ACCURACY, throw=False, resting=resting)
        return done.pose, done.finished

    each = (runs.times, runs.gait, runs.payload, runs.codes, starts, runs.resting)
    return jax.lax.map(lambda run: replay_run(*run), each)


def fitted_starts(fit: Fit) -> Float[np.ndarray, "R S"]:
    """Fitted start states of all runs, train and held-out: (R, 3), or (R, 6) if a run starts in motion."""
    return np.array(fit.fitted.starts)


def starts_of(runs: Sequence[Run], pose: Sequence[float]) -> Float[np.ndarray, "R 3"]:
    """Start (R, 3) of every run at rest at one `pose` [m, m, rad].

    **Raises:** `InputError` if a run was in motion at its first sample.
    """
    for run in runs:
        if run.moving:
            what = f"Run `{run.name}` already moves at its first sample, so its start needs velocities, not only a pose"
            raise InputError(what, "option --start", "leave the start out; it is then estimated from the recording")
    return np.tile(np.asarray(pose, float), (len(runs), 1))
