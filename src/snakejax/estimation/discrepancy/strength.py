"""How strong noise and random force are: the maximum of the restricted likelihood, R of `restricted_likelihood`.

Nine logarithms are moved: white and wandering noise of position and of heading, the time constant of the latter, three
strengths of the force and its time constant.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import optimize

from snakejax.dynamics.model import Model
from snakejax.recording.run import Run

from ..multiple_shooting import initial_states
from .kalman import Discrepancy, SegmentData
from .least_squares import Prior
from .restricted_likelihood import discrepancy_of, likelihood_of, logarithms_of
from .segmented_runs import LENGTH
from .segments import Segments

WANDER_TIME, FORCE_TIME = (0.03, 2.0), (0.15, 10.0)
"""Limits of the time constants [s]: noise that wanders faster is white and slower is a pose of the start; a force that
changes faster than a segment cannot be seen, and slower than a run it is constant."""
NOISE_RANGE = (1e-3, 30.0)
"""Limits of each noise as multiples of the noise estimated from the recording alone."""
FORCE_RANGE = (1e-4, 10.0)
"""Limits of the force as multiples of the root mean square force that moves the vehicle. The lower one is none for
every purpose, and below it covariances lose their digits."""
SLOWEST_GAIN = 1e-9
"""The search ends where an iteration lowers R by less than this share."""
NEAR_LIMIT = 1.5
"""Noise whose time constant is within this factor of the fastest one counts as white, of the slowest one as drift."""
NO_WHITE = 0.1
"""White noise below this share of the wandering one, 1% of its power, counts as none."""
RESTARTED = 25
"""Iterations of a second search, at least."""


class Scales(NamedTuple):
    """What is large for a recording: `noise` (3,) [m, m, rad], the estimate from the recording alone; `force` (3,)
    [N, N, N m], the root mean square force that moves the vehicle; `wander_time` [s]: that of wandering noise, where it
    is stated."""

    noise: np.ndarray
    force: np.ndarray
    wander_time: float | None = None

    @property
    def least_force(self) -> np.ndarray:
        """A force that is none for every purpose."""
        return FORCE_RANGE[0] * self.force

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of the nine logarithms."""
        ends = []
        for k in range(2):
            noise = NOISE_RANGE[k] * self.noise[[0, 2]]
            force = FORCE_RANGE[k] * self.force
            wander_time = WANDER_TIME[k] if self.wander_time is None else self.wander_time
            ends.append(np.log([*noise, *noise, wander_time, *force, FORCE_TIME[k]]))
        return ends[0], ends[1]

    def drifts(self, discrepancy: Discrepancy) -> bool:
        """Whether noise wanders as slowly as its estimate allows, where no time constant is stated."""
        return self.wander_time is None and discrepancy.wander_time * NEAR_LIMIT > WANDER_TIME[1]

    def first_guess(self) -> Discrepancy:
        """White and wandering noise as large as the estimate, and a tenth of the force that moves the vehicle."""
        return Discrepancy(self.noise, self.noise, self.wander_time or 0.2, 0.1 * self.force, 0.5)


def scales_of(segments: Segments, noise: Float[np.ndarray, "3"], wander_time: float | None = None) -> Scales:
    """`noise` and `wander_time` as they are, and the force that moves the vehicle, from the smoothed recording."""
    cut = segments.cut
    pairs = np.flatnonzero(~cut.first)  # a segment and the one before it
    velocity = segments.smoothed[:, :, 3:6].mean(axis=1)
    dt = cut.times[pairs, 0] - cut.times[pairs - 1, 0]
    force = inertial_force(segments.model, cut.payload[pairs], velocity[pairs - 1], velocity[pairs], dt)
    present = np.asarray(cut.present.all(axis=(1, 2)))
    complete = present[pairs] & present[pairs - 1]
    size = np.sqrt((force[complete if complete.any() else slice(None)] ** 2).mean(axis=0))
    return Scales(np.asarray(noise, float), np.maximum(size, 1e-9), wander_time)


def window_force(model: Model, runs: Sequence[Run]) -> Float[np.ndarray, "3"]:
    """The root mean square force that moves the vehicle in `runs` [N, N, N m], between states `LENGTH` apart."""
    parts = []
    for run in runs:
        times, velocity = np.asarray(run.times), initial_states(model, run)[:, 3:6]
        every = max(1, round(LENGTH / float(np.median(np.diff(times)))))
        times, velocity = times[::every], velocity[::every]
        payload = np.broadcast_to(np.asarray(run.payload), (len(times) - 1, 2))
        parts.append(inertial_force(model, payload, velocity[:-1], velocity[1:], np.diff(times)))
    return np.maximum(np.sqrt((np.concatenate(parts) ** 2).mean(axis=0)), 1e-9)


def inertial_force(
    model: Model,
    payload: Float[np.ndarray, "N 2"],
    before: Float[np.ndarray, "N 3"],
    after: Float[np.ndarray, "N 3"],
    dt: Float[np.ndarray, " N"],
) -> Float[np.ndarray, "N 3"]:
    """m (du/dt - r w), m (dw/dt + r u), I dr/dt [N, N, N m] between velocities (u, w, r) `before` and `after` the times
    `dt` [s]."""
    u, w, r = 0.5 * (after + before).T
    du, dw, dr = ((after - before) / dt[:, None]).T
    mass = float(model.board.mass) + payload[:, 0]
    inertia = float(model.board.total_inertia) + payload[:, 1]
    return np.stack([mass * (du - r * w), mass * (dw + r * u), inertia * dr], axis=1)


def estimate_discrepancy(
    data: SegmentData, start: Discrepancy, free: np.ndarray, prior: Prior, scales: Scales, most: int
) -> tuple[Discrepancy, float]:
    """The `Discrepancy` of least R, and R, from `start` in at most `most` iterations (L-BFGS-B).

    Far from the right model the wandering noise may become the white one, and the force what wanders: a minimum of its
    own. Where the noise wanders as fast as it may and none is white, another search begins with both.
    """
    least = _minimum(data, start, free, prior, scales, most)
    of = least[0]
    is_white = of.wander_time < NEAR_LIMIT * WANDER_TIME[0]
    if scales.wander_time is None and is_white and (of.white < NO_WHITE * of.wander).any():
        guess = scales.first_guess()
        both = guess._replace(white=of.wander, wander=of.wander, force=0.1 * of.force)
        least = min(least, _minimum(data, both, free, prior, scales, max(most, RESTARTED)), key=lambda pair: pair[1])
    return least


def _minimum(
    data: SegmentData, start: Discrepancy, free: np.ndarray, prior: Prior, scales: Scales, most: int
) -> tuple[Discrepancy, float]:
    unit = _typical_error(data)
    low, high = (end / unit for end in scales.bounds())
    with likelihood_of(data, free, prior) as likelihood:

        def value_and_slope(steps):
            value, slope = likelihood.value_and_slope(steps * unit)
            if not (np.isfinite(value) and np.isfinite(slope).all()):
                return 1e12, np.zeros_like(slope)
            return value, slope * unit

        result = optimize.minimize(
            value_and_slope,
            np.clip(logarithms_of(start) / unit, low, high),
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            options={"maxiter": most, "ftol": SLOWEST_GAIN},
        )
    return discrepancy_of(result.x * unit), float(result.fun)


def _typical_error(data: SegmentData) -> np.ndarray:
    """By how much each of the nine logarithms is known at best: 1 / sqrt(2 N), with the N samples, or segments, whose
    standard deviation it is. The search moves multiples of it: R is hundreds of times less curved in the logarithm of a
    force, which a few hundred segments determine, than in that of a noise, and in one unit it would hardly move.
    """
    x, y, heading = np.maximum(data.present.sum(axis=(0, 1, 2)), 1)
    segments = max(int((data.present.sum(axis=(2, 3)) > 0).sum()), 1)
    count = np.array([x + y, heading, x + y, heading, segments, segments, segments, segments, segments])
    return 1 / np.sqrt(2.0 * count)
