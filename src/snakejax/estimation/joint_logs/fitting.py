"""Joint estimation of model parameters and the clocks of joint logs.

The motion alone gives the clock offset between log and cameras to some hundredths of a second; the model gives it to
milliseconds. Near a fit the residuals depend almost linearly on the offset o and the drift d of each log. One
Gauss-Newton step over parameters, start states and clocks moves the clocks, and the fit is repeated. The standard
errors are those of parameters and clocks together. The covariance due to noise in the logs (`wander`) is simulated
under a first fit, and the fit is repeated with whitened residuals.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import FitError
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.model import Model
from snakejax.recording.run import Case, Noise, Run

from ..fit_record import Fit
from ..fit_workspace import FitWorkspace, fit_workspace
from ..fitting import fitted_workspace
from ..initial_model import default_free, select_parameters
from ..initialisation import require_consistent_derivative
from ..linearisation import project_out_starts
from ..problem import Problem, Solution, covariance_of
from ..uncertainty import spread
from .clocks import STEPS, STILL, clock_sensitivities, clock_sensitivity, free_clocks, moved_clock
from .log_noise import is_noisy, log_noise_root
from .window_clocks import window_clocks

FAR_OFF = 50.0
"""Above this misfit a model is too inaccurate to simulate the effect of log noise."""
ROUNDS = 8
"""Largest number of alternating steps of clocks and fit."""


def fit_logged(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Progress = no_progress,
) -> Fit:
    """`fit` together with the free clocks of joint logs and, for noisy logs, the covariance of the residuals.

    The runs of the returned fit contain the clocks with standard errors, and their `wander`. The standard errors of the
    parameters include the uncertainty of the clocks and the noise of the logs. **Raises:** as `fit`.
    """
    if clocked := any(free_clocks(run) for run in runs):
        names = default_free(model) if free is None else select_parameters(model, free)
        runs = window_clocks(model, runs, noise, names, progress)
    workspace = fitted_workspace(model, runs, noise, free, threshold=threshold, progress=progress)
    runs_with_noise = with_log_noise(workspace, progress)
    if runs_with_noise is not None:
        workspace = _refitted(workspace, runs_with_noise, threshold)
    if clocked:
        workspace = with_aligned_logs(workspace, threshold, progress)
    return with_clock_errors(workspace, progress).result()


def with_aligned_logs(workspace: FitWorkspace, threshold: float, progress: Progress) -> FitWorkspace:
    """`workspace` refitted until the clocks converge. **Raises:** `FitError` if the runs do not determine them."""
    for _ in range(ROUNDS):
        progress(ProgressEvent(Phase.LOG_CLOCKS))
        runs, moved = align_logs(workspace)
        workspace = _refitted(workspace, runs, threshold)
        if moved < STILL:
            break
    return workspace


def _refitted(workspace: FitWorkspace, runs: Sequence[Run], threshold: float) -> FitWorkspace:
    """The fit of changed `runs`, started from the optimum of `workspace`."""
    before, began = workspace.problem, workspace.solution
    problem = Problem.of(before.model, runs, before.noise, before.names, before.width, before.accuracy)
    train = problem.run_indices("train")
    solution = problem.fit(began.values, began.free, train, began.start, threshold=threshold)
    return fit_workspace(problem, require_consistent_derivative(problem, solution, train))


def with_log_noise(workspace: FitWorkspace, progress: Progress = no_progress) -> tuple[Run, ...] | None:
    """The runs of `workspace` with the `wander` of their logs; None without noise of logs, or above `FAR_OFF`."""
    if not (any(is_noisy(run.gait) for run in workspace.problem.runs) and workspace.solution.misfit < FAR_OFF):
        return None
    progress(ProgressEvent(Phase.LOG_NOISE))
    try:
        return log_noise_root(workspace.fitted.model, workspace.problem.runs, workspace.fitted.starts)
    except FitError:
        return None


def with_estimated_logs(model: Model, case: Case, noise: Noise, progress: Progress = no_progress) -> Case:
    """`case` with the free clocks of its joint logs, from short windows under `model`, and the `wander` of noisy logs.

    It is unchanged if its logs have neither free clocks nor noise.
    """
    if any(free_clocks(run) for run in case.runs):
        runs = window_clocks(model, case.runs, noise, default_free(model), progress)
        case = dataclasses.replace(case, runs=runs)
    if any(is_noisy(run.gait) for run in case.runs):
        try:
            runs = with_log_noise(fitted_workspace(model, case.runs, noise, progress=progress), progress)
        except FitError:
            runs = None
        case = case if runs is None else dataclasses.replace(case, runs=runs)
    return case


def align_logs(workspace: FitWorkspace) -> tuple[tuple[Run, ...], float]:
    """The runs of `workspace` with free clocks moved by a Gauss-Newton step, and the largest step in standard errors.

    The clocks of held-out runs are estimated under the fitted parameters, as their start states are.
    """
    problem = workspace.problem
    runs, moved = list(problem.runs), 0.0
    for role, solution in (("train", workspace.solution), ("heldout", workspace.heldout)):
        numbers = [k for k in problem.run_indices(role) if (log := problem.runs[k].log) is not None and log.free]
        if solution is None or not numbers:
            continue
        joint = _linear(problem, solution, problem.run_indices(role), workspace.solution)
        step, errors = joint.step(solution.linearised.residual), np.sqrt(np.diag(joint.covariance)) * spread(solution)
        sds_of = clock_sensitivity(problem.runs, joint.numbers, errors)
        for k, steps in clock_sensitivity(problem.runs, joint.numbers, step).items():
            runs[k] = moved_clock(problem.runs[k], steps, sds_of[k], "the fit")
            moved = max(moved, *(abs(steps[name]) / sd for name, sd in sds_of[k].items()))
    return tuple(runs), moved


def with_clock_errors(workspace: FitWorkspace, progress: Progress = no_progress) -> FitWorkspace:
    """`workspace` with standard errors that include the free clocks of the joint logs; unchanged if there are none."""
    problem, solution = workspace.problem, workspace.solution
    if not any(free_clocks(run) for run in problem.runs) or solution.rough:
        return workspace
    progress(ProgressEvent(Phase.LOG_CLOCK_ERRORS))
    joint = _linear(problem, solution, problem.run_indices("train"), solution)
    runs = list(problem.runs)
    wider = solution._replace(covariance=joint.covariance[joint.clock_count :, joint.clock_count :])
    _set_errors(runs, joint, np.sqrt(np.diag(joint.covariance)) * spread(solution))
    if (heldout := workspace.heldout) is not None:
        heldout_joint = _linear(problem, heldout, problem.run_indices("heldout"), wider)
        _set_errors(runs, heldout_joint, np.sqrt(np.diag(heldout_joint.covariance)) * spread(heldout))
    return fit_workspace(dataclasses.replace(problem, runs=tuple(runs)), wider)


def _set_errors(runs: list[Run], joint: "_Linear", errors: np.ndarray) -> None:
    for k, sds in clock_sensitivity(runs, joint.numbers, errors).items():
        log = runs[k].log
        assert log is not None
        named = {f"{name}_sd": sd for name, sd in sds.items()}
        runs[k] = dataclasses.replace(runs[k], log=log._replace(**named))


class _Linear(NamedTuple):
    """Linear model of the runs `numbers` near a fit: `clock_count` clocks, run by run, then the interior parameters.

    `columns`: for each run the derivative (N, c + K) of its residuals, with the start states projected out;
    `covariance` (m, m) of the steps for unit noise; `moving`: number of leading columns that are estimated. For
    held-out runs, whose parameters are fixed, these are the clocks alone.
    """

    numbers: list[int]
    clock_count: int
    columns: list[Float[np.ndarray, "N c"]]
    moving: int
    inverse: Float[np.ndarray, "m m"]
    covariance: Float[np.ndarray, "m m"]

    def step(self, residual: Float[np.ndarray, "R n 3"]) -> Float[np.ndarray, " m"]:
        """The Gauss-Newton step (m,) for `residual`."""
        parts = zip(self.numbers, self.columns, strict=True)
        return -self.inverse @ sum(part[:, : self.moving].T @ np.asarray(residual[k]).reshape(-1) for k, part in parts)


def _linear(problem: Problem, solution: Solution, numbers: list[int], fitted: Solution) -> _Linear:
    """Linear model of the runs `numbers` near `solution`, with the interior parameters of the `fitted` solution.

    If `solution` has other free parameters than `fitted` (held-out runs), only the clocks move; their covariance
    includes that of the fitted parameters.
    """
    loose = [fitted.free.index(name) for name in fitted.loose]
    parameters_fixed = fitted.free != solution.free
    if parameters_fixed:
        point = problem.at(solution.values, fitted.free, solution.start)
        solution = solution._replace(linearised=problem.evaluate(point, numbers))
    count = sum(len(free_clocks(problem.runs[k])) for k in numbers)

    def residual(moved: Problem) -> np.ndarray:
        at = moved.at(solution.values, solution.free, solution.start)
        return np.asarray(moved.evaluate(at, numbers).residual)

    slopes = {name: clock_sensitivities(problem, name, residual) for name in STEPS} if count else {}
    free_start = np.asarray(problem.batch.free_start)
    columns, at = [], 0
    for k in numbers:
        names = free_clocks(problem.runs[k])
        clock_columns = np.stack([slopes[name][k].reshape(-1) for name in names], axis=1) if names else None
        r, J = project_out_starts(solution.linearised, k, problem.width, free_start, clock_columns)
        part = np.zeros((r.size, count + len(loose)))
        part[:, count:] = J[:, loose]
        part[:, at : at + len(names)] = J[:, problem.width :]
        at += len(names)
        columns.append(part)
    if not all(np.isfinite(part).all() for part in columns):
        raise FitError("The clocks of the joint logs cannot be estimated: the simulation fails if they move by 4 ms.")
    normal = sum((part.T @ part for part in columns), np.zeros((count + len(loose),) * 2))
    if not parameters_fixed:
        covariance = covariance_of(normal)
        return _Linear(numbers, count, columns, count + len(loose), covariance, covariance)
    alone = covariance_of(normal[:count, :count])
    by_parameters = alone @ normal[:count, count:]
    covariance = alone + by_parameters @ fitted.covariance @ by_parameters.T
    return _Linear(numbers, count, columns, count, alone, covariance)
