"""One odd run among the others: another tyre, a bump of the floor, a marker that slipped."""

import dataclasses

import numpy as np
from hidden import Hidden, Run
from noise import Noise
from strengths import STRANGE_USUAL, USUAL

PLACES = {
    "tyre": ("train-arc-1", "D"),
    "bump": ("train-arc-1", "bump.h"),
    "marker": ("train-forward-2", "marker_offset.mx"),
}
"""Which run is odd, and in which number."""


def with_odd_run(board: Hidden, rng: np.random.Generator, what: str, errors: float) -> Hidden:
    """The board with one run whose peak of the tyre, bump or marker is off by so many standard errors of that run."""
    which, name = PLACES[what]
    runs = list(board.runs)
    place = next(k for k, run in enumerate(runs) if run.name == which)
    fixed = bump_beside(runs[place], board.values) if what == "bump" else {}
    size = errors * standard_error(runs[place], board.values | fixed, name, board.noise)
    sign = 1.0 if what == "bump" else rng.choice([-1.0, 1.0])
    runs[place] = dataclasses.replace(runs[place], odd=fixed | {name: float(board.values.get(name, 0.0) + sign * size)})
    return dataclasses.replace(board, runs=tuple(runs))


def bump_beside(run: Run, values: dict) -> dict:
    """Place and width of a bump that the board of `values` passes on one side of, half-way through `run`."""
    path, size = run.path(values), values["L"] / 0.25
    x, y, heading = path[len(path) // 2]
    away = 0.15 * size
    return {
        "bump.x": float(x - away * np.sin(heading)),
        "bump.y": float(y + away * np.cos(heading)),
        "bump.width": 0.15 * size,
    }


def standard_error(run: Run, values: dict, name: str, noise: Noise) -> float:
    """What one run tells of the number `name`, its start pose being free too and all else known: one standard error."""
    step = 1e-3 * (values["D"] if name == "D" else (USUAL | STRANGE_USUAL)[name])
    at = values.get(name, 0.0)
    columns = [(run.path(values | {name: at + step}) - run.path(values | {name: at - step})) / (2 * step)]
    for shift in np.diag([1e-5, 1e-5, 1e-5]):
        columns.append((run.moved(run.start + shift).path(values) - run.moved(run.start - shift).path(values)) / 2e-5)
    slopes = noise.whiten(run.times, np.stack(columns, axis=2)).reshape(-1, 4)
    return float(np.sqrt(np.linalg.inv(slopes.T @ slopes)[0, 0]))
