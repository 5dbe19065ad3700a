"""Initialisation of a fit: over the first seconds of the runs or over short windows, from several starts."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.errors import FitError
from snakejax.core.parallel import in_threads
from snakejax.core.parameter import short_name
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.recording.run import Run

from .linearisation import domains_of, project_out_starts
from .many_runs import MANY
from .multiple_shooting import LENGTH, Windows, WindowSolution
from .problem import Problem, Solution

NORM, LONGEST = 3.0, 0.01
"""Step for the check of derivatives: the norm of its change of all residuals [standard deviations], and the largest
step."""
WEAKER = 0.25
"""Factor on the tyre force for the second start of a fit by windows."""
HORIZONS = (1.5, 4.0)
"""Horizons [s] over which a fit is initialised before it uses whole runs: model errors are still small there."""
GOOD_START = 1.1
"""Misfit over the first horizon below which no other start is tried: noise alone leaves 1."""
FAR, NOWHERE = 50.0, 0.8
"""The initialisation has failed if the misfit over the horizons is above the first and the residuals are larger than
this fraction of the motion.
"""
SHORT, EARLY = 2.5, 0.5
"""Longest window [s] that is fitted at once, and how much of it [s] is fitted first."""
ROUNDS, WORTHWHILE = 8, 0.5
"""Largest number of restarts of a fit that has not converged, and the least decrease of chi^2 for another restart."""


def continue_over_horizons(
    problem: Problem,
    values: Mapping[str, float],
    free: Sequence[str],
    runs: Sequence[int],
    progress: Progress = no_progress,
) -> Solution:
    """Fit the first `HORIZONS` seconds of the runs in turn, each from the last; several starts if the first fails.

    **Raises:** `FitError` if a simulation fails at the start, or if a free parameter has no influence.
    """

    def first(candidate: Mapping[str, float]) -> Solution:
        return problem.fit(candidate, free, runs, until=HORIZONS[0], enough=2.0, weak_prior=True, most=10)

    progress(ProgressEvent(Phase.FIRST_SECONDS))
    require_sensitive(problem, values, free, runs)
    best = first(values)
    if not best.misfit < GOOD_START:
        others = other_starts(problem, values, free)
        costs = [_cost(problem, other, runs, HORIZONS[0]) for other in others]
        for k in np.argsort(costs)[:2]:
            best = min(best, first(others[k]), key=problem.penalised_deviance)
    for until in HORIZONS[1:]:
        progress(ProgressEvent(Phase.LONGER_HORIZON, f"first {until:g} seconds"))
        best = problem.fit(best.values, free, runs, best.start, until=until, enough=1.0, weak_prior=True, most=10)
    return best


MANY_WINDOWS = 3.0
"""Huber's threshold [standard deviations] of a fit of more than `MANY` windows."""


def is_short(run: Run) -> bool:
    """Whether a run is short and begins in motion."""
    return run.moving and float(run.times[-1] - run.times[0]) <= SHORT


def is_window(run: Run) -> bool:
    """Whether a run is a short window of a longer recording."""
    return is_short(run) and run.cut_from is not None


def fit_short(
    problem: Problem,
    values: Mapping[str, float] | None,
    free: Sequence[str],
    runs: Sequence[int],
    threshold: float,
    progress: Progress,
) -> Solution:
    """The better of two fits of windows: from one of their beginnings, where few false optima are, and from `values`.

    Of many windows the loss is Huber's, with a `threshold` of `MANY_WINDOWS` unless another one is given: some windows
    in which the model spins would rule the sum of squares.

    **Raises:** `FitError` if a simulation fails at the start, or if a free parameter has no influence.
    """
    values = problem.values() if values is None else values
    threshold = MANY_WINDOWS if len(runs) > MANY and not np.isfinite(threshold) else threshold
    progress(ProgressEvent(Phase.FIRST_SECONDS))
    require_sensitive(problem, values, free, runs)
    early = problem.fit(values, free, runs, until=EARLY, crawl=1e-3, weak_prior=True, most=15, threshold=threshold)
    progress(ProgressEvent(Phase.WHOLE_RUNS))
    starts = ((early.values, early.start), (values, None))
    return best_of(*(problem.fit(v, free, runs, start, crawl=3e-4, threshold=threshold) for v, start in starts))


def other_starts(problem: Problem, values: Mapping[str, float], free: Sequence[str]) -> list[dict[str, float]]:
    """Starts around `values`: multiplicative tyre parameters without a typical value, times 1/3 and 3 in all
    combinations, or times 1/9, 1/3, 3, 9 for a single one."""
    domains = dict(zip(free, domains_of(problem.model, free), strict=True))
    wide = [n for n in free if n.startswith("tyre.") and domains[n].multiplicative and domains[n].typical is None]
    # Of tyres by axle all are moved alike.
    if len({n.rsplit(".", 1)[-1] for n in wide}) < len(wide):
        last = {n: n.rsplit(".", 1)[-1] for n in wide}
        alike = sorted(set(last.values()))
        combinations = itertools.product((1 / 3, 1.0, 3.0), repeat=len(alike))
        by_name = [dict(zip(alike, combination, strict=True)) for combination in combinations]
        return [
            {**values, **{n: values[n] * one[last[n]] for n in wide}}
            for one in by_name
            if any(f != 1.0 for f in one.values())
        ]
    factors = itertools.product((1 / 3, 1.0, 3.0) if len(wide) > 1 else (1 / 9, 1 / 3, 3.0, 9.0), repeat=len(wide))
    return [
        {**values, **{n: values[n] * f for n, f in zip(wide, combination, strict=True)}}
        for combination in factors
        if any(f != 1.0 for f in combination)
    ]


def _cost(problem: Problem, values: Mapping[str, float], runs: Sequence[int], until: float) -> float:
    residual = problem.evaluate(problem.at(values, ()), runs, until).residual[list(runs)]
    cost = float((residual**2).sum())
    return cost if np.isfinite(cost) else np.inf


def fit_by_windows(
    problem: Problem, free: Sequence[str], runs: Sequence[int], threshold: float, progress: Progress
) -> Solution:
    """Fit short windows by multiple shooting, then the whole runs from there.

    Over whole runs the error of an incomplete model hides the influence of its parameters. `threshold`: Huber's loss.
    """
    progress(ProgressEvent(Phase.WINDOWS))
    recorded = [problem.runs[k] for k in runs]
    windows = Windows.of(problem.model, recorded, problem.noise, problem.names, problem.width, LENGTH)
    solution = fit_windows(windows, problem.values(), free)
    progress(ProgressEvent(Phase.WHOLE_RUNS))
    return problem.fit(solution.values, free, runs, threshold=threshold)


def fit_windows(windows: Windows, values: Mapping[str, float], free: Sequence[str]) -> WindowSolution:
    """The better of two fits of `windows`: from `values`, and from the tyre force times `WEAKER` if it is free."""
    force = [n for n in free if n.startswith("tyre.") and n.rsplit(".", 1)[-1] in ("D", "k_s")]
    weaker = {n: v * WEAKER if n in force else v for n, v in values.items()}
    return min(in_threads(lambda start: windows.settle(start, free), (values, weaker)), key=lambda s: s.cost)


def continue_to_convergence(
    problem: Problem, solution: Solution, runs: Sequence[int], threshold: float = np.inf, goal: float = np.inf
) -> Solution:
    """Restart the fit from `solution` until it converges or a restart lowers chi^2 by at most `WORTHWHILE`.

    Along a narrow curved valley each step is short; a fit that stops there has standard errors that are too small.
    `goal`: a fit whose misfit would still be above it after `ROUNDS` restarts like the last one is of no use, and ends.
    """
    for left in reversed(range(ROUNDS)):
        if solution.converged:
            break
        further = problem.fit(solution.values, solution.free, runs, solution.start, threshold=threshold)
        improvement = solution.samples * (solution.misfit - further.misfit)
        solution = best_of(solution, further)
        if not improvement > max(WORTHWHILE, solution.samples * (solution.misfit - goal) / max(left, 1)):
            break
    return solution


def has_converged(problem: Problem, solution: Solution, runs: Sequence[int]) -> bool:
    """Whether the fit has converged, or its undamped step g^T C g would lower chi^2 by less than 1.

    g is the gradient of chi^2 / 2 and C the covariance: below 1 no value would move by a standard error.
    """
    if solution.converged:
        return True
    if not np.isfinite(solution.covariance).all():
        return False
    columns = [solution.free.index(name) for name in solution.loose]
    free_start = np.asarray(problem.batch.free_start)
    parts = [project_out_starts(solution.linearised, k, problem.width, free_start) for k in runs]
    slope = sum((J[:, columns].T @ r for r, J in parts), np.zeros(len(columns)))
    return bool(slope @ solution.covariance @ slope < 1.0)


def best_of(*optima: Solution) -> Solution:
    """The solution of least misfit; a misfit that is not finite counts as infinite."""
    return min(optima, key=lambda one: one.misfit if np.isfinite(one.misfit) else np.inf)


def require_sensitive(problem: Problem, values: Mapping[str, float], free: Sequence[str], runs: Sequence[int]) -> None:
    """Check the start of a fit.

    **Raises:** `FitError` if a simulation fails at the start values, or if a free parameter changes no residual.
    """
    linearised = problem.evaluate(problem.at(values, free), runs, HORIZONS[0])
    for k in runs:
        if not np.isfinite(linearised.residual[k]).all():
            raise FitError(
                f"The simulation of run `{problem.runs[k].name}` fails in its first {HORIZONS[0]:g} s "
                "at the start values: check the board and the start."
            )
    sizes = np.sqrt((linearised.jacobian[list(runs)][..., : len(free)] ** 2).sum(axis=(0, 1, 2)))
    if len(free) > 1 and not (sizes > 1e-9).any():
        raise FitError(
            f"None of {', '.join(free)} moves anything in these runs: check that the gait moves the board, and its "
            "inertias."
        )
    for name, size in zip(free, sizes, strict=True):
        if not size > 1e-9:
            raise FitError(
                f"Parameter `{short_name(name)}` moves nothing in these runs, so it cannot be fitted: leave it fixed."
            )


def require_near(problem: Problem, solution: Solution, runs: Sequence[int]) -> None:
    """Check the `solution` of `continue_over_horizons`.

    **Raises:** `FitError` if the model is about as far from the recordings as a board that stands still, by mean square
    and by median (the median is insensitive to a few outliers).
    """
    if not solution.misfit > FAR:
        return
    early = np.asarray(problem.batch.times) <= HORIZONS[-1]
    weight, pose = (np.asarray(part) for part in (problem.batch.weight, problem.batch.pose))
    residuals, displacements = [], []
    for k in runs:
        present = (weight[k] > 0) & early[k][:, None]
        residuals.append(np.abs(solution.linearised.residual[k][present]))
        for c in np.flatnonzero(present.any(axis=0)):
            track = (pose[k] * weight[k])[present[:, c], c]
            displacements.append(np.abs(track - np.median(track)))
    rest_error, model_error = np.concatenate(displacements), np.concatenate(residuals)
    if (model_error**2).mean() > NOWHERE * (rest_error**2).mean() and np.median(model_error) > NOWHERE * np.median(
        rest_error
    ):
        raise FitError(
            f"Over the first {HORIZONS[-1]:g} s no parameters bring the model nearer to the recordings than a board "
            "that stands still: check the mass, lengths and inertias of the board, that the gait is in rad and rad/s, "
            "and the axes; `snakejax check` compares them with the motion."
        )


def inconsistent_derivative(problem: Problem, solution: Solution, runs: Sequence[int], norm: float = NORM) -> list[str]:
    """The parameters whose derivative is not that of the simulation.

    At the stability limit of the step size a stiff simulation is accurate, but its derivatives can grow without bound,
    and standard errors would be far too small. The check takes a step that changes the residuals by the norm `norm`
    according to the Jacobian; the simulated change must agree within `norm` / 2. At first all parameters take their
    steps at once: each of them is checked alone only where the change of all does not agree within `norm` / 4.
    """
    domains = dict(zip(solution.free, domains_of(problem.model, solution.free), strict=True))
    residual = solution.linearised.residual[list(runs)]
    moved, expected = {}, {}
    for name in solution.loose:
        domain, value = domains[name], solution.values[name]
        column = solution.linearised.jacobian[list(runs)][..., solution.free.index(name)]
        step = norm / max(float(np.sqrt((column**2).sum())), norm / LONGEST)
        step = step if domain.low <= domain.moved(value, step) <= domain.high else -step
        moved[name], expected[name] = domain.moved(value, step), step * column

    def error(names: Sequence[str]) -> float:
        displaced = problem.at({**solution.values, **{n: moved[n] for n in names}}, (), solution.start)
        with np.errstate(over="ignore", invalid="ignore"):
            change = problem.evaluate(displaced, runs).residual[list(runs)] - residual
            return float(np.sqrt(((change - sum(expected[n] for n in names)) ** 2).sum()))

    if not solution.loose or error(solution.loose) < norm / 4:
        return []
    errors = in_threads(lambda name: error([name]), solution.loose)
    return [name for name, one in zip(solution.loose, errors, strict=True) if not one < norm / 2]


def with_true_errors(problem: Problem, solution: Solution, runs: Sequence[int]) -> Solution:
    """`solution` with infinite variances if a derivative is not that of the simulation (`inconsistent_derivative`).

    One wrong column of the Jacobian makes the standard errors of all parameters wrong.
    """
    if solution.rough is not None:
        return solution
    rough = tuple(inconsistent_derivative(problem, solution, runs, NORM * float(np.sqrt(max(1.0, solution.misfit)))))
    covariance = np.diag(np.full(len(solution.loose), np.inf)) if rough else solution.covariance
    return solution._replace(covariance=covariance, rough=rough)


def require_consistent_derivative(problem: Problem, solution: Solution, runs: Sequence[int]) -> Solution:
    """`solution`, unchanged. **Raises:** `FitError` with the run whose residuals are not finite."""
    for k in runs:
        if not np.isfinite(solution.linearised.residual[k]).all():
            raise FitError(f"The simulation of run `{problem.runs[k].name}` diverges: fix a parameter or the start.")
    return solution
