"""The segments of an inexact model as windows of a free force, on which the forms of a law are regressed.

A force that is constant over segment k acts on the poses of that segment and, through the state at its end, on all that
follow. The Kalman filter carries a column for each component of each segment, so that the Gram matrix of a window holds
what the recording says of every history of force and grip beside the random force.
"""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import Scalar, param, with_parameters
from snakejax.dynamics.contact import Motion, Wheel
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import LateralForce
from snakejax.estimation.discrepancy.kalman import SegmentData, gram_matrices
from snakejax.estimation.discrepancy.segment_dynamics import BODY, FORCE
from snakejax.estimation.discrepancy.segments import Segments

from ..latent_force.force_sensitivity import MotionSamples, motion_samples
from ..law.knots import KnotMeans
from ..law.windows import FINEST, ForceWindows, variables_of
from .search import Linear, Search

LONGEST = 64
"""Segments of a window, at most: each has five columns in the filter, whose work grows with the square of them."""
GRIP = 2
"""Factors on the grip of a segment: of the wheels before and behind the middle."""


class SegmentGrip(LateralForce):
    """Lateral force x (1 + g) of the wheels `ahead` of the middle and `behind` it."""

    ahead: Scalar = param("-", default=0.0)
    behind: Scalar = param("-", default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        """F (1 + g)."""
        return force * (1 + (self.ahead if wheel.wheelset.place > 0 else self.behind))


class _Grip(NamedTuple):
    """Derivatives by the grip in a segment: of its poses (S, n, 3, 2) and of the state at its end (S, nz - 3, 2)."""

    pose: np.ndarray
    end: np.ndarray


@eqx.filter_jit
def _motions(model: Model, segments, states):
    def one(segment, states):
        gait, times, _, _, payload, codes = segment
        loaded = model.in_run(payload, codes)
        gait = loaded.prepared(gait)

        def at(t, state):
            motion = loaded.motion(t, tuple(state[k] for k in range(BODY)), gait)
            return motion._replace(wheels=tuple(w._replace(wheelset=None) for w in motion.wheels), board=None)

        motion = jax.vmap(at)(times[:-1] - loaded.delay(), states)
        return motion_samples(model, motion)

    return jax.vmap(one)(segments, states)


def motions_of(segments: Segments, values: np.ndarray, z: np.ndarray) -> MotionSamples:
    """How the vehicle moves at each sample of each segment, (S, n): as smoothed, less how far that is from the start
    states `z` (S, nz), between which the difference is linear."""
    cut, n = segments.cut, segments.cut.pose.shape[1]
    off = z[:, :BODY] - segments.smoothed[:, 0]
    after = np.where(np.append(cut.first[1:], True)[:, None], off, np.append(off[1:], off[-1:], axis=0))
    part = (np.arange(n) / n)[:, None]
    states = segments.smoothed + (1 - part) * off[:, None] + part * after[:, None]
    model = with_parameters(segments.model, dict(zip(segments.names, map(jnp.asarray, values), strict=True)))
    inputs = jax.tree.map(jnp.asarray, segments.inputs)
    return jax.tree.map(np.asarray, _motions(model, inputs, jnp.asarray(states)))


def force_windows(search: Search, linear: Linear) -> ForceWindows:
    """The runs at `linear`, in windows of at most `LONGEST` segments, with all parameters; the state is free where a
    window begins, and the random force and the noise are those of `linear`."""
    segments, point = search.segments, linear.point
    grip_segments = segments.beside(point.values, segment_grip=SegmentGrip())
    at = grip_segments.linearise(np.zeros(GRIP), point.z)
    grip = _Grip(at.pose_p, at.end_p)
    track = motions_of(segments, point.values, point.z)
    counts = np.bincount(segments.cut.run)
    places = [
        (run, first, min(LONGEST, count - first))
        for run, count in enumerate(counts)
        for first in range(0, count, LONGEST)
    ]
    K, n = max(length for _, _, length in places), segments.cut.pose.shape[1]
    frame = float(np.median(np.diff(segments.cut.times[0])))
    pick = np.arange(0, n, max(1, int(FINEST / frame + 1e-6)))
    began = np.concatenate([[0], np.cumsum(counts)])
    rows = np.array([began[run] + first + np.minimum(np.arange(K), length - 1) for run, first, length in places])

    def arranged(values: np.ndarray) -> np.ndarray:
        return values[rows][:, :, pick].reshape(len(rows), -1)

    inside = np.array([np.arange(K) < length for _, _, length in places], float)
    ratio = segments.force_ratio(point.values)
    grams = np.array(list(_grams(linear, places, rows, grip, ratio, K)))
    owner = np.array([run for run, _, _ in places])
    prior = search.prior_at(point.values)
    return ForceWindows(
        *variables_of(track, arranged),
        KnotMeans(inside),
        grams[:, 1:, 1:],
        grams[:, 1:, 0],
        np.bincount(owner, grams[:, 0, 0]),
        owner,
        prior.mean,
        prior.precision,
        arranged(np.asarray(track.theta)),
        int(linear.data.present.sum()),
        beside=True,
    )


def _grams(linear: Linear, places, rows: np.ndarray, grip: _Grip, ratio: np.ndarray, K: int) -> Iterator[np.ndarray]:
    """The Gram matrix of each window: residual, parameters, force (X, Y, N) knot by knot, grip knot by knot. `ratio`
    (3,): of a force and that in the state of a segment."""
    data = linear.data
    P, nz = data.columns.shape[-1] - 1, data.state.shape[-1]
    for (run, first, length), of_window in zip(places, rows, strict=True):
        here, filled = slice(first, first + length), ((0, K - length),)
        own = [np.pad(part[run, here], [*filled, *[(0, 0)] * (part.ndim - 2)]) for part in data[:-1]]
        window = SegmentData._make([*own, data.rest[[run]] * (first == 0)])
        wider = [(0, 0)] * (window.columns.ndim - 1) + [(0, 5 * K)]
        columns, shift = np.pad(window.columns, wider), np.pad(window.shift, wider[1:])
        for k in range(length):
            force = slice(1 + P + FORCE * k, 1 + P + FORCE * (k + 1))
            grips = slice(1 + P + FORCE * K + GRIP * k, 1 + P + FORCE * K + GRIP * (k + 1))
            columns[k, ..., force] = data.state[run, first + k, ..., nz - FORCE :] / ratio
            columns[k, ..., grips] = grip.pose[of_window[k]]
            if k + 1 < length:
                by_force = data.transition[run, first + k + 1, : nz - FORCE, nz - FORCE :]
                # The deviation is that without a force less the sum of its columns times the force.
                shift[k + 1, : nz - FORCE, force] = -by_force / ratio
                shift[k + 1, : nz - FORCE, grips] = -grip.end[of_window[k]]
        whole = window._replace(columns=columns, shift=shift)
        one_run = SegmentData._make([*(part[None] for part in whole[:-1]), whole.rest])
        yield gram_matrices(one_run, linear.point.discrepancy)[0][0]
