"""The clocks of joint logs, estimated together with the parameters of the model.

The motion alone tells how far the clocks of log and cameras are apart to some hundredths of a second; the model tells
it to milliseconds. Around a fit the residuals depend on the offset o and the drift d of each run's log almost linearly,
so one step of Gauss and Newton, over parameters, starts and clocks together, moves the clocks, and the fit is repeated.
In the end parameters and clocks have the standard errors of both together. What noise in the logs does to a run, its
wander, is drawn under a first fit, and the fit repeated with residuals that it does not make dependent.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._approach import require_sound
from ._errors import FitError
from ._estimates import spread
from ._fit import Fit, described, fit
from ._least_squares import starts_removed
from ._log_clocks import STEPS, STILL, by_clock, by_clocks, free_clocks, moved_clock
from ._log_noise import is_noisy, wandering
from ._model import Model
from ._recording import Case, Noise, Run
from ._replay import fitted_starts
from ._starting import chosen, default_free
from ._study import Optimum, Study, inverse
from ._window_clocks import window_clocks

FAR_OFF = 50.0
"""Above this misfit a model does not say what noise in the logs does."""
ROUNDS = 8
"""Fits after which the clocks stand still, or never do."""


def fit_logged(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """`fit`, and with it the free clocks of joint logs: the runs of the fit have them, with standard errors; and their
    wander, where the logs have noise.

    What the parameters' errors owe to the clocks, and both to noise in the logs, is in them.
    """
    if clocked := any(free_clocks(run) for run in runs):
        names = default_free(model) if free is None else chosen(model, free)
        runs = window_clocks(model, runs, noise, names, progress)
    found = fit(model, runs, noise, free, threshold=threshold, progress=progress)
    told = with_wander(found, progress)
    if told is not None:
        found = _refitted(found, told, threshold)
    if clocked:
        found = aligned(found, threshold, progress)
    return with_clock_errors(found, progress)


def aligned(found: Fit, threshold: float, progress: Callable[[str], None]) -> Fit:
    """`found` with clocks that stand still. **Raises:** `FitError` where the runs do not tell them."""
    for _ in range(ROUNDS):
        progress("aligning the clocks of the joint logs")
        runs, moved = align(found)
        found = _refitted(found, runs, threshold)
        if moved < STILL:
            break
    return found


def _refitted(found: Fit, runs: Sequence[Run], threshold: float) -> Fit:
    """The fit of `runs`, from where that of theirs as they were ended."""
    before, began = found.study, found.optimum
    study = Study.of(before.model, runs, before.noise, before.names, before.width, before.accuracy)
    train = study.numbered("train")
    optimum = study.fit(began.values, began.free, train, began.start, threshold=threshold)
    return described(study, require_sound(study, optimum, train))


def with_wander(found: Fit, progress: Callable[[str], None] = lambda _: None) -> tuple[Run, ...] | None:
    """The runs of `found` with what noise in their logs brings; None where there is none, or the model is too far off
    to say what it does.
    """
    if not (any(is_noisy(run.gait) for run in found.study.runs) and found.optimum.misfit < FAR_OFF):
        return None
    progress("what noise in the joint logs does")
    try:
        return wandering(found.model, found.study.runs, fitted_starts(found))
    except FitError:
        return None


def with_logs_told(model: Model, case: Case, noise: Noise, progress: Callable[[str], None] = lambda _: None) -> Case:
    """`case` with the free clocks of its joint logs where short windows under `model` want them, and with what noise in
    the logs does; itself where there is nothing to tell.
    """
    if any(free_clocks(run) for run in case.runs):
        runs = window_clocks(model, case.runs, noise, default_free(model), progress)
        case = dataclasses.replace(case, runs=runs)
    if any(is_noisy(run.gait) for run in case.runs):
        try:
            runs = with_wander(fit(model, case.runs, noise, progress=progress), progress)
        except FitError:
            runs = None
        case = case if runs is None else dataclasses.replace(case, runs=runs)
    return case


def align(found: Fit) -> tuple[tuple[Run, ...], float]:
    """The runs of `found` with their free clocks where the residuals want them, and the largest move in its standard
    errors. Held-out runs have theirs estimated under the fitted parameters, as their starts are.
    """
    study = found.study
    runs, moved = list(study.runs), 0.0
    for role, optimum in (("train", found.optimum), ("heldout", found.heldout_optimum)):
        numbers = [k for k in study.numbered(role) if (log := study.runs[k].log) is not None and log.free]
        if optimum is None or not numbers:
            continue
        joint = _linear(study, optimum, study.numbered(role), found.optimum)
        step, errors = joint.step(optimum.linearised.residual), np.sqrt(np.diag(joint.covariance)) * spread(optimum)
        sds_of = by_clock(study.runs, joint.numbers, errors)
        for k, steps in by_clock(study.runs, joint.numbers, step).items():
            runs[k] = moved_clock(study.runs[k], steps, sds_of[k], "the fit")
            moved = max(moved, *(abs(steps[name]) / sd for name, sd in sds_of[k].items()))
    return tuple(runs), moved


def with_clock_errors(found: Fit, progress: Callable[[str], None] = lambda _: None) -> Fit:
    """`found` with the errors that free clocks of the joint logs bring; itself where there are none."""
    study, optimum = found.study, found.optimum
    if not any(free_clocks(run) for run in study.runs):
        return found
    progress("what the joint logs leave open")
    joint = _linear(study, optimum, study.numbered("train"), optimum)
    runs = list(study.runs)
    wider = optimum._replace(covariance=joint.covariance[joint.count :, joint.count :])
    _set_errors(runs, joint, np.sqrt(np.diag(joint.covariance)) * spread(optimum))
    if (judged := found.heldout_optimum) is not None:
        unseen = _linear(study, judged, study.numbered("heldout"), wider)
        _set_errors(runs, unseen, np.sqrt(np.diag(unseen.covariance)) * spread(judged))
    return described(dataclasses.replace(study, runs=tuple(runs)), wider)


def _set_errors(runs: list[Run], joint: "_Linear", errors: np.ndarray) -> None:
    for k, sds in by_clock(runs, joint.numbers, errors).items():
        log = runs[k].log
        assert log is not None
        named = {f"{name}_sd": sd for name, sd in sds.items()}
        runs[k] = dataclasses.replace(runs[k], log=log._replace(**named))


class _Linear(NamedTuple):
    """Runs `numbers` around a fit as linear in `count` clocks, run by run, and then in the loose parameters.

    `columns`: for each run the derivative (N, c + K) of its residuals, starts projected out; `covariance` of the steps
    for unit noise. Of held-out runs, whose parameters are given, the clocks alone move, `moving` of the columns.
    """

    numbers: list[int]
    count: int
    columns: list[Float[np.ndarray, "N c"]]
    moving: int
    inverse: Float[np.ndarray, "m m"]
    covariance: Float[np.ndarray, "m m"]

    def step(self, residual: Float[np.ndarray, "R n 3"]) -> Float[np.ndarray, " m"]:
        """The Gauss-Newton step that `residual` asks for."""
        parts = zip(self.numbers, self.columns, strict=True)
        return -self.inverse @ sum(part[:, : self.moving].T @ np.asarray(residual[k]).reshape(-1) for k, part in parts)


def _linear(study: Study, optimum: Optimum, numbers: list[int], fitted: Optimum) -> _Linear:
    """The runs `numbers` around `optimum`, with the parameters that the `fitted` one left loose.

    Parameters that `optimum` holds where the `fitted` one has them move no clock, but their errors are in its own.
    """
    loose = [fitted.free.index(name) for name in fitted.loose]
    given = fitted.free != optimum.free
    if given:
        there = study.at(optimum.values, fitted.free, optimum.start)
        optimum = optimum._replace(linearised=study.evaluate(there, numbers))
    count = sum(len(free_clocks(study.runs[k])) for k in numbers)

    def residual(moved: Study) -> np.ndarray:
        at = moved.at(optimum.values, optimum.free, optimum.start)
        return np.asarray(moved.evaluate(at, numbers).residual)

    slopes = {name: by_clocks(study, name, residual) for name in STEPS} if count else {}
    free_start = np.asarray(study.batch.free_start)
    columns, at = [], 0
    for k in numbers:
        names = free_clocks(study.runs[k])
        own = np.stack([slopes[name][k].reshape(-1) for name in names], axis=1) if names else None
        r, J = starts_removed(optimum.linearised, k, study.width, free_start, own)
        part = np.zeros((r.size, count + len(loose)))
        part[:, count:] = J[:, loose]
        part[:, at : at + len(names)] = J[:, study.width :]
        at += len(names)
        columns.append(part)
    if not all(np.isfinite(part).all() for part in columns):
        raise FitError("The clocks of the joint logs cannot be told: the model goes astray where they move by 4 ms.")
    normal = sum((part.T @ part for part in columns), np.zeros((count + len(loose),) * 2))
    if not given:
        covariance = inverse(normal)
        return _Linear(numbers, count, columns, count + len(loose), covariance, covariance)
    alone = inverse(normal[:count, :count])
    by_parameters = alone @ normal[:count, count:]
    covariance = alone + by_parameters @ fitted.covariance @ by_parameters.T
    return _Linear(numbers, count, columns, count, alone, covariance)
