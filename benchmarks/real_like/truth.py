"""What the best that is possible leaves: the true model with its true constants, its values refitted.

And what is left to one who knows every effect and the form of the strange law, but not more of the vehicle than
case.toml says: constants and all numbers of a law are estimated too.
"""

import dataclasses
import math

import numpy as np
from hidden import Hidden, Run
from layout import NEUTRAL, SHAPES
from scipy.optimize import least_squares
from strengths import STRANGE_USUAL, USUAL

DETECTABLE = 3.92
"""Standard errors of an effect that is found with power 0.8 at 5 % among 24 candidates: z(1 - 0.05/48) + z(0.8)."""

TYRE_SPREAD = {"B": 4.0, "C": 0.3, "D": 0.5, "E": 0.5}
"""How far a tyre may be from the truth where the runs do not tell: of D as a share of itself, else as it is."""


STATED_SPREAD = {"m": 0.03, "L": 0.005, "I": 0.07, "Jr": 0.07}
"""How far a constant may be from what case.toml says, as a share, where that says no more: as the program takes it."""

SHAPE_SPREAD = {
    "bump": {"bump.x": 1.0, "bump.y": 1.0, "bump.width": 0.15},
    "spring": {"spring.x": 1.0, "spring.y": 1.0},
} | {name.split(".")[0]: {name: value} for name, value in SHAPES.items()}
"""How far the numbers of a strange law, but for its size, may be from the truth where the runs do not tell: places by
1 m, others by as much as they are."""


class Problem:
    """The train runs of a board as least squares in tyre, hidden effects (and the strange one's size) and start poses;
    where these are `informed`, in the constants of the vehicle and all numbers of the strange law as well.

    Where the runs tell nothing, the tyre is known as in `TYRE_SPREAD` and an effect to its usual size: without that,
    two effects that do the same would run away together.
    """

    def __init__(self, board: Hidden, informed: bool = False):
        """Everything begins at the truth."""
        self.board = board
        usual = USUAL | STRANGE_USUAL
        self.spread = {n: s * (board.values["D"] if n == "D" else 1.0) for n, s in TYRE_SPREAD.items()}
        self.spread |= {n: max(usual[n], abs(board.values[n])) for n in usual if board.values.get(n)}
        self.steps = {n: 0.02 * s if n in TYRE_SPREAD else 0.02 * abs(board.values[n]) for n, s in self.spread.items()}
        centre = {n: board.values[n] for n in self.spread}
        if informed:
            centre |= {n: board.stated[n] for n in STATED_SPREAD}
            self.spread |= {n: s * board.stated[n] for n, s in STATED_SPREAD.items()}
            self.steps |= {n: 0.02 * s * board.stated[n] for n, s in STATED_SPREAD.items()}
            shape = SHAPE_SPREAD.get(board.strange or "", {})
            centre |= {n: (NEUTRAL | board.values)[n] for n in shape}
            self.spread |= shape
            self.steps |= {n: 0.01 * s for n, s in shape.items()}
        self.centre = np.array([centre[n] for n in self.spread])
        numbers = [float((NEUTRAL | board.values)[n]) for n in self.spread]
        self.truth = np.concatenate([numbers, *(run.start for run in board.train)])

    def values(self, unknowns: np.ndarray) -> dict[str, float]:
        """All numbers of the board."""
        return self.board.values | dict(zip(self.spread, unknowns, strict=False))

    def path(self, unknowns: np.ndarray, k: int) -> np.ndarray:
        """Whitened poses (3n,) of train run `k`."""
        run, first = self.board.train[k], len(self.spread) + 3 * k
        return self.board.noise.whiten(
            run.times, run.moved(unknowns[first : first + 3]).path(self.values(unknowns))
        ).ravel()

    def slopes(self, unknowns: np.ndarray) -> np.ndarray:
        """Derivatives of all whitened poses and, below, of what is known of each number, by central differences."""
        count, blocks = len(self.spread), []
        steps = np.concatenate([list(self.steps.values()), np.full(len(unknowns) - count, 1e-5)])
        for k, run in enumerate(self.board.train):
            block = np.zeros((3 * len(run.times), len(unknowns)))
            for j in [*range(count), *range(count + 3 * k, count + 3 * k + 3)]:
                away = np.zeros_like(unknowns)
                away[j] = steps[j]
                block[:, j] = (self.path(unknowns + away, k) - self.path(unknowns - away, k)) / (2 * steps[j])
            blocks.append(block)
        known = np.eye(count, len(unknowns)) / np.array(list(self.spread.values()))[:, None]
        return np.concatenate([*blocks, known])

    def errors(self, unknowns: np.ndarray, seen: list[np.ndarray]) -> np.ndarray:
        """Whitened errors of all train runs, and how far each number is from what is known of it, over its spread."""
        off = (unknowns[: len(self.spread)] - self.centre) / list(self.spread.values())
        return np.concatenate([*(self.path(unknowns, k) - pose for k, pose in enumerate(seen)), off])


def standard_errors(problem: Problem, slopes: np.ndarray) -> dict[str, float]:
    """One standard error of each number, all others being free."""
    scale = 1 / np.linalg.norm(slopes, axis=0)
    inverse = np.linalg.pinv((slopes * scale).T @ (slopes * scale), hermitian=True)
    return dict(zip(problem.spread, (np.sqrt(np.diag(inverse)) * scale).tolist(), strict=False))


def clearness(board: Hidden, effect: str) -> float:
    """How many standard errors `effect` has, the largest of its parameters, with everything true free beside it."""
    problem = Problem(board)
    spread = standard_errors(problem, problem.slopes(problem.truth))
    return max(abs(board.values[n]) / s for n, s in spread.items() if n.startswith(f"{effect}."))


def left_out(run: Run, values: dict, pose: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Errors (n, 3) of a held-out run, of which the start pose alone is estimated, by samples alike and independent."""
    start, shifts = run.start, np.diag([1e-5, 1e-5, 1e-5])
    for _ in range(3):
        error = (run.moved(start).path(values) - pose) / scale
        sides = [(run.moved(start + s).path(values), run.moved(start - s).path(values)) for s in shifts]
        slopes = np.stack([(ahead - back) / scale / 2e-5 for ahead, back in sides], axis=2).reshape(-1, 3)
        start = start - np.linalg.lstsq(slopes, error.ravel(), rcond=None)[0]
    return run.moved(start).path(values) - pose


def refit(board: Hidden, poses: dict[str, np.ndarray]) -> dict:
    """Errors of the true model on the held-out runs, refitted to the train runs, and the standard error of each value.

    `known`: the same errors without the strange law, which is the best that effects of a library can do; `informed`:
    the same errors with the constants of the vehicle, and all numbers of the strange law, estimated too.
    """
    best = refitted(board, poses) | {"informed": refitted(board, poses, informed=True)["heldout"]}
    if not board.strange:
        return best | {"known": best["heldout"]}
    plain = dataclasses.replace(board, values={n: v * (n not in STRANGE_USUAL) for n, v in board.values.items()})
    return best | {"known": refitted(plain, poses)["heldout"]}


def refitted(board: Hidden, poses: dict[str, np.ndarray], informed: bool = False) -> dict:
    """The model of `board` refitted to the train runs, see `Problem`.

    Held-out errors are roots of mean squares as in the JSON of the program: position_m of both axes together.
    """
    problem = Problem(board, informed)
    seen = [board.noise.whiten(run.times, poses[run.name]).ravel() for run in board.train]
    slopes = problem.slopes(problem.truth)

    def errors(unknowns: np.ndarray) -> np.ndarray:
        """Of numbers with which the board cannot be integrated: very many."""
        try:
            return problem.errors(unknowns, seen)
        except ArithmeticError:
            return np.full(len(slopes), 1e3)

    scale = 1 / np.linalg.norm(slopes, axis=0)
    if informed:  # The place of a law and the constants move far along what the runs do not tell.
        found = least_squares(errors, problem.truth, problem.slopes, x_scale=scale, ftol=1e-7, max_nfev=20)
    else:  # From the truth it is a short way, along which the slopes hardly change.
        found = least_squares(errors, problem.truth, lambda _: slopes, x_scale=scale, ftol=1e-5, max_nfev=10)
    values = problem.values(found.x)
    left = [left_out(run, values, poses[run.name], board.noise.scale) for run in board.heldout]
    square = np.mean(np.concatenate(left) ** 2, axis=0) if left else None
    return {
        "heldout": None
        if square is None
        else {"position_m": math.sqrt(square[0] + square[1]), "heading_rad": math.sqrt(square[2])},
        "train_misfit": float(np.mean(found.fun[: -len(problem.spread)] ** 2)),
        "estimate": dict(zip(problem.spread, found.x.tolist(), strict=False)),
        "sd": standard_errors(problem, slopes),
    }
