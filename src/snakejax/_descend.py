"""Constrained descent from many starts: SLSQP of scipy, two starts at a time."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy import optimize

WORKERS = 2
FAILED = 1e6
"""What a point counts that cannot be simulated: a line search turns back from it."""


class Point(NamedTuple):
    """A problem at one point: `cost` to make small, `equal` to make zero, `room` to keep from below zero, and the
    derivatives of the three by the N unknowns.
    """

    cost: float
    cost_slope: np.ndarray
    equal: np.ndarray
    equal_slope: np.ndarray
    room: np.ndarray
    room_slope: np.ndarray


Problem = Callable[[np.ndarray], Point]


class Descended(NamedTuple):
    """Where a descent ended: `unknowns`, and how often the problem was looked at."""

    unknowns: np.ndarray
    looks: int


def descend(
    problem: Problem, start: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], most: int, told: Callable[[], None]
) -> Descended:
    """The optimum that SLSQP finds from `start` in `most` iterations; `told` is called in each of them."""
    known: dict[bytes, Point] = {}

    def at(x: np.ndarray) -> Point:
        key = x.tobytes()
        if key not in known:
            found = problem(x)
            sound = np.isfinite(found.cost) and np.isfinite(found.equal).all() and np.isfinite(found.cost_slope).all()
            if not sound:
                slopes = (np.zeros_like(found.cost_slope), np.zeros_like(found.equal_slope))
                found = found._replace(cost=FAILED, cost_slope=slopes[0], equal_slope=slopes[1])
                found = found._replace(equal=np.full_like(found.equal, FAILED))
            known[key] = found
        return known[key]

    first = at(np.asarray(start, float))
    constraints = [{"type": "ineq", "fun": lambda x: at(x).room, "jac": lambda x: at(x).room_slope}]
    if first.equal.size:
        constraints.append({"type": "eq", "fun": lambda x: at(x).equal, "jac": lambda x: at(x).equal_slope})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = optimize.minimize(
            lambda x: at(x).cost,
            np.clip(start, *bounds),
            jac=lambda x: at(x).cost_slope,
            bounds=optimize.Bounds(*bounds),
            constraints=constraints,
            method="SLSQP",
            callback=lambda _: told(),
            options={"maxiter": most, "ftol": 1e-7},
        )
    return Descended(np.clip(found.x, *bounds), len(known))


def descend_all(
    problem: Problem,
    starts: Sequence[np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    most: int,
    progress: Callable[[int, int], None],
    enough: Callable[[np.ndarray], bool] | None = None,
) -> list[Descended]:
    """`descend` from each of `starts`; where `enough` is given, from few at a time, until what one finds is enough.

    `progress` is told how many iterations are done, of how many at most.
    """
    done, found = np.zeros(len(starts), int), []

    def one(k: int) -> Descended:
        def told() -> None:
            done[k] += 1
            progress(int(done.sum()), most * len(starts))

        ended = descend(problem, starts[k], bounds, most, told)
        done[k] = most
        progress(int(done.sum()), most * len(starts))
        return ended

    wave = WORKERS if enough else len(starts)
    with ThreadPoolExecutor(WORKERS) as pool:
        for first in range(0, len(starts), wave):
            ended = list(pool.map(one, range(first, min(first + wave, len(starts)))))
            found += ended
            if enough and any(enough(one_.unknowns) for one_ in ended):
                break
    return found
