"""The search for effects in windows: linearise, compare the candidates on recordings left out, add the best, refit.

Windows are linearised with their robust weights, and a window counts as one pose (`estimation.window_fit`). One
recording after the other is left out: the parameters are those of the others, by the linear problem, and its error is
robust, so that no window in which the model spins decides.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.ports import Delay
from snakejax.estimation.block_linearisation import DELAY_STEP
from snakejax.estimation.discrepancy.least_squares import Optimum, Prior
from snakejax.estimation.initialisation import EARLY
from snakejax.estimation.problem import Problem
from snakejax.estimation.window_fit import (
    WindowPoint,
    WindowPrior,
    fit_windows_robustly,
    linearised_windows,
    scale_of,
    variance_of,
    weights_of,
)

from ..inexact.candidate_model import CandidateModel
from ..inexact.left_out import Gain
from ..inexact.search import FURTHEST_FACTOR
from ..inexact.subsets import Subsets
from ..selection.criteria import CRITERIA, SelectionCriteria

KNOWN_WITHIN = 2.0
"""A constant of the vehicle is at most this many standard deviations from its stated value: 95% of what is known."""
MOST_EFFECTS = 8
"""Effects that are added, at most."""
MOST_REFITTED = 3
"""Candidates that are refitted in one round, at most."""


class Candidate(NamedTuple):
    """One effect beside a model: its `gain` on recordings left out, as a share of their error without it; `p_value` of
    its parameters `values` being at their neutral value, by the jackknife over recordings; `sd` of their steps;
    `at_bound`: one of them ends on a bound of its domain."""

    effect: str
    gain: Gain
    p_value: float
    values: tuple[float, ...]
    sd: np.ndarray
    at_bound: bool

    def predicts(self, criteria: SelectionCriteria) -> bool:
        """Whether recordings left out are predicted better by enough to matter, with parameters on which the recordings
        agree."""
        agreed = self.p_value < criteria.agreement_level and not self.at_bound
        return agreed and self.gain.exceeds_standard_error and self.gain.share >= criteria.least_excess_share


class WindowProblem(NamedTuple):
    """The linear problem at a `point` with `effects`: `subsets`, and the Gram matrices `recording_grams`
    (F, P + 1, P + 1) of the recordings, weighted; the mean squares of the windows at the point, and by recording the
    Gram matrices `window_grams` of each window per sample, without weights."""

    point: WindowPoint
    effects: tuple[str, ...]
    subsets: Subsets
    recording_grams: Float[np.ndarray, "F P1 P1"]
    mean_square: Float[np.ndarray, " W"]
    window_grams: tuple[Float[np.ndarray, "w P1 P1"], ...]

    def error(self, effects: Iterable[str], scale: float | None = None) -> Float[np.ndarray, " F"]:
        """The robust error (F,) of each recording under parameters from the others, in windows as far off as `scale`
        (default: that of the point): the sum of ln(1 + c_w / s^2)."""
        effects, scale = list(effects), scale_of(self.mean_square) if scale is None else scale
        errors = []
        for windows, whole in zip(self.window_grams, self.recording_grams, strict=True):
            weights = np.concatenate([[1.0], -self.subsets.with_effects(effects, self.subsets.gram - whole).step])
            square = np.maximum(np.einsum("i,wij,j->w", weights, windows, weights), 0.0)
            errors.append(np.log1p(square / scale).sum())
        return np.array(errors)

    def jackknife(self, effects: Iterable[str], columns: Sequence[int]) -> tuple[Optimum, np.ndarray]:
        """The optimum with `effects`, and the covariance (k, k) of its steps of the parameters numbered `columns` by
        the jackknife over the recordings (Efron and Stein 1981)."""
        effects, rows = list(effects), list(columns)
        subsets, grams = self.subsets, self.recording_grams
        others = np.array([subsets.with_effects(effects, subsets.gram - gram).step[rows] for gram in grams])
        off, F = others - others.mean(axis=0), len(grams)
        return subsets.with_effects(effects), (F - 1) / F * off.T @ off


class WindowSearch(NamedTuple):
    """What a search has at hand: the `problem` of all runs, the candidates in `model`, the numbers of the `windows`
    and, for each, that of the recording of which it is cut."""

    problem: Problem
    model: CandidateModel
    windows: tuple[int, ...]
    recording: Float[np.ndarray, " W"]
    criteria: SelectionCriteria = CRITERIA
    progress: Progress = no_progress

    @property
    def prior(self) -> WindowPrior:
        """The prior of all parameters; constants of the vehicle stay within `KNOWN_WITHIN`."""
        model, limits = self.model, {}
        for k in model.constants:
            factor = float(np.exp(KNOWN_WITHIN * model.sd[k]))
            limits[model.names[k]] = (model.neutral[k] / factor, model.neutral[k] * factor)
        free = WindowPrior({}, {}, limits).domains(self.problem, model.names)
        mean = {name: free[name].step_to(float(model.neutral[k])) for k, name in enumerate(model.names)}
        return WindowPrior(mean, dict(zip(model.names, model.sd, strict=True)), limits)

    def secants(self, point: WindowPoint) -> Mapping[str, float]:
        """The parameters without a derivative at `point`, with the step of a difference quotient."""
        known, steps = self.problem.model.effects, {}
        for effect, columns in self.model.candidates.items():
            for k in columns:
                name = self.model.names[k]
                secant = known[effect].secant_step.get(name.rsplit(".", 1)[-1])
                if isinstance(known[effect], Delay):
                    steps[name] = DELAY_STEP
                elif secant is not None and point.values[name] == self.model.neutral[k]:
                    steps[name] = secant
        return steps

    def fitted(self, point: WindowPoint, effects: Iterable[str], until: float = np.inf) -> WindowPoint:
        """The model with `effects` fitted from `point`; absent effects are neutral."""
        model, effects = self.model, tuple(effects)
        values = dict(point.values)
        for effect, columns in model.candidates.items():
            if effect not in effects:
                values |= {model.names[k]: float(model.neutral[k]) for k in columns}
        point = point._replace(values=values)
        free = [model.names[k] for k in model.free(effects)]
        return fit_windows_robustly(
            self.problem, point, free, self.windows, self.prior, until=until, secants=self.secants(point)
        )

    def linear(self, point: WindowPoint, effects: Iterable[str]) -> WindowProblem:
        """The linear problem of all candidates at `point`."""
        names, prior = self.model.names, self.prior
        columns = linearised_windows(self.problem, point, names, self.windows, secants=self.secants(point))
        weight = weights_of(columns.mean_square, scale_of(columns.mean_square)) / variance_of(columns)
        usable = np.all(np.isfinite(columns.residual), axis=1)
        residual, by_values = columns._replace(residual=np.where(usable[:, None], columns.residual, 0.0)).without_starts
        # The error after a step d is the residual less its columns times d.
        joined = np.concatenate([residual[..., None], -by_values], axis=-1) * np.sqrt(weight)[:, None, None]
        each = joined.transpose(0, 2, 1) @ joined
        numbers = np.unique(self.recording)
        recording_grams = np.array([each[self.recording == number].sum(axis=0) for number in numbers])
        bare = each / (weight * columns.samples)[:, None, None]
        domains = prior.domains(self.problem, names).values()
        values = [point.values[name] for name in names]
        low = np.array([_step_to(d, v, d.low) for d, v in zip(domains, values, strict=True)])
        high = np.array([_step_to(d, v, d.high) for d, v in zip(domains, values, strict=True)])
        mean = [prior.mean[n] - d.step_to(v) for n, d, v in zip(names, domains, values, strict=True)]
        precision = 1.0 / np.array([prior.sd[name] for name in names]) ** 2
        subsets = Subsets(
            recording_grams.sum(axis=0),
            self.model.always,
            self.model.candidates,
            Prior(np.array(mean), precision),
            low,
            high,
            self.criteria,
        )
        window_grams = tuple(bare[self.recording == number] for number in numbers)
        return WindowProblem(point, tuple(effects), subsets, recording_grams, columns.mean_square, window_grams)

    def candidate(self, linear: WindowProblem, effect: str) -> Candidate:
        """`effect` beside the other effects of `linear`, whether it is in the model or not."""
        rest = [other for other in linear.effects if other != effect]
        columns = list(self.model.candidates[effect])
        without = linear.error(rest)
        by_part = without - linear.error([*rest, effect])
        gain = Gain(by_part, float(by_part.sum() / without.sum()))
        optimum, covariance = linear.jackknife([*rest, effect], columns)
        step = optimum.step[columns]
        moved = self._moved(linear.point, columns, step)
        domains = list(self.prior.domains(self.problem, [self.model.names[k] for k in columns]).values())
        at_bound = any(
            value != self.model.neutral[k] and not d.low < value < d.high
            for k, d, value in zip(columns, domains, moved, strict=True)
        )
        # The step from the neutral value, for which the prior has its mean.
        away = step - linear.subsets.prior.mean[columns]
        p_value = _p_value(away, covariance, len(linear.recording_grams))
        return Candidate(effect, gain, p_value, moved, larger_sd(optimum, covariance, columns), at_bound)

    def _moved(self, point: WindowPoint, columns: Sequence[int], step: np.ndarray) -> tuple[float, ...]:
        names = [self.model.names[k] for k in columns]
        domains = self.prior.domains(self.problem, names)
        return tuple(d.moved_inside(point.values[name], s) for (name, d), s in zip(domains.items(), step, strict=True))


def larger_sd(optimum: Optimum, covariance: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Standard deviation (k,) of the steps of the parameters numbered `columns`: the larger one of that of windows that
    count as one pose each and that of the jackknife, of this `covariance` (k, k)."""
    return np.maximum(optimum.sd[list(columns)], np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _step_to(domain, value: float, end: float) -> float:
    if not domain.multiplicative:
        return end - value
    furthest = float(np.log(FURTHEST_FACTOR))
    return float(np.clip(np.log(max(end, 1e-300) / value), -furthest, furthest))


def _p_value(away: np.ndarray, covariance: np.ndarray, recordings: int) -> float:
    """The probability of such values by chance (Hotelling's T^2 with the jackknife covariance); 1 where there are too
    few recordings to tell."""
    k = len(away)
    if recordings <= k or not np.any(away) or np.linalg.matrix_rank(covariance) != k:
        return 1.0
    t2 = float(away @ np.linalg.solve(covariance, away))
    return float(stats.f.sf(t2 * (recordings - k) / (k * (recordings - 1)), k, recordings - k))


class SearchState(NamedTuple):
    """One state of the search: the linear problem at its optimum, and the candidates beside it, the best first;
    `dropped`: the effect that the state before has more, if any."""

    linear: WindowProblem
    candidates: tuple[Candidate, ...]
    dropped: str = ""

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects in the model."""
        return self.linear.effects


def first_state(search: WindowSearch, point: WindowPoint) -> SearchState:
    """The model without effects, fitted from `point`: first the beginnings of the windows, then all of them."""
    search.progress(ProgressEvent(Phase.FIRST_SECONDS))
    point = search.fitted(point, (), until=EARLY)
    search.progress(ProgressEvent(Phase.WINDOWS))
    return _state(search, search.fitted(point, ()), ())


def further_states(search: WindowSearch, first: SearchState) -> list[SearchState]:
    """The states that follow the `first`: each has one effect more, or one less where it has become idle."""
    states, known = [first], {frozenset(first.effects)}
    while len(states[-1].effects) < MOST_EFFECTS:
        event = ProgressEvent(Phase.CHOOSING_EFFECTS, "choosing effects by recordings left out")
        search.progress(event._replace(done=len(states[-1].effects) + 1, total=MOST_EFFECTS))
        further = _further(search, states[-1])
        if further is None:
            break
        following = [further, *_without_idle_effects(search, further)]
        if frozenset(following[-1].effects) in known:
            break
        states += following
        known.add(frozenset(following[-1].effects))
    return states[1:]


def _without_idle_effects(search: WindowSearch, state: SearchState) -> list[SearchState]:
    """The states that follow as effects are dropped, the one of the least gain first, that no longer predict recordings
    left out better beside the others (backward elimination)."""
    states: list[SearchState] = []
    while True:
        tried = [search.candidate(state.linear, effect) for effect in state.effects]
        idle = [one for one in tried if not one.predicts(search.criteria)]
        if not idle:
            return states
        dropped = min(idle, key=lambda one: one.gain.by_part.sum()).effect
        effects = tuple(effect for effect in state.effects if effect != dropped)
        state = _state(search, search.fitted(state.linear.point, effects), effects)._replace(dropped=dropped)
        states.append(state)


def left_out_gain(before: WindowProblem, after: WindowProblem) -> Gain:
    """What recordings left out gain from one model to another, on the scale of the first."""
    scale = scale_of(before.mean_square)
    first, second = before.error(before.effects, scale), after.error(after.effects, scale)
    return Gain(first - second, float(1.0 - second.sum() / first.sum()))


def _state(search: WindowSearch, point: WindowPoint, effects: Sequence[str]) -> SearchState:
    linear = search.linear(point, effects)
    absent = [effect for effect in search.model.candidates if effect not in effects]
    tried = [search.candidate(linear, effect) for effect in absent]
    return SearchState(linear, tuple(sorted(tried, key=lambda one: -one.gain.by_part.sum())))


def _further(search: WindowSearch, last: SearchState) -> SearchState | None:
    """The state with one effect more, which still predicts recordings left out where it was fitted; None without."""
    useful = [one for one in last.candidates if one.predicts(search.criteria)]
    for one in useful[:MOST_REFITTED]:
        columns = search.model.candidates[one.effect]
        start = dict(zip((search.model.names[k] for k in columns), one.values, strict=True))
        effects = (*last.effects, one.effect)
        point = last.linear.point._replace(values=last.linear.point.values | start)
        state = _state(search, search.fitted(point, effects), effects)
        if search.candidate(state.linear, one.effect).predicts(search.criteria):
            return state
    return None


def twins(search: WindowSearch, state: SearchState, effect: str) -> tuple[str, ...]:
    """The candidates that these recordings cannot tell from `effect`, the best first.

    In its place they predict recordings left out by less than the standard error of the difference worse, and lose less
    than half of its gain.
    """
    linear = state.linear
    rest = [other for other in linear.effects if other != effect]
    own, without = linear.error([*rest, effect]), linear.error(rest)
    costs = {}
    for other in search.model.candidates:
        if other not in linear.effects:
            cost = linear.error([*rest, other]) - own
            error = np.sqrt(len(cost)) * cost.std(ddof=1) if len(cost) > 1 else np.inf
            if cost.sum() < min(error, 0.5 * (without - own).sum()):
                costs[other] = float(cost.sum())
    return tuple(sorted(costs, key=lambda other: costs[other]))
