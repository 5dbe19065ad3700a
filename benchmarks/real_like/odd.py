"""One odd run among the others: another tyre, a bump of the floor, a marker that slipped."""

import dataclasses

import numpy as np
from hidden import Hidden, Run
from layout import TYRE
from strengths import STRANGE_USUAL, USUAL

PLACES = {
    "tyre": ("train-arc-1", "D"),
    "bump": ("train-arc-1", "bump.h"),
    "marker": ("train-forward-2", "marker_offset.mx"),
}
"""Which run is odd, and in which number."""
SIZES = USUAL | STRANGE_USUAL


def with_odd_run(board: Hidden, rng: np.random.Generator, what: str, errors: float) -> Hidden:
    """The board with one run whose peak of the tyre, bump or marker is off by so many standard errors of the shift."""
    which, name = PLACES[what]
    runs = list(board.runs)
    place = next(k for k, run in enumerate(runs) if run.name == which)
    fixed = bump_beside(runs[place], board.values) if what == "bump" else {}
    size = errors * standard_error(board, runs[place], fixed, name)
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


def standard_error(board: Hidden, odd: Run, fixed: dict, name: str) -> float:
    """One standard error of a shift of the number `name` in the run `odd` alone.

    The tyre of all train runs, the strong effect and the start pose of each are fitted beside it; `fixed` is what else
    the odd run has.
    """
    numbers = [*TYRE, *(number for number in board.values if board.strong and number.startswith(f"{board.strong}."))]
    normal = 0.0
    for run in board.train:
        common = [slope(run, board.values, number) for number in numbers]
        own = slope(run, board.values | fixed, name) if run is odd else np.zeros_like(common[0])
        starts = []
        for shift in np.diag([1e-5, 1e-5, 1e-5]):
            ahead, back = run.moved(run.start + shift), run.moved(run.start - shift)
            starts.append((ahead.path(board.values) - back.path(board.values)) / 2e-5)
        columns = board.noise.whiten(run.times, np.stack([own, *common, *starts], axis=2)).reshape(-1, 4 + len(common))
        some, free = columns[:, : 1 + len(common)], columns[:, 1 + len(common) :]
        some = some - free @ np.linalg.lstsq(free, some, rcond=None)[0]
        normal = normal + some.T @ some
    return float(np.linalg.inv(normal)[0, 0] ** 0.5)


def slope(run: Run, values: dict, name: str) -> np.ndarray:
    """The derivative of the poses (n, 3) of `run` with respect to the number `name`."""
    step = 1e-3 * (values[name] if name in ("B", "C", "D") else 1.0 if name == "E" else SIZES[name])
    at = values.get(name, 0.0)
    return (run.path(values | {name: at + step}) - run.path(values | {name: at - step})) / (2 * step)
