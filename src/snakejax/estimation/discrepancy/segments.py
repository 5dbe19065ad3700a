"""Recorded runs cut into short segments, each with its own start state and a constant force beside the model.

The state z of a segment is (body state, memories of the effects, force): with p the parameters in the coordinates that
a fit moves, sample j of segment k and the start of the next segment are

    y_j     = h_j(z_k, p)           j = 1..n
    z_(k+1) = F_k(z_k, p)           body and memories; the force (X, Y, N) is a random process, see `kalman`

The force of z is that of a vehicle with the stated mass and inertia; on one with others it is in proportion to them, so
that it gives the same acceleration. A random force of fixed strength would be less likely the heavier the vehicle: a
fit that minimises chi^2 would make it lighter, and its tyres and drags weaker with it.

Segments are short, so that h and F are nearly linear in z and p even where the model is far from the recording.
"""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.errors import FitError
from snakejax.core.parallel import in_threads
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect, TyreState
from snakejax.recording.run import Run

from ..batch import lengthened, stacked_gaits
from ..multiple_shooting import initial_states
from .segment_dynamics import (
    BODY,
    FORCE,
    ConstantForce,
    fastest_decay,
    in_parts,
    inertia,
    linearised_segments,
    segment_ends,
    steady_memories,
)
from .segmented_runs import cut_segments

CHUNK = 16
"""Segments that are integrated side by side; one compiled program serves every recording."""
LARGEST_STEP = 2.5e-3
"""Largest step [s] of the Runge-Kutta method of order 4: its error is then below 1e-7 m over a segment."""
STABLE = 1.0
"""Largest product of step and fastest rate of decay at the samples. The method is stable up to 2.78; the remainder is a
margin for slower wheels, whose slip decays faster, between two samples."""
GROWN, RESOLVED = 3.0, 0.1
"""Where a start velocity grows by more than the first factor over a segment, in standard deviations of the velocities,
its steps are halved until the factor changes by less than the second share: the method may have been unstable."""
HALVINGS = 5
"""So many times, at most."""
MOST_STEPS = 4096
"""Largest number of steps between two samples."""


class LinearisedSegments(NamedTuple):
    """`pose` (S, n, 3) and `end` (S, nz - 3) of all segments, with their derivatives by p (.., P) and z (.., nz)."""

    pose: np.ndarray
    end: np.ndarray
    pose_p: np.ndarray
    pose_z: np.ndarray
    end_p: np.ndarray
    end_z: np.ndarray


class Segments:
    """The segments of `runs` under `model`, with the movable parameters `names`; compiled once for all recordings."""

    def __init__(self, model: Model, runs: Sequence[Run], names: Sequence[str]):
        self.runs, self.names = tuple(runs), tuple(names)
        self.cut = cut_segments(runs)
        self.model = model.add(segment_force=ConstantForce())
        self.stated = tuple(jnp.asarray(part, jnp.float64) for part in inertia(model))
        domains = parameters(model)
        self.domains = [domains[name].domain for name in names]
        self.multiplicative = np.array([domain.multiplicative for domain in self.domains])
        gaits = stacked_gaits([run.gait for run in runs], float(max(np.asarray(run.times)[-1] for run in runs)) + 1.0)
        cut = self.cut
        each = jax.tree.map(lambda leaf: np.asarray(leaf)[cut.run], gaits)
        self.inputs: tuple = (each, cut.times, cut.rest, cut.begins, cut.payload, cut.codes)
        states = [initial_states(model, run) for run in runs]
        self.smoothed = self._by_segment(states)

    def beside(self, values: np.ndarray, **effect: Effect) -> "Segments":
        """The same segments at the parameters `values`, whose movable parameters are those of one more effect."""
        (name,) = effect
        other = copy.copy(self)
        other.model = with_parameters(self.model, dict(zip(self.names, map(jnp.asarray, values), strict=True))).add(
            **effect
        )
        known = parameters(other.model)
        other.names = tuple(part for part in known if part.startswith(f"effects.{name}."))
        other.domains = [known[part].domain for part in other.names]
        other.multiplicative = np.array([domain.multiplicative for domain in other.domains])
        return other

    def force_ratio(self, values: np.ndarray) -> Float[np.ndarray, " 3"]:
        """The force on the vehicle at the parameters `values` over the force in z, for X, Y and N."""
        model = with_parameters(self.model, dict(zip(self.names, map(jnp.asarray, values), strict=True)))
        return np.array([float(now / then) for now, then in zip(inertia(model), self.stated, strict=True)])

    def _by_segment(self, states: Sequence[np.ndarray]) -> np.ndarray:
        """The smoothed states (S, n, 6) at the samples of each segment; the last one stands for samples filled in."""
        n, parts = self.cut.pose.shape[1], []
        for state in states:
            parts.append(lengthened(state, -len(state) % n).reshape(-1, n, state.shape[1]))
        return np.concatenate(parts)

    def _substeps(self, values: np.ndarray) -> np.ndarray:
        """Steps between two samples (S,), so many that the integration is stable at the `values`, see `STABLE`."""
        segments, states = jax.tree.map(jnp.asarray, self.inputs), jnp.asarray(self.smoothed)
        rate = np.asarray(fastest_decay(self.model, self.names, jnp.asarray(values), segments, states))
        if not np.isfinite(rate).all():
            raise FitError("The motion of the recording gives a rate of change that is not finite; check its outliers.")
        frame = np.diff(self.cut.times, axis=1).max(axis=1)
        step = np.minimum(LARGEST_STEP, STABLE / np.maximum(rate, 1e-9))
        return np.ceil(np.clip(frame / step - 1e-9, 1, MOST_STEPS)).astype(np.int64)

    def guess(self) -> np.ndarray:
        """The smoothed states (S, nz) at the first sample of each segment; memories and forces are zero."""
        z = np.zeros((len(self.cut.run), BODY + self.model.memories + FORCE))
        z[:, :BODY] = self.smoothed[:, 0]
        z[self.cut.rest, 3:BODY] = 0.0
        return z

    def moved(self, values: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The `values` (P,) after a `step` (P,) in the coordinates of the fit, inside their domains."""
        new = np.where(self.multiplicative, values * np.exp(np.clip(step, -3, 3)), values + step)
        return np.clip(new, [d.low for d in self.domains], [d.high for d in self.domains])

    def step_between(self, old: np.ndarray, new: np.ndarray) -> np.ndarray:
        """The step (P,) that leads from the values `old` to `new`."""
        safe_old, safe_new = (np.where(self.multiplicative, np.maximum(v, 1e-300), 1.0) for v in (old, new))
        return np.where(self.multiplicative, np.log(safe_new / safe_old), new - old)

    def with_steady_memories(self, values: np.ndarray, z: np.ndarray, effect: str = "") -> np.ndarray:
        """`z` with the memories of all effects, or of `effect` alone, where a steady slip has them: at zero a tyre has
        no force."""
        owners = [not effect or one is self.model.effects[effect] for one in self.model.effects_of(TyreState)]
        if not any(owners):
            return z
        own = np.repeat(owners, self.model.memories // len(owners))
        z = z.copy()
        model = with_parameters(self.model, dict(zip(self.names, map(jnp.asarray, values), strict=True)))
        steady = steady_memories(model, jax.tree.map(jnp.asarray, self.inputs), jnp.asarray(z[:, :BODY]))
        z[:, BODY:-FORCE][:, own] = np.where(self.cut.rest[:, None], 0.0, np.asarray(steady))[:, own]
        return z

    def rolled_out(self, values: np.ndarray, z: np.ndarray) -> np.ndarray:
        """`z` where each segment but the first of a run begins where the one before it ends, without a force: the
        states of whole simulated runs."""
        z, sub, first = z.copy(), self._substeps(values), np.flatnonzero(self.cut.first)
        z[:, -FORCE:] = 0.0
        last = np.append(first[1:], len(z)) - 1
        values_, steps = jnp.asarray(values, jnp.float64), jnp.asarray(sub.max())
        for k in range((last - first).max()):
            at = np.minimum(first + k, last)
            segments, start = jax.tree.map(lambda leaf, at=at: jnp.asarray(leaf[at]), (self.inputs, z))
            end = np.asarray(segment_ends(self.model, self.stated, self.names, values_, steps, segments, start))
            goes_on = first + k < last
            z[at[goes_on] + 1, :-FORCE] = end[goes_on]
        return z

    def linearise(self, values: np.ndarray, z: np.ndarray) -> LinearisedSegments:
        """Poses and end states at the parameters `values` (P,) and start states `z` (S, nz), with derivatives.

        Steps are as short as `values` need; those of a segment whose velocities grow are halved, see `GROWN`.
        """
        every = np.arange(len(self.cut.run))
        sub = self._substeps(values)
        linearised = self._with_steps(values, z, every, sub)
        growth = self._growth(linearised)
        doubtful = every[~(growth < GROWN)]
        for _ in range(HALVINGS):
            if not doubtful.size:
                break
            sub[doubtful] *= 2
            finer = self._with_steps(values, z, doubtful, sub)
            before, growth[doubtful] = growth[doubtful], self._growth(finer)
            for whole, part in zip(linearised, finer, strict=True):
                whole[doubtful] = part
            with np.errstate(invalid="ignore"):
                same = np.abs(growth[doubtful] - before) < RESOLVED * growth[doubtful]
            doubtful = doubtful[~same]
        return linearised

    def _growth(self, linearised: LinearisedSegments) -> np.ndarray:
        """The largest derivative (S,) of a velocity at the end of a segment by one at its start, both in standard
        deviations of the recorded velocities; infinite where a number is not finite."""
        size = self.smoothed[..., 3:BODY].std(axis=(0, 1))
        size = np.where(size > 0, size, 1.0)
        largest = np.abs(linearised.end_z[:, 3:BODY, 3:BODY] * (size / size[:, None])).max(axis=(1, 2))
        finite = np.all([np.isfinite(part.reshape(len(part), -1)).all(axis=1) for part in linearised], axis=0)
        return np.where(finite, largest, np.inf)

    def _with_steps(
        self, values: np.ndarray, z: np.ndarray, numbers: np.ndarray, steps: np.ndarray
    ) -> LinearisedSegments:
        """`linearise` of the segments with these `numbers`, with `steps` (S,) between two samples."""
        (S, n), P, nz = (len(numbers), self.cut.pose.shape[1]), len(self.names), z.shape[1]
        pose, end = np.zeros((S, n, 3)), np.zeros((S, nz - FORCE))
        d_pose, d_end = np.zeros((S, n, 3, P + nz)), np.zeros((S, nz - FORCE, P + nz))
        model, point, steps = in_parts(self.model), jnp.asarray(values, jnp.float64), steps[numbers]

        def fill(part: np.ndarray) -> None:
            padded = numbers[lengthened(part, CHUNK - len(part))]
            segments, start = jax.tree.map(lambda leaf: jnp.asarray(leaf[padded]), (self.inputs, z))
            sub = jnp.asarray(steps[part].max())
            done = linearised_segments(model, self.stated, self.names, self.multiplicative, point, sub, segments, start)
            for target, results in zip(((pose, end), (d_pose, d_end)), done, strict=True):
                for whole, values_ in zip(target, results, strict=True):
                    whole[part] = np.asarray(values_)[: len(part)]

        # Segments with nearly equal steps stand in one chunk.
        order = np.argsort(steps, kind="stable")
        in_threads(fill, [order[k : k + CHUNK] for k in range(0, S, CHUNK)])
        return LinearisedSegments(pose, end, d_pose[..., :P], d_pose[..., P:], d_end[..., :P], d_end[..., P:])
