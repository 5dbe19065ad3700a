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

from ..kept_program import KeptProgram
from .segment_dynamics import FORCE
from .segmented_runs import LENGTH, SegmentedRuns
from .segments import LinearisedSegments

CORRELATED = 1e-13
"""Added to the diagonal of correlation matrices, which may be singular to rounding."""
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


class _Information(NamedTuple):
    """What the samples of a segment say of its start state x = (z, o), o the wandering noise before the first of them.

    With h = H x + e and e ~ N(0, R), `matrix` H^T R^-1 H (d, d), `right` H^T R^-1 Y (d, P + 1), `square` Y^T R^-1 Y and
    `logs` ln |R|. The noise at the end is o_end = `end_state` x + `end_columns` + zeta with the variance `end_variance`
    (3,) of zeta.
    """

    matrix: jax.Array
    right: jax.Array
    square: jax.Array
    logs: jax.Array
    end_state: jax.Array
    end_columns: jax.Array
    end_variance: jax.Array


class Filtered(NamedTuple):
    """Mean (R, K, d, P + 1) and covariance (R, K, d, d) of the start state x of a segment.

    `before`: without its own samples, `after`: with them. The matrices (R, K, d, d) `to_end` lead from x to the end of
    the segment, `into` from the end of the segment before to x.
    """

    before: np.ndarray
    before_covariance: np.ndarray
    after: np.ndarray
    after_covariance: np.ndarray
    into: np.ndarray
    to_end: np.ndarray


def _noise(discrepancy: Discrepancy):
    return tuple(jnp.asarray(part, jnp.float64) for part in discrepancy)


def _information(noise, columns, state, present, gap) -> _Information:
    """The information of one segment: `columns` (n, 3, P + 1), `state` (n, 3, nz), `present` (n, 3), `gap` (n,).

    Given o, the wandering noise of sample j is A_j o + eta_j with A_j = exp(-T_j / tau), T_j the time since o. A scalar
    Kalman filter of eta for each channel, which begins at zero, turns the rows of [H | Y] into innovations.
    """
    white, wander, wander_time, _, _ = noise
    nz = state.shape[-1]
    decay = jnp.exp(-gap / wander_time)
    of_wander = jnp.exp(-jnp.cumsum(gap) / wander_time)[:, None, None] * jnp.eye(3)[None]
    rows = jnp.concatenate([state, of_wander, columns], axis=-1)

    def sample(carry, one):
        mean, variance = carry
        row, measured, a = one
        mean, variance = a * mean, a**2 * variance + (1 - a**2) * wander**2
        total = variance + white**2
        error = row - mean
        gain = measured * variance / total
        innovation = (measured / jnp.sqrt(total))[:, None] * error
        return (mean + gain[:, None] * error, variance - gain * variance), (innovation, measured * jnp.log(total))

    start = (jnp.zeros(rows.shape[1:]), jnp.zeros(3))
    (mean, variance), (innovations, logs) = jax.lax.scan(jax.checkpoint(sample), start, (rows, present, decay))
    H, Y = innovations[..., : nz + 3], innovations[..., nz + 3 :]
    return _Information(
        jnp.einsum("nci,ncj->ij", H, H),
        jnp.einsum("nci,ncj->ij", H, Y),
        jnp.einsum("nci,ncj->ij", Y, Y),
        jnp.sum(logs),
        of_wander[-1] @ jnp.eye(nz + 3)[nz:] - mean[:, : nz + 3],
        mean[:, nz + 3 :],
        variance,
    )


def _filter_run(data: SegmentData, noise, restart):
    """Gram matrices (K, P + 1, P + 1) and log determinants (K,) of one run, and what smoothing needs.

    `restart` (K,): 1 where the state is free again.
    """
    _, wander, _, force, force_time = noise
    nz, count = data.state.shape[-1], data.columns.shape[-1]
    size = nz + 3
    is_force = jnp.arange(nz) >= nz - FORCE
    decay = jnp.exp(-LENGTH / force_time)
    force_variance = jnp.concatenate([jnp.zeros(nz - FORCE), force**2])
    free = jnp.where(is_force, 0.0, FREE**2)
    resting = jnp.where(is_force, 0.0, jnp.where(jnp.arange(nz) < 3, FREE**2, HELD**2))
    innovation = jnp.diag(jnp.concatenate([(1 - decay**2) * force_variance, jnp.zeros(3)]))
    of_segments = jax.vmap(partial(_information, noise))(data.columns, data.state, data.present, data.gap)

    def segment(carry, part):
        mean, variance, force_before = carry
        information, transition, shift, force_at, starts, is_first = part
        force_only = decay * jnp.diag(is_force.astype(jnp.float64))
        F = jnp.eye(size).at[:nz, :nz].set(jnp.where(is_force[:, None], force_only, transition))
        # The force is a deviation from that of the linearisation, while the process of the force itself has mean zero.
        shift = shift.at[nz - FORCE :, 0].set(decay * force_before - force_at)
        carried = (F @ mean).at[:nz].add(shift)
        fresh = jnp.zeros((size, count)).at[nz - FORCE : nz, 0].set(-force_at)
        prior = jnp.where(is_first * data.rest > 0, resting, free) + force_variance
        mean = jnp.where(starts > 0, fresh, carried)
        variance = jnp.where(starts > 0, jnp.diag(jnp.concatenate([prior, wander**2])), F @ variance @ F.T + innovation)
        # With the root U of the variance, all that the samples change is the matrix 1 + U^T (H^T R^-1 H) U >= 1.
        scale = jax.lax.stop_gradient(jnp.diag(variance))
        scale = jnp.sqrt(jnp.where(scale > 0, scale, 1.0))
        correlation = variance / jnp.outer(scale, scale)
        U = scale[:, None] * jnp.linalg.cholesky(correlation + CORRELATED * jnp.eye(size))
        root = jnp.linalg.cholesky(jnp.eye(size) + U.T @ information.matrix @ U)
        V = jax.scipy.linalg.solve_triangular(root, U.T, lower=True)
        right = information.right - information.matrix @ mean
        reduced = V @ right
        crossed = mean.T @ (information.right + right)
        gram = information.square - 0.5 * (crossed + crossed.T) - reduced.T @ reduced
        logs = information.logs + 2.0 * jnp.sum(jnp.log(jnp.diag(root)))
        after, variance_after = mean + V.T @ reduced, V.T @ V
        to_end = jnp.concatenate([jnp.eye(size)[:nz], information.end_state])
        end = (to_end @ after).at[nz:].add(information.end_columns)
        end_variance = to_end @ variance_after @ to_end.T
        end_variance = end_variance + jnp.diag(jnp.concatenate([jnp.zeros(nz), information.end_variance]))
        filtered = Filtered(mean, variance, after, variance_after, F, to_end)
        return (end, end_variance, force_at), (gram, logs, filtered)

    is_first = (jnp.arange(data.columns.shape[0]) == 0).astype(jnp.float64)
    parts = (of_segments, data.transition, data.shift, data.force, jnp.maximum(restart, is_first), is_first)
    start = (jnp.zeros((size, count)), jnp.eye(size), jnp.zeros(FORCE))
    return jax.lax.scan(jax.checkpoint(segment), start, parts)[1]


@jax.jit
def filter_runs(data: SegmentData, noise, restart):
    """`_filter_run` of all runs side by side."""
    return jax.vmap(lambda run: _filter_run(run, noise, restart))(data)


@KeptProgram
def _gram_and_logs(data: SegmentData, noise, restart):
    gram, logs, _ = filter_runs(data, noise, restart)
    return gram, logs


def gram_matrices(
    data: SegmentData, discrepancy: Discrepancy, restart_every: int = 0
) -> tuple[Float[np.ndarray, "R P1 P1"], Float[np.ndarray, " R"]]:
    """The Gram matrix and the log determinant of each run.

    Every `restart_every` segments the state is free again, which without a force makes windows of free start states; 0:
    never.
    """
    K = data.columns.shape[1]
    restart = np.zeros(K) if not restart_every else (np.arange(K) % restart_every == 0) * 1.0
    gram, logs = _gram_and_logs(_on_device(data), _noise(discrepancy), jnp.asarray(restart))
    return np.asarray(gram.sum(axis=1)), np.asarray(logs.sum(axis=1))


def deviance(data: SegmentData, discrepancy: Discrepancy) -> float:
    """-2 log likelihood of all runs without a step of the parameters, but for a constant: sum of r^T r + ln |V|."""
    gram, logs = gram_matrices(data, discrepancy)
    return float(gram[:, 0, 0].sum() + logs.sum())


def block_gram_matrices(
    data: SegmentData, discrepancy: Discrepancy, length: int
) -> tuple[Float[np.ndarray, "R B P1 P1"], Float[np.ndarray, "R B"]]:
    """The Gram matrix and the log determinant of each block of `length` segments of a run, given the blocks before it.

    By the chain rule their sums are those of the run. Blocks without samples are zero.
    """
    R, K, count = data.columns.shape[0], data.columns.shape[1], data.columns.shape[-1]
    gram, logs = _gram_and_logs(_on_device(data), _noise(discrepancy), jnp.zeros(K))
    missing = (0, -K % length)
    gram = np.pad(np.asarray(gram), [(0, 0), missing, (0, 0), (0, 0)])
    logs = np.pad(np.asarray(logs), [(0, 0), missing])
    blocks = (R, -1, length)
    return gram.reshape(*blocks, count, count).sum(axis=2), logs.reshape(blocks).sum(axis=2)


def smooth(data: SegmentData, discrepancy: Discrepancy, step: Float[np.ndarray, " P"]) -> np.ndarray:
    """Deviations dz (R, K, nz) of the start states given all samples, after a `step` of the parameters."""
    return smoothed(data, discrepancy, step)[0]


def smoothed(
    data: SegmentData, discrepancy: Discrepancy, step: Float[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, "R K nz"], Float[np.ndarray, "R K nz"]]:
    """Deviations of the start states given all samples, after a `step` of the parameters, and their standard
    deviations with the parameters known."""
    data = data.at_step(step)
    R, K, nz = len(data.rest), data.columns.shape[1], data.state.shape[-1]
    history = filter_runs(_on_device(data), _noise(discrepancy), jnp.zeros(K))[2]
    of = Filtered(*(np.asarray(part) for part in history))
    deviations, variances = np.zeros((R, K, nz)), np.zeros((R, K, nz))
    mean, covariance = of.after[:, -1, :, 0], of.after_covariance[:, -1]
    for k in reversed(range(K)):
        if k + 1 < K:
            cross = of.into[:, k + 1] @ of.to_end[:, k] @ of.after_covariance[:, k]
            gain = _gain(of.before_covariance[:, k + 1], cross)
            off, more = mean - of.before[:, k + 1, :, 0], covariance - of.before_covariance[:, k + 1]
            mean = of.after[:, k, :, 0] + np.einsum("rji,rj->ri", gain, off)
            covariance = of.after_covariance[:, k] + np.swapaxes(gain, 1, 2) @ more @ gain
        deviations[:, k] = mean[:, :nz]
        variances[:, k] = np.einsum("rii->ri", covariance)[:, :nz]
    return deviations, np.sqrt(np.maximum(variances, 0.0))


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
