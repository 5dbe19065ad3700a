"""Clocks of joint logs from short windows, over which a missing effect has little influence.

Over whole runs a missing effect biases the clocks. Over windows with their own start states the residuals depend almost
linearly on clocks and parameters, so Gauss-Newton steps over both estimate the clocks.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from snakejax.core.parameter import parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run

from ..linearisation import project_out_starts
from ..multiple_shooting import LENGTH, Windows, WindowSolution
from ..problem import Problem, covariance_of, dependence_of
from .clocks import STILL, clock_sensitivities, clock_sensitivity, free_clocks, moved_clock

ROUNDS = 8
"""Largest number of Gauss-Newton steps of the clocks."""
FARTHEST = {"offset": 0.05, "drift": 5e-3}
"""Largest step of a clock, [s] and [-]: the range over which the residuals are nearly linear in it."""


def window_clocks(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str],
    progress: Progress = no_progress,
) -> tuple[Run, ...]:
    """`runs` with their free clocks and standard errors estimated over windows, together with the parameters `free`.

    Held-out runs are estimated separately. Under the ideal structure, whose tyre has no force, the runs are unchanged.
    """
    moved = list(runs)
    if not model.constraint.tyre_acts:
        return tuple(moved)
    known = parameters(model)
    values = {name: float(known[name].value) for name in free}
    for role in ("train", "heldout"):
        numbers = [k for k, run in enumerate(runs) if run.role == role]
        if not any(free_clocks(runs[k]) for k in numbers):
            continue
        start = None
        for _ in range(ROUNDS):
            progress(ProgressEvent(Phase.LOG_CLOCKS))
            windows = Windows.of(model, [moved[k] for k in numbers], noise, free, max(len(free), 1), LENGTH)
            settled = windows.settle(values, free, start)
            values, start = settled.values, settled.start
            step, precise, sd = _step(windows, settled, moved, numbers, free)
            sds = clock_sensitivity(moved, numbers, sd)
            for k, steps in clock_sensitivity(moved, numbers, step).items():
                moved[k] = moved_clock(moved[k], steps, sds[k], "short windows")
            if (np.abs(step) < STILL * precise).all():
                break
    return tuple(moved)


def _step(
    windows: Windows, settled: WindowSolution, runs: Sequence[Run], numbers: Sequence[int], free: Sequence[str]
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """The Gauss-Newton step (C,) of the clocks of the runs `numbers`, with standard errors for noise alone and for the
    actual residuals.
    """
    problem, linearised = windows.problem, settled.linearised
    clocks = [(runs[k].name, name) for k in numbers for name in free_clocks(runs[k])]

    def residual(moved: Problem) -> np.ndarray:
        return np.asarray(Windows(moved).at(settled.values, settled.start, ()).residual)

    slopes = {name: clock_sensitivities(problem, name, residual) for name in {name for _, name in clocks}}
    count, P, free_start = len(clocks), len(free), np.asarray(problem.batch.free_start)
    normal, right = np.zeros((count + P,) * 2), np.zeros(count + P)
    for w, window in enumerate(problem.runs):
        clock_columns = np.zeros((linearised.residual[w].size, count))
        for place, (run, name) in enumerate(clocks):
            if window.recorded_as == run:
                clock_columns[:, place] = slopes[name][w].reshape(-1)
        if not all(np.isfinite(part).all() for part in (linearised.residual[w], linearised.jacobian[w], clock_columns)):
            continue
        r, J = project_out_starts(linearised, w, problem.width, free_start, clock_columns)
        columns = np.concatenate([J[:, problem.width :], J[:, :P]], axis=1)
        normal += columns.T @ columns
        right -= columns.T @ r
    pull, strength = problem.typical(settled.values, free)
    misfit = settled.cost / max(linearised.residual.size, 1)
    precision = dependence_of(misfit) * strength[:P] ** 2
    normal[count:, count:] += np.diag(precision)
    right[count:] += precision * pull[:P]
    covariance = covariance_of(normal)
    most = np.array([FARTHEST[name] for _, name in clocks])
    step = np.clip((covariance @ right)[:count], -most, most)
    sd = np.sqrt(np.diag(covariance)[:count])
    return step, sd, sd * np.sqrt(max(misfit, 1.0) * dependence_of(misfit))
