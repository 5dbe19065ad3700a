"""Batch of recorded runs: runs of different length and gait as one set of arrays with a leading axis over runs."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from snakejax.dynamics.inputs import AbstractInputs, Gait, with_signals
from snakejax.dynamics.sampled_signals import Held, LaggedHold, LaggedSines, Shaped, lagged
from snakejax.dynamics.signals import AbstractSignal, Logged, Scaled, Sines, Tracked, angles_at
from snakejax.recording.run import Noise, Run

from .whitening import whitening


class Batch(eqx.Module):
    """`R` runs of `n` samples each; shorter runs are padded with samples of weight zero.

    `times` (R, n) [s]; `pose` (R, n, 3): x, y [m] and unwrapped heading [rad], zero where a sample is missing;
    `weight` (R, n, 3): 1 / standard deviation of the noise, zero where a sample is missing; `payload` (R, 2); `codes`
    (R, 4): the labels of the runs; `start` (R, S): first guess of the start state; `free_start` (R, S): 1 where a
    component is estimated, else 0. S is 3 (pose) where all runs start at rest, else 6 (pose and velocities).
    `whitening` (R, n, 3, q): the matrix K of `whitened`, None where no run has a `wander`.
    """

    times: Float[Array, "R n"]
    pose: Float[Array, "R n 3"]
    weight: Float[Array, "R n 3"]
    gait: AbstractInputs
    payload: Float[Array, "R 2"]
    codes: Float[Array, "R 4"]
    start: Float[Array, "R S"]
    free_start: Float[Array, "R S"]
    whitening: Float[Array, "R n 3 q"] | None = None

    @property
    def resting(self) -> Bool[Array, " R"]:
        """True where a run starts at rest: its start velocities are zero and are not estimated."""
        return jnp.all(self.free_start[..., 3:6] == 0, axis=-1)


def batch(runs: Sequence[Run], noise: Noise) -> Batch:
    """Stack `runs` into one `Batch`; each sample is weighted by 1 / standard deviation of `noise`.

    **Raises:** `ValueError` if there are no runs or if a run has fewer than two complete samples.
    """
    if not runs:
        raise ValueError("There are no runs to fit.")
    for run in runs:
        if np.isfinite(np.asarray(run.pose)).all(axis=1).sum() < 2:
            raise ValueError(f"Run `{run.name}` has fewer than two samples.")
    length = padded_length(runs)
    sd = np.asarray(noise.channels)
    times, pose, weight = [], [], []
    for run in runs:
        t, recorded = np.asarray(run.times), np.asarray(run.pose)
        padding = length - t.shape[0]
        times.append(np.concatenate([t, t[-1] + 1e-6 * np.arange(1, padding + 1)]))
        present = np.isfinite(recorded)
        pose.append(np.pad(np.where(present, recorded, 0.0), ((0, padding), (0, 0))))
        weight.append(np.pad(present / sd, ((0, padding), (0, 0))))
    moving = np.array([run.moving for run in runs])
    poses = np.array([first_pose(run) for run in runs])
    if moving.any():
        velocities = np.array([_first_velocity(run) if run.moving else np.zeros(3) for run in runs])
        start = np.concatenate([poses, velocities], axis=1)
        free = np.concatenate([np.ones_like(poses), np.repeat(moving[:, None], 3, axis=1)], axis=1)
    else:
        start, free = poses, np.ones_like(poses)
    return Batch(
        jnp.asarray(np.array(times)),
        jnp.asarray(np.array(pose)),
        jnp.asarray(np.array(weight)),
        stacked_gaits([run.gait for run in runs], float(max(t[-1] for t in times))),
        jnp.stack([jnp.asarray(run.payload) for run in runs]),
        jnp.asarray(np.array([run.codes for run in runs])),
        jnp.asarray(start),
        jnp.asarray(free, jnp.float64),
        whitening([run.wander for run in runs], np.array(weight)),
    )


def padded_length(runs: Sequence[Run]) -> int:
    """Samples of a run in the batch of `runs`: their most, rounded up to 50 so that few programs are compiled."""
    return -(-max(run.times.shape[0] for run in runs) // 50) * 50


def lengthened(values: np.ndarray, extra: int) -> np.ndarray:
    """`values` (n, ...) and so many more like the last."""
    return np.concatenate([values, np.repeat(values[-1:], extra, axis=0)])


def first_pose(run: Run) -> np.ndarray:
    """Median pose (3,) of the first five complete samples: x, y [m], heading [rad]."""
    recorded = np.asarray(run.pose)
    recorded = recorded[np.isfinite(recorded).all(axis=1)]
    return np.median(recorded[:5], axis=0)


def _first_velocity(run: Run) -> np.ndarray:
    """Forward speed [m/s], zero and yaw rate [rad/s] (3,), from straight lines fitted to the first 0.2 s."""
    t, recorded = np.asarray(run.times), np.asarray(run.pose)
    early = np.isfinite(recorded).all(axis=1) & (t <= t[0] + 0.2)
    if early.sum() < 3:
        return np.zeros(3)
    slope = np.polyfit(t[early] - t[0], recorded[early], 1)[0]
    heading = recorded[early][0, 2]
    return np.array([slope[0] * np.cos(heading) + slope[1] * np.sin(heading), 0.0, slope[2]])


def stacked_gaits(gaits: Sequence[AbstractInputs], until: float) -> AbstractInputs:
    """Stack `gaits` into one gait with a leading axis; gaits of different kinds become logs up to `until` [s]."""
    boards = [gait for gait in gaits if isinstance(gait, Gait)]
    if any(gait.phi_back is not None for gait in boards):
        gaits = [Gait(g.phi, g.psi, Scaled(g.phi, -1.0) if g.phi_back is None else g.phi_back) for g in boards]
    if len({_kinds(gait) for gait in gaits}) > 1:
        gaits = [with_signals(gait, lambda s: _sampled(s, until)) for gait in gaits]
    sizes = [leaf.shape[-1] for gait in gaits for leaf in jax.tree.leaves(gait) if leaf.ndim]
    gaits = [_padded(gait, max(sizes, default=0)) for gait in gaits]
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *gaits)


def _kinds(gait: AbstractInputs) -> str:
    return str(jax.tree.structure(gait))


def _sampled(signal: AbstractSignal, until: float) -> Logged:
    times = np.arange(0.0, until + 0.01, 0.005)
    return Logged.of(times, angles_at(signal, jnp.asarray(times)))


def _padded(gait: AbstractInputs, size: int) -> AbstractInputs:
    def pad(signal: AbstractSignal) -> AbstractSignal:
        if isinstance(signal, Sines):
            return signal.padded(size)
        if isinstance(signal, Logged | Held):
            return signal.padded(size)
        if isinstance(signal, LaggedHold):
            return lagged(pad(signal.command), signal.tau)
        if isinstance(signal, LaggedSines):
            return eqx.tree_at(lambda s: s.command, signal, pad(signal.command))
        if isinstance(signal, Tracked):
            return eqx.tree_at(lambda s: s.command, signal, pad(signal.command))
        if isinstance(signal, Scaled | Shaped):
            return eqx.tree_at(lambda s: s.signal, signal, pad(signal.signal))
        return signal

    return with_signals(gait, pad)
