"""Constrained minimisation from many starts by SLSQP (Kraft 1988) of scipy, two starts at a time."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy import optimize

from snakejax.core.parallel import WORKERS
from snakejax.core.progress import Phase, Progress, ProgressEvent

FAILED = 1e6
"""Cost and residual of a point whose simulation fails, so large that the line search rejects the point."""


class ProblemValue(NamedTuple):
    """Values of an optimisation problem at one point, with derivatives by the N unknowns.

    `cost` is minimised, with `cost_slope` (N,); equality constraints `equal` (k,) = 0, with `equal_slope` (k, N);
    inequality constraints (slacks) `slack` (m,) >= 0, with `slack_slope` (m, N).
    """

    cost: float
    cost_slope: np.ndarray
    equal: np.ndarray
    equal_slope: np.ndarray
    slack: np.ndarray
    slack_slope: np.ndarray


ConstrainedProblem = Callable[[np.ndarray], ProblemValue]


class Minimum(NamedTuple):
    """Result of a minimisation: the `unknowns` (N,), and `evaluations`, the number of evaluations of the problem."""

    unknowns: np.ndarray
    evaluations: int


def minimise_slsqp(
    problem: ConstrainedProblem,
    start: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    most: int,
    after_iteration: Callable[[], None],
) -> Minimum:
    """Minimise by SLSQP (Kraft 1988) from `start` (N,) in at most `most` iterations; each iteration calls
    `after_iteration`."""
    known: dict[bytes, ProblemValue] = {}

    def evaluate(x: np.ndarray) -> ProblemValue:
        key = x.tobytes()
        if key not in known:
            result = problem(x)
            sound = (
                np.isfinite(result.cost) and np.isfinite(result.equal).all() and np.isfinite(result.cost_slope).all()
            )
            if not sound:
                slopes = (np.zeros_like(result.cost_slope), np.zeros_like(result.equal_slope))
                result = result._replace(cost=FAILED, cost_slope=slopes[0], equal_slope=slopes[1])
                result = result._replace(equal=np.full_like(result.equal, FAILED))
            known[key] = result
        return known[key]

    first = evaluate(np.asarray(start, float))
    constraints = [{"type": "ineq", "fun": lambda x: evaluate(x).slack, "jac": lambda x: evaluate(x).slack_slope}]
    if first.equal.size:
        constraints.append({"type": "eq", "fun": lambda x: evaluate(x).equal, "jac": lambda x: evaluate(x).equal_slope})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        result = optimize.minimize(
            lambda x: evaluate(x).cost,
            np.clip(start, *bounds),
            jac=lambda x: evaluate(x).cost_slope,
            bounds=optimize.Bounds(*bounds),
            constraints=constraints,
            method="SLSQP",
            callback=lambda _: after_iteration(),
            options={"maxiter": most, "ftol": 1e-7},
        )
    return Minimum(np.clip(result.x, *bounds), len(known))


def minimise_from_starts(
    problem: ConstrainedProblem,
    starts: Sequence[np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    most: int,
    progress: Progress,
    enough: Callable[[np.ndarray], bool] | None = None,
) -> list[Minimum]:
    """`minimise_slsqp` from each of `starts`; with `enough`, from a few at a time until one result satisfies it.

    `progress` counts iterations of their largest number.
    """
    done, minima = np.zeros(len(starts), int), []

    def descend(k: int) -> Minimum:
        def count(iterations: int) -> None:
            done[k] = iterations
            progress(ProgressEvent(Phase.OPTIMISATION, done=int(done.sum()), total=most * len(starts)))

        minimum = minimise_slsqp(problem, starts[k], bounds, most, lambda: count(done[k] + 1))
        count(most)
        return minimum

    wave = WORKERS if enough else len(starts)
    with ThreadPoolExecutor(WORKERS) as pool:
        for first in range(0, len(starts), wave):
            minima_of_wave = list(pool.map(descend, range(first, min(first + wave, len(starts)))))
            minima += minima_of_wave
            if enough and any(enough(minimum.unknowns) for minimum in minima_of_wave):
                break
    return minima
