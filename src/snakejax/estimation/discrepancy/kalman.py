"""The statistics of segments: white and wandering noise, a random force, and what they say of the parameters.

With dz_k the deviation of the start state of segment k from where it was linearised and d the step of the parameters,

    y_j - h_j = S_j dz_k + D_j d + o_j + e_j         e: white noise; o: Ornstein-Uhlenbeck process, the wandering noise
    dz_(k+1)  = A_k dz_k + B_k d + F_k - z_(k+1)     body and memories are continuous
    f_(k+1)   = exp(-LENGTH / tau_f) f_k + ...       the force: a first-order autoregressive process of mean zero

A Kalman filter runs over the columns [y - h | D], all with the same gains. Its innovations over their standard
deviations are E (N, P + 1) with unit covariance, so that the *Gram matrix* G = E^T E and the sum L of the logarithms
of the variances hold all that the recording says of d: likelihood, estimates, tests, and what each subset of the
parameters would leave, run by run. The backward pass is that of Rauch, Tung and Striebel (1965).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .segments import FORCE, LENGTH, LinearisedSegments, SegmentedRuns

FREE, HELD = 1.0, 1e-6
"""Standard deviations [m, rad, m/s, rad/s] of a start state that is free, and of the velocities of a board at rest.
Start states are linearised at the smoothed recording, from which they differ by far less than the first."""

RUN = 8
"""The segments of the longest run are filled up to a multiple of this: few lengths, hence few programs."""


class Discrepancy(NamedTuple):
    """What recordings have beyond the model: noise of the cameras and a random force on the vehicle.

    `white`, `wander` (3,) [m, m, rad]: standard deviations of white and of wandering noise; `wander_time` [s]: time
    constant of the latter. `force` (3,) [N, N, N m]: standard deviation of the force; `force_time` [s]: its time
    constant.
    """

    white: np.ndarray
    wander: np.ndarray
    wander_time: float
    force: np.ndarray
    force_time: float

    def without_force(self, force: Float[np.ndarray, "3"]) -> "Discrepancy":
        """The same noise with a force that is negligible: the least `force` that the filter can carry."""
        return self._replace(force=np.asarray(force))

    def enlarged(self, force: Float[np.ndarray, "3"], shortest: float = 0.0, longest: float = np.inf) -> "Discrepancy":
        """With `force` [N, N, N m] added in squares, and the time constant of the force within two limits [s]."""
        return self._replace(
            force=np.hypot(self.force, force), force_time=float(np.clip(self.force_time, shortest, longest))
        )


class SegmentData(NamedTuple):
    """The arrays of a filter pass: R runs, padded to K segments of n samples each.

    `columns` (R, K, n, 3, P + 1): y - h, then D; `state` (R, K, n, 3, nz): S; `present` (R, K, n, 3); `transition`
    (R, K, nz, nz) and `shift` (R, K, nz, P + 1): from segment k - 1 into k; `gap` (R, K, n) [s] since the sample
    before; `force` (R, K, 3): the force at which the segment was linearised; `rest` (R,): 1 for a start at rest.
    """

    columns: np.ndarray
    state: np.ndarray
    present: np.ndarray
    transition: np.ndarray
    shift: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    rest: np.ndarray

    def keeping(self, columns: np.ndarray) -> "SegmentData":
        """With only the parameters numbered `columns`."""
        kept = np.concatenate([[0], np.asarray(columns, int) + 1])
        return self._replace(columns=self.columns[..., kept], shift=self.shift[..., kept])

    def at_step(self, step: Float[np.ndarray, " P"]) -> "SegmentData":
        """With one column: what is left after the parameters have moved by `step`."""
        weights = np.concatenate([[1.0], -step])
        return self._replace(columns=(self.columns @ weights)[..., None], shift=(self.shift @ weights)[..., None])


def segment_data(cut: SegmentedRuns, at: LinearisedSegments, z: Float[np.ndarray, "S nz"]) -> SegmentData:
    """The arrays of the filter for segments linearised `at` their start states `z`."""
    n, nz, P = cut.pose.shape[1], z.shape[1], at.pose_p.shape[-1]
    counts = np.bincount(cut.run)
    R, K = len(counts), -(-int(counts.max()) // RUN) * RUN
    data = SegmentData(
        np.zeros((R, K, n, 3, P + 1)),
        np.zeros((R, K, n, 3, nz)),
        np.zeros((R, K, n, 3)),
        np.zeros((R, K, nz, nz)),
        np.zeros((R, K, nz, P + 1)),
        np.zeros((R, K, n)),
        np.zeros((R, K, FORCE)),
        np.zeros(R),
    )
    for k, count in enumerate(counts):
        of_run = np.flatnonzero(cut.run == k)
        data.columns[k, :count, ..., 0] = cut.pose[of_run] - at.pose[of_run]
        data.columns[k, :count, ..., 1:] = at.pose_p[of_run]
        data.state[k, :count], data.present[k, :count] = at.pose_z[of_run], cut.present[of_run]
        before, after = of_run[:-1], of_run[1:]
        data.transition[k, 1:count, :-FORCE] = at.end_z[before]
        data.shift[k, 1:count, :-FORCE, 0] = at.end[before] - z[after, :-FORCE]
        # The deviation is that at d = 0 less the sum of its columns times d, as the residual is.
        data.shift[k, 1:count, :-FORCE, 1:] = -at.end_p[before]
        times = cut.times[of_run][:, :-1].reshape(-1)
        data.gap[k, :count] = np.diff(times, prepend=times[0]).reshape(count, n)
        data.force[k, :count] = z[of_run, -FORCE:]
        data.rest[k] = cut.rest[of_run[0]]
    return data


def _noise(discrepancy: Discrepancy):
    return tuple(jnp.asarray(part, jnp.float64) for part in discrepancy)


def _filter_run(data: SegmentData, noise, restart, keep: bool):
    """Gram matrices (K, P + 1, P + 1) and log determinants (K,) of one run, and, with `keep`, what smoothing needs.

    `restart` (K,): 1 where the state is free again.
    """
    white, wander, wander_time, force, force_time = noise
    nz, count = data.state.shape[-1], data.columns.shape[-1]
    size = nz + 3
    is_force = jnp.arange(nz) >= nz - FORCE
    decay = jnp.exp(-LENGTH / force_time)
    force_variance = jnp.concatenate([jnp.zeros(nz - FORCE), force**2])
    free = jnp.where(is_force, 0.0, FREE**2)
    resting = jnp.where(is_force, 0.0, jnp.where(jnp.arange(nz) < 3, FREE**2, HELD**2))
    innovation = jnp.diag(jnp.concatenate([(1 - decay**2) * force_variance, jnp.zeros(3)]))

    def sample(carry, one):
        mean, variance, gram, logs = carry
        columns, state, present, gap = one
        a = jnp.exp(-gap / wander_time)
        scale = jnp.concatenate([jnp.ones(nz), jnp.full(3, 1.0) * a])
        mean = mean * scale[:, None]
        variance = variance * jnp.outer(scale, scale) + jnp.diag(
            jnp.concatenate([jnp.zeros(nz), (1 - a**2) * wander**2])
        )
        before = (mean, variance)
        for c in range(3):
            h = jnp.concatenate([state[c], jnp.zeros(3).at[c].set(1.0)])
            gain = variance @ h
            s = h @ gain + white[c] ** 2
            error = columns[c] - h @ mean
            weight = present[c]
            mean = mean + (weight / s) * jnp.outer(gain, error)
            variance = variance - (weight / s) * jnp.outer(gain, gain)
            variance = 0.5 * (variance + variance.T)
            error = error * weight / jnp.sqrt(s)
            gram = gram + jnp.outer(error, error)
            logs = logs + weight * jnp.log(s)
        return (mean, variance, gram, logs), (before, (mean, variance)) if keep else None

    def segment(carry, part):
        mean, variance, force_before = carry
        columns, state, present, transition, shift, gap, force_at, starts, is_first = part
        force_only = decay * jnp.diag(is_force.astype(jnp.float64))
        F = jnp.eye(size).at[:nz, :nz].set(jnp.where(is_force[:, None], force_only, transition))
        # The force is a deviation from that of the linearisation, while the process of the force itself has mean zero.
        shift = shift.at[nz - FORCE :, 0].set(decay * force_before - force_at)
        carried = (F @ mean).at[:nz].add(shift)
        fresh = jnp.zeros((size, count)).at[nz - FORCE : nz, 0].set(-force_at)
        prior = jnp.where(is_first * data.rest > 0, resting, free) + force_variance
        mean = jnp.where(starts > 0, fresh, carried)
        variance = jnp.where(starts > 0, jnp.diag(jnp.concatenate([prior, wander**2])), F @ variance @ F.T + innovation)
        start = (mean, variance, jnp.zeros((count, count)), 0.0)
        (mean, variance, gram, logs), history = jax.lax.scan(sample, start, (columns, state, present, gap))
        return (mean, variance, force_at), (gram, logs, history, F if keep else None)

    is_first = (jnp.arange(data.columns.shape[0]) == 0).astype(jnp.float64)
    parts = (*data[:-1], jnp.maximum(restart, is_first), is_first)
    start = (jnp.zeros((size, count)), jnp.eye(size), jnp.zeros(FORCE))
    return jax.lax.scan(segment, start, parts)[1]


@partial(jax.jit, static_argnames=("keep",))
def filter_runs(data: SegmentData, noise, restart, keep: bool = False):
    """`_filter_run` of all runs side by side."""
    return jax.vmap(lambda run: _filter_run(run, noise, restart, keep))(data)


def gram_matrices(
    data: SegmentData, discrepancy: Discrepancy, restart_every: int = 0
) -> tuple[Float[np.ndarray, "R P1 P1"], Float[np.ndarray, " R"]]:
    """The Gram matrix and the log determinant of each run.

    Every `restart_every` segments the state is free again, which without a force makes windows of free start states; 0:
    never.
    """
    K = data.columns.shape[1]
    restart = np.zeros(K) if not restart_every else (np.arange(K) % restart_every == 0) * 1.0
    gram, logs, _, _ = filter_runs(_on_device(data), _noise(discrepancy), jnp.asarray(restart))
    return np.asarray(gram.sum(axis=1)), np.asarray(logs.sum(axis=1))


def block_gram_matrices(
    data: SegmentData, discrepancy: Discrepancy, length: int
) -> tuple[Float[np.ndarray, "R B P1 P1"], Float[np.ndarray, "R B"]]:
    """The Gram matrix and the log determinant of each block of `length` segments of a run, given the blocks before it.

    By the chain rule their sums are those of the run. Blocks without samples are zero.
    """
    R, K, count = data.columns.shape[0], data.columns.shape[1], data.columns.shape[-1]
    gram, logs, _, _ = filter_runs(_on_device(data), _noise(discrepancy), jnp.zeros(K))
    missing = (0, -K % length)
    gram = np.pad(np.asarray(gram), [(0, 0), missing, (0, 0), (0, 0)])
    logs = np.pad(np.asarray(logs), [(0, 0), missing])
    blocks = (R, -1, length)
    return gram.reshape(*blocks, count, count).sum(axis=2), logs.reshape(blocks).sum(axis=2)


def smooth(data: SegmentData, discrepancy: Discrepancy, step: Float[np.ndarray, " P"]) -> np.ndarray:
    """Deviations dz (R, K, nz) of the start states given all samples, after a `step` of the parameters."""
    data = data.at_step(step)
    K, n = data.columns.shape[1:3]
    _, _, history, transitions = filter_runs(_on_device(data), _noise(discrepancy), jnp.zeros(K), keep=True)
    (mean_before, variance_before), (mean_after, variance_after) = jax.tree.map(np.asarray, history)
    transitions = np.asarray(transitions)
    R, size = mean_after.shape[0], mean_after.shape[3]
    nz = size - 3
    smoothed = np.zeros((R, K, nz))
    mean = mean_after[:, -1, -1, :, 0]
    for k in reversed(range(K)):
        for j in reversed(range(n)):
            if (k, j) != (K - 1, n - 1):
                next_ = (k, j + 1) if j + 1 < n else (k + 1, 0)
                scale = np.ones((R, size))
                scale[:, nz:] = np.exp(-data.gap[:, *next_] / discrepancy.wander_time)[:, None]
                F = scale[:, :, None] * (np.eye(size) if next_[1] else transitions[:, next_[0]])
                gain = _gain(variance_before[:, *next_], F @ variance_after[:, k, j])
                off = mean - mean_before[:, *next_, :, 0]
                mean = mean_after[:, k, j, :, 0] + np.einsum("rji,rj->ri", gain, off)
            if j == 0:
                smoothed[:, k] = mean[:, :nz]
    return smoothed


def _gain(predicted: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """predicted^-1 cross, each (R, d, d), with `predicted` scaled to a unit diagonal."""
    size = np.sqrt(np.maximum(np.einsum("rii->ri", predicted), 1e-30))
    scaled = predicted / size[:, :, None] / size[:, None, :] + 1e-12 * np.eye(predicted.shape[-1])
    return np.linalg.solve(scaled, cross / size[:, :, None]) / size[:, :, None]


def _on_device(data: SegmentData) -> SegmentData:
    return SegmentData(*(jnp.asarray(part) for part in data))


def moved_states(cut: SegmentedRuns, z: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """The start states (S, nz) after the `deviation` (R, K, nz) that smoothing gives."""
    new = z.copy()
    for k in range(cut.runs):
        of_run = np.flatnonzero(cut.run == k)
        new[of_run] += deviation[k, : len(of_run)]
    return new
