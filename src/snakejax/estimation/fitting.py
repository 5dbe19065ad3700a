"""Fit: parameters from recorded runs, with statistics and held-out scores."""

from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run

from .fit_record import Fit
from .fit_workspace import FitWorkspace, fit_workspace
from .initial_model import default_free, select_parameters
from .initialisation import (
    best_of,
    continue_over_horizons,
    continue_to_convergence,
    fit_by_windows,
    fit_short,
    inconsistent_derivative,
    is_window,
    require_consistent_derivative,
    require_near,
    with_true_errors,
)
from .problem import Problem, Solution

SHARPENED = 2
"""Largest number of refits with tighter tolerances if derivatives are not those of the simulation."""
LACKING = 50.0
"""Above this misfit of whole runs, or without convergence, the fit is repeated from a fit by windows."""


def fit(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Progress = no_progress,
) -> Fit:
    """Fit the `free` parameters of `model` and the start state of each run to the train runs; score the held-out runs.

    Minimises sum_k ((measured - modelled) / sd)^2 over all present samples of x, y and heading, by Levenberg-Marquardt
    (Moré 1978), from several starts over the first seconds and then over whole runs.

    **Arguments:** `free`: names or wildcards as in `select_parameters`; `threshold`: that of Huber's loss (Huber 1964)
    [standard deviations].
    **Raises:** `InputError` for unknown names or if there is no train run; `FitError` if the fit fails.
    """
    return fitted_workspace(model, runs, noise, free, threshold=threshold, progress=progress).result()


def fitted_workspace(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Progress = no_progress,
) -> FitWorkspace:
    """`fit`, with what a computation that goes on from it needs; raises as `fit`."""
    names = default_free(model) if free is None else select_parameters(model, free)
    problem = Problem.of(model, runs, noise, names, max(len(names), 1))
    return fit_problem(problem, names, threshold=threshold, progress=progress)


def fit_problem(
    problem: Problem,
    free: Sequence[str],
    values: Mapping[str, float] | None = None,
    *,
    threshold: float = np.inf,
    progress: Progress = no_progress,
) -> FitWorkspace:
    """`fit` of a compiled `problem`, from `values` (default: those of its model); raises as `fit`."""
    train = problem.run_indices("train")
    if not train:
        raise InputError("There is no train run to fit", "runs", 'give at least one run role = "train"')
    if all(is_window(problem.runs[k]) for k in train):
        return fit_workspace(problem, fit_short(problem, values, free, train, threshold, progress))
    approach = continue_over_horizons(problem, problem.values() if values is None else values, free, train, progress)
    require_near(problem, approach, train)
    progress(ProgressEvent(Phase.WHOLE_RUNS))
    solution = problem.fit(approach.values, free, train, approach.start, threshold=threshold)
    if free and not (solution.misfit < LACKING and solution.converged):
        solution = best_of(solution, fit_by_windows(problem, free, train, threshold, progress))
    if solution.misfit < LACKING:
        solution = continue_to_convergence(problem, solution, train, threshold)
    for sharpened in range(SHARPENED + 1):
        if not require_consistent_derivative(problem, solution, train).misfit < LACKING:
            break
        inconsistent = inconsistent_derivative(problem, solution, train)
        if not inconsistent:
            solution = solution._replace(rough=())
            break
        if sharpened == SHARPENED:
            solution = with_true_errors(problem, solution, train)
            break
        progress(ProgressEvent(Phase.TIGHTER_TOLERANCES))
        problem = problem.with_tighter_tolerances()
        solution = problem.fit(solution.values, free, train, solution.start, threshold=threshold)
    return fit_workspace(problem, require_consistent_derivative(problem, solution, train))


def fit_result(problem: Problem, solution: Solution) -> Fit:
    """The `Fit` of `solution`: statistics, scores of the train runs and of the held-out runs."""
    return fit_workspace(problem, solution).result()
