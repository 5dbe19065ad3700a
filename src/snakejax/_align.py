"""The clocks of joint logs, estimated together with the parameters of the model.

The motion alone tells how far the clocks of log and cameras are apart to some hundredths of a second; the model tells
it to milliseconds. Around a fit the residuals depend on the offset o and the drift d of each run's log almost linearly,
so one step of Gauss and Newton, over parameters, starts and clocks together, moves the clocks, and the fit is repeated.
"""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._approach import require_sound
from ._estimates import spread
from ._fit import Fit, described, fit
from ._gait import on_clock
from ._least_squares import starts_removed
from ._model import Model
from ._recording import Case, LogClock, Noise, Run
from ._study import Optimum, Study, inverse

ROUNDS = 8
"""Fits after which the clocks stand still, or never do."""
STILL = 0.2
"""Clocks that move by less than this share of their standard error stand still."""
STEPS = {"offset": 4e-3, "drift": 4e-4}
"""Steps of the central differences: [s] and [-]; smaller ones would show the solver's errors along a noisy log."""


def fit_logged(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """`fit`, and with it the free clocks of joint logs: the runs of the fit have them, with standard errors."""
    found = fit(model, runs, noise, free, threshold=threshold, progress=progress)
    for _ in range(ROUNDS if any(_free(run) for run in runs) else 0):
        progress("aligning the clocks of the joint logs")
        aligned, moved = align(found)
        before = found.study
        study = Study.of(model, aligned, noise, before.names, before.width, before.accuracy)
        train, began = study.numbered("train"), found.optimum
        optimum = study.fit(began.values, began.free, train, began.start, threshold=threshold)
        found = described(study, require_sound(study, optimum, train))
        if moved < STILL:
            break
    return found


def with_clocks(model: Model, case: Case, noise: Noise, progress: Callable[[str], None] = lambda _: None) -> Case:
    """`case` with the free clocks of its joint logs as `fit_logged` finds them under `model`; itself if none is."""
    if not any(_free(run) for run in case.runs):
        return case
    runs = fit_logged(model, case.runs, noise, progress=progress).study.runs
    return dataclasses.replace(case, runs=runs)


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
        step, covariance = _step(study, optimum, study.numbered(role), found.optimum)
        errors = np.sqrt(np.diag(covariance)) * spread(optimum)
        place = iter(range(len(step)))
        for k in study.numbered(role):
            mine = {name: next(place) for name in _free(study.runs[k])}
            if mine:
                steps, sds = ({name: float(part[j]) for name, j in mine.items()} for part in (step, errors))
                runs[k] = _moved(study.runs[k], steps, sds)
                moved = max(moved, *(abs(steps[name]) / sds[name] for name in mine))
    return tuple(runs), moved


def _free(run: Run) -> tuple[str, ...]:
    return run.log.free if run.log is not None else ()


def _moved(run: Run, step: dict[str, float], sd: dict[str, float]) -> Run:
    """`run` with its log's clock moved by `step`: what the clock shows at t, t (1 + d) + o, gets both parts of it."""
    log = run.log
    assert log is not None
    offset, drift = step.get("offset", 0.0), step.get("drift", 0.0)
    new = LogClock(
        log.offset + (1 + log.drift) * offset,
        log.drift + (1 + log.drift) * drift,
        sd.get("offset", log.offset_sd),
        sd.get("drift", log.drift_sd),
        "the fit",
        log.free,
    )
    return dataclasses.replace(run, gait=on_clock(run.gait, jnp.asarray(offset), jnp.asarray(drift)), log=new)


def _step(study: Study, optimum: Optimum, numbers: list[int], fitted: Optimum) -> tuple[np.ndarray, np.ndarray]:
    """The move (c,) of the clocks of the runs `numbers`, run by run, and its covariance for unit noise.

    Parameters that `optimum` holds where the `fitted` one has them move no clock, but their errors are in its own.
    """
    loose = [fitted.free.index(name) for name in fitted.loose]
    if optimum is not fitted:
        there = study.at(optimum.values, fitted.free, optimum.start)
        optimum = optimum._replace(linearised=study.evaluate(there, numbers))
    columns = {name: _column(study, optimum, numbers, name) for name in STEPS}
    count = sum(len(_free(study.runs[k])) for k in numbers)
    free_start = np.asarray(study.batch.free_start)
    normal = np.zeros((count + len(loose),) * 2)
    pull = np.zeros(count + len(loose))
    at = 0
    for k in numbers:
        names = _free(study.runs[k])
        own = np.stack([columns[name][k].reshape(-1) for name in names], axis=1) if names else None
        r, J = starts_removed(optimum.linearised, k, study.width, free_start)
        part = np.zeros((r.size, count + len(loose)))
        part[:, count:] = J[:, loose]
        if own is not None:
            part[:, at : at + len(names)] = _without_starts(optimum, k, study.width, free_start, own)
            at += len(names)
        normal += part.T @ part
        pull -= part.T @ r
    if fitted.free == optimum.free:
        covariance = inverse(normal)
        return (covariance @ pull)[:count], covariance[:count, :count]
    covariance = inverse(normal[:count, :count])
    by_parameters = covariance @ normal[:count, count:]
    step = covariance @ pull[:count]
    return step, covariance + by_parameters @ fitted.covariance @ by_parameters.T


def _without_starts(optimum: Optimum, run: int, width: int, free: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """`columns` (N, c) of one run less what its free start components explain."""
    J = np.asarray(optimum.linearised.jacobian[run]).reshape(len(columns), -1)[:, width:]
    q, _ = np.linalg.qr(J[:, (free[run] > 0) & ((J**2).sum(axis=0) > 0)])
    return columns - q @ (q.T @ columns)


def _column(study: Study, optimum: Optimum, numbers: list[int], name: str) -> np.ndarray:
    """The derivative (R, n, 3) of the whitened residuals by the offset [s] or the drift of the logs' clocks."""
    sides = []
    for sign in (1, -1):
        offset, drift = (sign * STEPS[name] * (name == kind) for kind in ("offset", "drift"))
        shifted = jax.vmap(lambda gait, o=offset, d=drift: on_clock(gait, o, d))(study.batch.gait)
        there = eqx.tree_at(lambda s: s.batch.gait, study, shifted)
        at = there.at(optimum.values, optimum.free, optimum.start)
        sides.append(np.asarray(there.evaluate(at, numbers).residual))
    return (sides[0] - sides[1]) / (2 * STEPS[name])
