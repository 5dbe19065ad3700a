"""Explaining recordings of which many short windows are given: a real vehicle that nobody set down at rest."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import NamedTuple, Unpack

import numpy as np

from snakejax.core.progress import Progress, no_progress
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Effect
from snakejax.estimation.discrepancy.segment_dynamics import BODY
from snakejax.estimation.discrepancy.strength import Scales, window_force
from snakejax.estimation.goodness_of_fit import largest_noise_misfit
from snakejax.estimation.initialisation import is_short
from snakejax.estimation.problem import Problem
from snakejax.estimation.window_fit import WindowPoint, scale_of
from snakejax.recording.run import Case, Noise

from ..diagnosing import Diagnosis, DiagnosisOptions, start_of
from ..explanation import Explanation, PoseError, Remainder, TriedCandidate, vehicle_constants
from ..inexact.candidate_model import candidate_model, movable_parameters
from ..inexact.confidence import AMBIGUOUS, LIKELY, SURE
from ..inexact.explaining import shares_of_errors
from ..selection.candidates import BaseFit, CandidateSet, structures
from ..selection.criteria import SelectionCriteria
from ..selection.steps import SWITCH_DESCRIPTION, CandidateScore, SelectionStep
from .repeatability import repeatability_floor
from .search import Candidate, SearchState, WindowSearch, first_state, further_states, left_out_gain, twins
from .steps import step_of

WIDTH = 26
"""Parameters that one compiled program can free: with the six of a start state four registers of derivatives."""
FEWEST_RECORDINGS = 4
"""With fewer recordings each is divided into parts of consecutive windows that are left out one by one."""
PARTS = 3
"""The number of those parts of each."""
MOST_RECORDINGS = 24
"""More recordings than these are left out in as many groups of consecutive ones."""
LARGEST_RATIO = 2.0
"""Windows are explained where the model leaves at most so many times what the vehicle itself does not repeat under
constant commands: of the squared error a quarter is then the vehicle's own."""


def supports(case: Case) -> bool:
    """Whether all train runs of `case` are short and begin in motion, and are enough to leave some out."""
    train = case.having("train")
    return len(train) > 2 * FEWEST_RECORDINGS and all(is_short(run) for run in train)


class WindowQuestion(NamedTuple):
    """The candidates and the search under each structure, the base's first, and the effects that it holds."""

    sets: tuple[CandidateSet, ...]
    searches: tuple[WindowSearch, ...]
    with_: tuple[str, ...]

    def first(self, number: int) -> SearchState:
        """The model of structure `number` without effects, fitted."""
        problem = self.searches[number].problem
        return first_state(self.searches[number], WindowPoint(problem.values(), np.asarray(problem.batch.start)))

    def step(self, number: int, state: SearchState) -> SelectionStep:
        """The record of `state` under structure `number`."""
        switch = LATERAL_SLIP_SWITCH if number and not state.effects else ""
        return step_of(self.searches[number], self.sets[number], state, switch, self.with_)


def _path(question: WindowQuestion) -> tuple[list[tuple[int, SearchState]], bool]:
    """The states from the base on, each with the number of its structure; and whether they go over to the other one.

    They do where recordings left out are predicted better by it. Where two things are wrong at once, one of them alone
    need not do so: then the ends of both ways are compared.
    """
    base = question.first(0)
    if len(question.sets) == 1:
        return [(0, base), *((0, state) for state in further_states(question.searches[0], base))], False
    relaxed = question.first(1)
    at_once = left_out_gain(base.linear, relaxed.linear).exceeds_standard_error
    others = [relaxed, *further_states(question.searches[1], relaxed)]
    own = [base] if at_once else [base, *further_states(question.searches[0], base)]
    if at_once or left_out_gain(own[-1].linear, others[-1].linear).exceeds_standard_error:
        return [(0, base), *((1, state) for state in others)], True
    return [(0, state) for state in own], False


def _beside_structure(base: SelectionStep, relaxed: SelectionStep, predicts: bool) -> SelectionStep:
    """The `base` with the other structure among its candidates: first where it `predicts` better, else last.

    Its fit is the step `relaxed`.
    """
    other = CandidateScore(
        effect=LATERAL_SLIP_SWITCH,
        description=SWITCH_DESCRIPTION,
        refit_misfit=relaxed.train.misfit,
        converged=relaxed.converged,
    )
    ranking = (other, *base.ranking) if predicts else (*base.ranking, other)
    return dataclasses.replace(base, ranking=ranking)


def _window_question(
    case: Case, noise: Noise, library: Mapping[str, Effect], question: DiagnosisOptions
) -> WindowQuestion:
    """The question with all that it needs."""
    criteria = question.get("criteria") or SelectionCriteria.of(case)
    progress = question.get("progress", no_progress)
    with_ = tuple(question.get("with_", ()))
    how = BaseFit(frozenset(question.get("held", ())))
    options = structures(case, "", None, start_of(case, question))[: 2 if question.get("switch", True) else 1]
    sets = tuple(
        CandidateSet.of(model, case, noise, library, switched=k > 0, criteria=criteria, how=how)
        for k, model in enumerate(options)
    )
    searches = tuple(window_search(case, noise, one, with_, progress, how.held) for one in sets)
    return WindowQuestion(sets, searches, with_)


def diagnose_windows(
    case: Case, noise: Noise, library: Mapping[str, Effect], **question: Unpack[DiagnosisOptions]
) -> Diagnosis:
    """The base fitted to the windows of `case`, with the candidates ranked by what recordings left out gain.

    **Raises:** `FitError` where the simulation of every window fails.
    """
    window_question = _window_question(case, noise, library, question)
    base = window_question.first(0)
    step = window_question.step(0, base)
    if len(window_question.sets) > 1:
        relaxed = window_question.first(1)
        gain = left_out_gain(base.linear, relaxed.linear)
        step = _beside_structure(step, window_question.step(1, relaxed), gain.exceeds_standard_error)
    return Diagnosis(case, noise, step)


def explain_windows(
    case: Case, noise: Noise, library: Mapping[str, Effect], **question: Unpack[DiagnosisOptions]
) -> Explanation:
    """Which effects of `library` the windows of `case` show, each added where it predicts recordings left out better.

    **Raises:** `FitError` where the simulation of every window fails.
    """
    window_question = _window_question(case, noise, library, question)
    path, other_predicts = _path(window_question)
    steps = [window_question.step(k, state) for k, state in path]
    if other_predicts:
        steps[0] = _beside_structure(steps[0], steps[1], other_predicts)
    return _explanation(case, noise, steps, [(window_question.searches[k], state) for k, state in path])


def window_search(
    case: Case,
    noise: Noise,
    candidate_set: CandidateSet,
    with_: tuple[str, ...],
    progress: Progress,
    held: Collection[str] = (),
) -> WindowSearch:
    """The search under the structure of `candidate_set`, in which the effects `with_` are always present and the
    constants `held` keep their value."""
    model, train = candidate_set.problem.model, case.having("train")
    scales = Scales(np.asarray(noise.channels), window_force(model, train))
    parts = candidate_set.tyre, candidate_set.candidates, with_
    candidates = candidate_model(model, *parts, scales, case.constant_sd, held)
    names = movable_parameters(model, *parts, held)
    problem = Problem.of(model, case.runs, noise, names, min(WIDTH, len(names)))
    windows = problem.run_indices("train")
    recording = recordings_of([case.runs[k].recorded_as for k in windows])
    return WindowSearch(problem, candidates, tuple(windows), recording, candidate_set.criteria, progress)


def recordings_of(names: list[str]) -> np.ndarray:
    """The number of the recording of each window; with few that of a part of one, see `PARTS`, with many that of a
    group, see `MOST_RECORDINGS`."""
    _, number = np.unique(names, return_inverse=True)
    count = int(number.max()) + 1
    if count >= FEWEST_RECORDINGS:
        return number if count <= MOST_RECORDINGS else number * MOST_RECORDINGS // count
    part = np.zeros(len(names), int)
    for k in np.unique(number):
        own = np.flatnonzero(number == k)
        part[own] = np.arange(len(own)) * PARTS // len(own)
    return np.unique(number * PARTS + part, return_inverse=True)[1]


def _explanation(
    case: Case, noise: Noise, steps: list[SelectionStep], path: list[tuple[WindowSearch, SearchState]]
) -> Explanation:
    search, last = path[-1]
    final, criteria = steps[-1], search.criteria
    others = {effect: twins(search, last, effect) for effect in last.effects}
    floor = repeatability_floor(case.having("train"), np.asarray(noise.channels))
    remainder = _remainder(final, floor)
    near = floor is not None and remainder is not None and _near(remainder, floor)
    near = near or _only_noise(final, len(search.model.free(last.effects)))
    effects = tuple(effect for effect in final.effects if effect not in steps[0].effects)
    verdict = ("explained" if effects else "adequate") if near else "unexplained"
    share, explained_share = _shares(path, steps)
    confidence = {
        effect: _confidence(search.candidate(last.linear, effect), others[effect], criteria, search)
        for effect in last.effects
    }
    if LATERAL_SLIP_SWITCH in effects:
        confidence[LATERAL_SLIP_SWITCH] = SURE
    return Explanation(
        case,
        noise,
        tuple(steps),
        verdict,
        effects if near else (),
        () if near else effects,
        steps[0].left_out,
        None,
        confidence=confidence,
        share=share,
        explained_share=explained_share,
        floor=floor,
        remainder=remainder,
        candidates=tuple(row for k in range(len(path)) for row in _tried(path, k, others)),
        constants=vehicle_constants(final),
        of_windows=True,
    )


def _confidence(
    candidate: Candidate, others: tuple[str, ...], criteria: SelectionCriteria, search: WindowSearch
) -> str:
    """`ambiguous` where recordings left out cannot tell another from it, `sure` where its p-value holds for the whole
    family of candidates, else `likely`."""
    if others:
        return AMBIGUOUS
    family = len(search.model.candidates)
    return SURE if candidate.p_value * family < criteria.significance_level else LIKELY


def _median_error(step: SelectionStep) -> tuple[float, float]:
    """The median over held-out windows (train windows without any) of their errors [m, rad]."""
    role = "train" if step.heldout is None else "heldout"
    errors = np.array([(run.position_m, run.heading_rad) for run in step.runs if run.role == role])
    return float(np.median(errors[:, 0])), float(np.median(errors[:, 1]))


def _shares(path: list[tuple[WindowSearch, SearchState]], steps: list[SelectionStep]) -> tuple[dict[str, float], float]:
    """By step the share of the error of the base, on recordings left out, that it takes away, and that of all together.

    The error is the robust one on the scale of the base: that of the mean square would be the error of the few windows
    in which a model spins.
    """
    scale = scale_of(path[0][1].linear.mean_square)
    errors = [float(state.linear.error(state.effects, scale).sum()) for _, state in path]
    return shares_of_errors(steps, errors)


def _remainder(final: SelectionStep, floor: PoseError | None) -> Remainder | None:
    """What the median window has above the floor, in squares."""
    if floor is None:
        return None
    return Remainder.above(floor, *_median_error(final))


def _near(remainder: Remainder, floor: PoseError) -> bool:
    above = LARGEST_RATIO**2 - 1.0
    return (
        remainder.position_m**2 <= above * floor.position_m**2
        and remainder.heading_rad**2 <= above * floor.heading_rad**2
    )


def _only_noise(final: SelectionStep, parameters: int) -> bool:
    """Whether only the noise that is stated or estimated is left, in held-out windows too."""
    known = [(final.train, parameters, "train")]
    if final.heldout is not None:
        known.append((final.heldout, 0, "heldout"))
    for score, estimated, role in known:
        starts = BODY * sum(run.role == role for run in final.runs)
        if not score.misfit <= largest_noise_misfit(score.samples, estimated + starts):
            return False
    return True


def _tried(
    path: list[tuple[WindowSearch, SearchState]], number: int, others: dict[str, tuple[str, ...]]
) -> list[TriedCandidate]:
    """One row for each candidate beside one state; what the next state has is `taken`. `others`: the twins of each
    effect of the last state."""
    search, state = path[number]
    after = path[number + 1] if number + 1 < len(path) else (None, state)
    following = after[1].effects if after[0] is search else ()
    family, last = len(search.model.candidates), path[-1][1].effects
    rows = []
    for one in state.candidates:
        taken = one.effect in following
        p = min(1.0, one.p_value * family)
        why = _why(one, taken, one.effect in last, search.criteria)
        instead = tuple(effect for effect, twin in others.items() if one.effect in twin)
        rows.append(TriedCandidate(number, one.effect, one.gain.share, p, None, taken, why, instead))
    return rows


def _why(one: Candidate, taken: bool, later: bool, criteria: SelectionCriteria) -> str:
    gained = f"the error of omitted recordings falls by {one.gain.share:.2%}"
    if taken:
        return f"taken: {gained}"
    if later:
        return "taken in a later step"
    if one.at_bound:
        return "refused: it ends on a bound of its domain"
    if not one.gain.exceeds_standard_error:
        return "refused: it improves the prediction of omitted recordings by less than the standard error"
    if one.gain.share < criteria.least_excess_share:
        return f"refused: the improvement is too small, {gained}"
    if not one.p_value < criteria.agreement_level:
        return f"refused: the recordings do not agree on its value (p = {one.p_value:.2g})"
    return f"refused: another effect lowers the error more, or this one lowers it less in the full fit; {gained}"
