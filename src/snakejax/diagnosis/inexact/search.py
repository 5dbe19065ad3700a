"""The search for the effects of an inexact model: linearise, estimate the discrepancy, choose effects, step, repeat.

Each round costs one linearisation of all segments by all parameters; everything that is chosen is linear algebra on
the Gram matrices of that round, and only the step that follows is nonlinear.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.estimation.discrepancy.kalman import (
    Discrepancy,
    SegmentData,
    deviance,
    gram_matrices,
    moved_states,
    segment_data,
    smooth,
)
from snakejax.estimation.discrepancy.least_squares import Optimum, Prior, quadratic
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.discrepancy.strength import Scales, estimate_discrepancy
from snakejax.estimation.fit_journal import kept
from snakejax.estimation.multiple_shooting import GROWTH, damping_factor

from ..selection.criteria import CRITERIA, SelectionCriteria
from .candidate_model import CandidateModel
from .subsets import Subsets, best_subset

TYRE_ROUNDS = 2
"""Rounds in which only the tyre and the constants move, beside a free force."""
SEARCH_ROUNDS = 5
"""Rounds in which effects are chosen anew."""
REFIT_ROUNDS = 15
"""Steps of a fit of one set of effects that are tried, at most."""
ROUGH, FINE = 8, 40
"""Iterations of the discrepancy while effects are chosen, and where a set of them is fitted, at most."""
LEAST_FALL = 1 / 3
"""The damping falls to this share after a step that did what the linear problem promised: in a valley that bends the
next step would be too long without any."""
ARRIVED = 0.3
"""A fit has converged where its step is shorter than this many standard deviations."""
TYRE_STEP = 0.5
"""Longest step of a tyre parameter in one round, in standard deviations of its prior; of others 1."""
FURTHEST_CONSTANT = 5.0
"""A constant of the vehicle is at most this many standard deviations of its prior from its stated value. Without a
limit the linear problem removes an effect by a vehicle without mass, grip and inertia, which needs no force at all."""
FURTHEST_FACTOR = 2.0
"""A linear problem holds for parameters within this factor of where it was linearised."""
NEAREST = 0.25
"""A parameter without a derivative at zero stays at least this share of its probe away from it."""


class Point(NamedTuple):
    """Where a fit stands: parameter `values` (P,), start states `z` (S, nz), `discrepancy`, and `effects` in it."""

    values: np.ndarray
    z: np.ndarray
    discrepancy: Discrepancy
    effects: tuple[str, ...]


class Linear(NamedTuple):
    """The problem linearised at `point`: `data` of the filter, `gram` (R, P + 1, P + 1) of each run under the
    discrepancy of `point`, and `subsets` for choosing."""

    point: Point
    data: SegmentData
    gram: np.ndarray
    subsets: Subsets

    @property
    def optimum(self) -> Optimum:
        """The optimum with the effects of the point."""
        return self.subsets.with_effects(self.point.effects)

    @property
    def has_converged(self) -> bool:
        """Whether the step to the optimum is short."""
        return self.optimum.distance < ARRIVED

    def damped_step(self, damping: float) -> np.ndarray:
        """The step (P,) to the optimum with `damping` (Levenberg and Marquardt): each parameter is pulled to where it
        is by that share of what the recordings say of it alone."""
        pull = np.diag(np.concatenate([[0.0], np.diag(self.subsets.gram)[1:]]))
        return self.subsets.with_effects(self.point.effects, self.subsets.gram + damping * pull).step

    def increased(self, damping: float) -> float:
        """The damping after a step in vain: at first that which halves the step along the combination of parameters of
        which the recordings say least."""
        return GROWTH * damping or self._least_damping

    def adapted(self, damping: float, ratio: float) -> float:
        """The damping after a step that did the share `ratio` of what the linear problem promised: by a factor of
        `LEAST_FALL` to 2 (Nielsen 1999), and none where it is negligible."""
        least = self._least_damping
        new = max(damping, 0.0 if ratio > 0.5 else least) * max(LEAST_FALL, float(damping_factor(ratio)))
        return new if new > least / GROWTH else 0.0

    @property
    def _least_damping(self) -> float:
        """The least eigenvalue of the normal equations, scaled to a unit diagonal. **Raises:** `FitError` where they
        are not finite."""
        columns = np.array(self.optimum.free, int) + 1
        alone = 1.0 / np.sqrt(np.maximum(np.diag(self.subsets.gram)[columns], 1e-300))
        scaled = self.optimum.covariance / np.outer(alone, alone)
        if not np.isfinite(scaled).all():
            raise FitError("The fit beside a random force left the range of numbers that the simulation can follow.")
        return float(1.0 / np.linalg.eigvalsh(scaled)[-1])

    def under(self, discrepancy: Discrepancy) -> Subsets:
        """The problem under another discrepancy."""
        gram, _ = gram_matrices(self.data, discrepancy)
        return self.subsets._replace(gram=gram.sum(axis=0))


class Search(NamedTuple):
    """What a search has at hand: the segments, the model of all candidates, the scales of the recording; `trials`, see
    `Subsets`."""

    segments: Segments
    model: CandidateModel
    scales: Scales
    criteria: SelectionCriteria = CRITERIA
    progress: Progress = no_progress
    trials: Mapping[str, int] = {}

    def prior_at(self, values: np.ndarray) -> Prior:
        """The prior of a step from `values`."""
        return Prior(self.segments.step_between(values, self.model.neutral), 1.0 / self.model.sd**2)

    def subsets(self, values: np.ndarray, gram: np.ndarray) -> Subsets:
        """The linear problem at `values` with the sum `gram` of the Gram matrices."""
        model, segments, prior = self.model, self.segments, self.prior_at(values)
        low, high = (
            segments.step_between(values, np.array([getattr(d, end) for d in segments.domains]))
            for end in ("low", "high")
        )
        furthest = np.where(segments.multiplicative, np.log(FURTHEST_FACTOR), np.inf)
        low, high = np.maximum(low, -furthest), np.minimum(high, furthest)
        # What is further off already may stay where it is.
        constants = list(model.constants)
        away = FURTHEST_CONSTANT * model.sd[constants]
        low[constants] = np.maximum(low[constants], np.minimum(prior.mean[constants] - away, 0.0))
        high[constants] = np.minimum(high[constants], np.maximum(prior.mean[constants] + away, 0.0))
        return Subsets(gram, model.always, model.candidates, prior, low, high, self.criteria, self.trials)

    def linearise(
        self, point: Point, free: np.ndarray | None = None, most: int = ROUGH, data: SegmentData | None = None
    ) -> Linear:
        """The problem linearised at `point`; its discrepancy is estimated in `most` iterations (0: kept) with the
        parameters `free` (default: those of its effects). `data`: the arrays at `point`, if they are known."""
        data = self.data(point) if data is None else data
        free = self.model.free(point.effects) if free is None else free
        if most:
            discrepancy, _ = estimate_discrepancy(
                data, point.discrepancy, free, self.prior_at(point.values), self.scales, most
            )
            point = point._replace(discrepancy=discrepancy)
        gram, _ = gram_matrices(data, point.discrepancy)
        return Linear(point, data, gram, self.subsets(point.values, gram.sum(axis=0)))

    def data(self, point: Point) -> SegmentData:
        """The arrays of the filter at `point`. **Raises:** `FitError` where the simulation is not finite."""
        at = self.segments.linearise(point.values, point.z)
        if not all(np.isfinite(part).all() for part in at):
            raise FitError("A simulation of a short segment is not finite; the parameters have left their range.")
        return segment_data(self.segments.cut, at, point.z)

    def stepped(self, linear: Linear, step: np.ndarray, effects: Sequence[str]) -> Point:
        """The point after `step`, limited where it is long, with the start states that belong to it."""
        model, values = self.model, linear.point.values
        limit = model.sd.copy()
        limit[list(model.tyre)] *= TYRE_STEP
        new = self.segments.moved(values, np.clip(step, -limit, limit))
        for effect, columns in model.candidates.items():
            for k in columns:
                if effect not in effects:
                    new[k] = model.neutral[k]
                elif k in model.probes:
                    new[k] = max(new[k], NEAREST * model.probes[k])
        taken = self.segments.step_between(values, new)
        deviation = smooth(linear.data, linear.point.discrepancy, taken)
        z = moved_states(self.segments.cut, linear.point.z, deviation)
        return Point(new, z, linear.point.discrepancy, tuple(effects))

    def values(self, linear: Linear) -> np.ndarray:
        """The values (P,) of all parameters with all effects of `linear`."""
        return self.segments.moved(linear.point.values, linear.optimum.step)

    @property
    def parts(self) -> tuple:
        """All on which the result of a fit depends beside its start."""
        own = self.segments
        segments = (own.model, own.names, own.domains, own.multiplicative, own.cut, own.inputs, own.smoothed)
        return segments, self.model, self.scales, self.criteria, dict(self.trials)

    def begin(self) -> Point:
        """The tyre and the constants fitted beside a free force; no effects."""
        return kept(("begin", self.parts), self._begun)

    def _begun(self) -> Point:
        point = Point(self.model.neutral.copy(), self.segments.guess(), self.scales.first_guess(), ())
        for _ in range(TYRE_ROUNDS):
            linear = self.linearise(point)
            point = self.stepped(linear, linear.optimum.step, ())
        return point

    def refit(self, point: Point, effects: Sequence[str]) -> Linear:
        """`effects` alone fitted to the end from `point`, and the problem linearised there."""
        fitted: list[Linear] = []

        def fit() -> Point:
            fitted.append(self._refitted(point, effects))
            return fitted[0].point

        # Of a fit that is kept only the point is: the arrays of its linearisation are large, and computed at once.
        end = kept(("refit", self.parts, point, tuple(effects)), fit)
        return fitted[0] if fitted else self.linearise(end, most=0)

    def _refitted(self, point: Point, effects: Sequence[str]) -> Linear:
        values = point.values.copy()
        for effect, columns in self.model.candidates.items():
            for k in columns:
                if effect not in effects:
                    values[k] = self.model.neutral[k]
                elif k in self.model.probes and values[k] == self.model.neutral[k]:
                    values[k] = self.model.probes[k]
        point = point._replace(values=values, effects=tuple(effects))
        linear = self.linearise(point, most=FINE)
        damping, simulated, is_new = 0.0, False, True
        for _ in range(REFIT_ROUNDS):
            if linear.has_converged:
                break
            trial = self.stepped(linear, linear.damped_step(damping), effects)
            if simulated:
                trial = self.along_simulation(trial)
            likelier = self._likelier(trial, linear)
            if likelier is not None:
                data, ratio = likelier
                damping, is_new = linear.adapted(damping, ratio), True
                linear = self.linearise(trial, most=FINE, data=data)
                continue
            # The step leads astray: because of states that no simulation has, or because it is too long.
            along = self.along_simulation(linear.point) if is_new and not simulated else None
            likelier = None if along is None else self._likelier(along, linear)
            if along is not None and likelier is not None:
                linear, damping, simulated = self.linearise(along, most=FINE, data=likelier[0]), 0.0, True
            else:
                damping, is_new = linear.increased(damping), False
        return linear

    def _likelier(self, trial: Point, linear: Linear) -> tuple[SegmentData, float] | None:
        """The arrays at `trial`, and by how much -2 log likelihood fell, as a share of what the linear problem
        promised; None unless it fell, under the discrepancy of `linear`, with the priors counted."""
        try:
            data = self.data(trial)
        except FitError:
            return None
        before, point = self.prior_at(linear.point.values), linear.point
        taken, free = self.segments.step_between(point.values, trial.values), self.model.free(point.effects)
        prior = before.chi2(taken, free) - before.chi2(np.zeros_like(taken), free)
        fall = deviance(linear.data, point.discrepancy) - deviance(data, point.discrepancy) - prior
        if not fall > 0.0:
            return None
        gram = linear.subsets.gram
        promise = quadratic(gram, np.zeros_like(taken)) - quadratic(gram, taken) - prior
        return data, fall / max(promise, fall)

    def along_simulation(self, point: Point) -> Point:
        """`point` with the states of whole simulated runs.

        Where hardly any force acts beside the model, the states of all segments are known by their run's start. Where
        moreover a segment depends strongly on its start, as one in which a vehicle sets off does, a linear step leaves
        gaps between segments that no force explains, and the next is worse.
        """
        return point._replace(z=self.segments.rolled_out(point.values, point.z))


def rounds(search: Search, first: Linear) -> Point:
    """The rounds in which effects are chosen anew, from the problem `first` on."""
    return kept(("rounds", search.parts, first.point), lambda: _chosen(search, first))


def _chosen(search: Search, first: Linear) -> Point:
    model, point = search.model, first.point
    for k in range(SEARCH_ROUNDS):
        search.progress(ProgressEvent(Phase.CHOOSING_EFFECTS, done=k + 1, total=SEARCH_ROUNDS))
        every = np.arange(len(model.names)) if k == 1 else None
        unfit = slopeless(search, point)
        linear = search.linearise(point, every) if k else first
        effects = best_subset(linear.subsets.without(unfit), point.effects, all_at_once=k > 0)
        best = linear.subsets.with_effects(effects)
        arrived = set(effects) == set(point.effects) and linear.has_converged
        step, chosen = best.step, list(effects)
        for effect in unfit if 1 <= k < SEARCH_ROUNDS - 1 else ():
            value = _tested_beside(search, linear, chosen, effect)
            if value is not None:
                effects = [*effects, effect]
                step[model.candidates[effect][0]] = value
        point = search.stepped(linear, step, effects)
        for effect in set(effects).intersection(unfit):
            point = point._replace(z=search.segments.with_steady_memories(point.values, point.z, effect))
        if arrived and k >= 2:
            break
    return point


def slopeless(search: Search, point: Point) -> list[str]:
    """The absent candidates whose columns are zero because no derivative exists at their neutral value."""
    model = search.model
    return [
        effect
        for effect, columns in model.candidates.items()
        if any(k in model.probes and point.values[k] == model.neutral[k] for k in columns)
    ]


def probed(search: Search, linear: Linear, effect: str) -> Linear:
    """The problem linearised where an `effect` without a slope at neutral has its probe, all else as in `linear`."""
    (column,) = search.model.candidates[effect]
    values = linear.point.values.copy()
    values[column] = search.model.probes[column]
    z = search.segments.with_steady_memories(values, linear.point.z, effect)
    return search.linearise(linear.point._replace(values=values, z=z), most=0)


def value_beside(search: Search, beside: Linear, effects: Sequence[str], effect: str) -> float:
    """The value of `effect` in the `probed` problem `beside`, with the others of `effects`."""
    (column,) = search.model.candidates[effect]
    optimum = beside.subsets.with_effects([*effects, effect])
    return max(float(beside.point.values[column] + optimum.step[column]), NEAREST * search.model.probes[column])


def _tested_beside(search: Search, linear: Linear, effects: Sequence[str], effect: str) -> float | None:
    """The value of an `effect` without a slope at neutral, from a linearisation beside it, where chi^2 falls by more
    than its threshold against that *at* neutral; else None.
    """
    beside = probed(search, linear, effect)
    chi2 = beside.subsets.with_effects([*effects, effect]).chi2
    if not linear.subsets.with_effects(effects).chi2 - chi2 > beside.subsets.threshold(effect):
        return None
    return value_beside(search, beside, effects, effect)
