"""Levenberg-Marquardt over many short runs: their start states are eliminated run by run.

With R runs of S start components and K parameters one step costs O(R (K + S)^2 n), where that of all variables at once
would cost O((K + R S)^3).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

MANY = 40
"""Above so many runs their start states are eliminated."""
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e3
FAR, RELATIVE = 1.5, 1e-5
"""Above the first misfit, far from the noise, it stops where the expected decrease is below the second, relative to
chi^2, as a fit of few runs does."""

BODY = 6
"""A start state has the pose and velocities of the body, and then the memories of effects."""
MEMORY_STEP = 1.0
"""Step [rad] of a memory that costs as much as one sample: a memory is a slip angle, at most pi / 2."""
LITTLE = 1e-4
"""A run whose start alone is fitted stops where the expected decrease is below this, relative to its chi^2."""

Arrays = tuple[np.ndarray, np.ndarray]


class Ending(NamedTuple):
    """When it stops, as in `StoppingRule`."""

    enough: float
    crawl: float
    samples: int
    most: int


class Solved(NamedTuple):
    """The steps `z` (K,) of the parameters and `starts` (R, S) of the start states, the number of steps, and whether
    the expected decrease is below the rule."""

    z: np.ndarray
    starts: np.ndarray
    taken: int
    settled: bool


def eliminated_step(
    robust: Arrays, width: int, free_start: np.ndarray, damping: float, prior: Arrays
) -> tuple[np.ndarray, np.ndarray, float]:
    """One damped Gauss-Newton step: (K,) of the parameters, (R, S) of the starts, and the decrease it promises.

    `robust`: residual (R, m) and Jacobian (R, m, K + S); `prior`: (mean, 1 / variance) of the step, each (K,). The
    start states are eliminated by the QR decomposition of their columns (Golub and Pereyra 1973). Where a derivative is
    not finite the step is zero and promises NaN.
    """
    residual, jacobian = robust
    mean, precision = prior
    normal, right = np.zeros((width, width)), np.zeros(width)
    parts = []
    for k, (r, J) in enumerate(zip(residual, jacobian, strict=True)):
        movable, S, S_damped = _damped(r, J[:, width:], free_start[k], damping)
        below = len(S_damped) - len(S)
        G, r = (np.concatenate([part, np.zeros((below, *part.shape[1:]))]) for part in (J[:, :width], r))
        basis, triangle = np.linalg.qr(S_damped)
        inside = basis.T @ G
        rest = basis.T @ r
        normal += G.T @ G - inside.T @ inside
        right -= G.T @ r - inside.T @ rest
        parts.append((movable, triangle, inside, rest))
    if not (np.isfinite(normal).all() and np.isfinite(right).all()):
        return np.zeros(width), np.zeros_like(free_start), np.nan
    size = np.maximum(np.diag(normal), 0.0)
    damped = normal + np.diag(damping * size + precision)
    scale = np.where(np.diag(damped) > 0, np.sqrt(np.abs(np.diag(damped))), 1.0)
    wanted = right + precision * mean
    step = np.linalg.lstsq(damped / np.outer(scale, scale), wanted / scale, rcond=1e-14)[0] / scale
    moves, promise = np.zeros_like(free_start), float(step @ wanted)
    for k, (movable, triangle, inside, rest) in enumerate(parts):
        moves[k, movable] = np.linalg.lstsq(triangle, -(rest + inside @ step), rcond=1e-12)[0]
        promise += float(rest @ rest)
    return step, moves, promise


def solve_many(
    linearise: Callable[[np.ndarray, np.ndarray], Arrays],
    robust: Callable[[Arrays], Arrays],
    free_start: np.ndarray,
    prior: Arrays,
    ending: Ending,
) -> Solved:
    """Minimise chi^2 from steps zero.

    **Arguments:** `linearise(z, starts)`: residual (R, n, 3) and Jacobian (R, n, 3, K + S) at these steps; `robust`:
    what a loss makes of them; `free_start` (R, S); `prior`: (mean, 1 / standard deviation) of z, each (K,).
    """
    pull, strength = prior
    width = len(pull)
    z, starts = np.zeros(width), np.zeros(free_start.shape)
    now = _flat(robust(linearise(z, starts)))
    damping, taken, settled, rejected = FIRST_DAMPING, 0, False, 0

    def cost(flat: Arrays, z: np.ndarray) -> float:
        total = float((flat[0] ** 2).sum() + ((strength * (z - pull)) ** 2).sum())
        return total if np.isfinite(total) else np.inf

    chi2 = cost(now, z)
    while taken < ending.most and rejected < 8 and np.isfinite(chi2):
        step, moves, promise = eliminated_step(now, width, free_start, damping, (pull - z, strength**2))
        far = chi2 > FAR * ending.samples
        if promise < max(ending.enough, RELATIVE * chi2 if far else 0.0):
            settled = True
            break
        taken += 1
        trial_z, trial_starts = z + np.clip(step, -1.0, 1.0), starts + moves
        trial = _flat(robust(linearise(trial_z, trial_starts)))
        trial_chi2 = cost(trial, trial_z)
        if not trial_chi2 < chi2:
            damping, rejected = min(damping * 10, MOST_DAMPING), rejected + 1
            continue
        gain, chi2 = chi2 - trial_chi2, trial_chi2
        z, starts, now, rejected = trial_z, trial_starts, trial, 0
        damping = max(damping / 10, LEAST_DAMPING)
        if far and gain < ending.crawl * chi2:
            settled = True
            break
    return Solved(z, starts, taken, settled or rejected >= 8)


def solve_starts(
    linearise: Callable[[np.ndarray, np.ndarray], Arrays],
    robust: Callable[[Arrays], Arrays],
    free_start: np.ndarray,
    width: int,
    ending: Ending,
) -> Solved:
    """`solve_many` where no parameter moves: each run has a damping of its own, and stops by itself.

    `linearise(starts, numbers)` gives the residuals and Jacobians of the runs with these numbers alone.
    """
    z, starts = np.zeros(width), np.zeros(free_start.shape)
    residual, jacobian = _flat(robust(linearise(starts, np.arange(len(starts)))))
    damping, taken, settled = np.full(len(starts), FIRST_DAMPING), 0, False
    while taken < ending.most:
        moves, promise = np.zeros_like(starts), np.zeros(len(starts))
        cost = (residual**2).sum(axis=1)
        for k, (r, J) in enumerate(zip(residual, jacobian, strict=True)):
            moves[k], promise[k] = start_step(r, J[:, width:], free_start[k], damping[k])
        moving = promise > np.maximum(ending.enough / len(starts), LITTLE * cost)
        moving &= damping < MOST_DAMPING
        if not moving.any():
            settled = True
            break
        taken += 1
        numbers = np.flatnonzero(moving)
        trial, slopes = _flat(robust(linearise(starts + np.where(moving[:, None], moves, 0.0), numbers)))
        lower = (trial**2).sum(axis=1) < cost[numbers]
        better = numbers[lower]
        starts[better] += moves[better]
        residual[better], jacobian[better] = trial[lower], slopes[lower]
        damping[numbers] *= 10
        damping[better] = np.maximum(damping[better] / 100, LEAST_DAMPING)
    return Solved(z, starts, taken, settled)


def start_step(r: np.ndarray, S: np.ndarray, free_start: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """One damped Gauss-Newton step (S,) of the start of a run with the residual `r` (m,) and the columns `S` (m, S),
    and the decrease of chi^2 that the linear model promises; zero where nothing can move or is not finite."""
    move = np.zeros(len(free_start))
    if not (np.isfinite(r).all() and np.isfinite(S).all()):
        return move, 0.0
    movable, S, S_damped = _damped(r, S, free_start, damping)
    if not movable.any():
        return move, 0.0
    right = np.concatenate([-r, np.zeros(len(S_damped) - len(S))])
    move[movable] = np.linalg.lstsq(S_damped, right, rcond=1e-12)[0]
    return move, float(r @ r - ((r + S @ move[movable]) ** 2).sum())


def _damped(
    r: np.ndarray, S: np.ndarray, free_start: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The start components of a run that can move, the columns `S` of these, and the same over the rows of damping.

    A memory is damped by the mean square of the residuals `r` beside that: one that changes little would else move by
    thousands of radians for the sake of an error of the model.
    """
    movable = (free_start > 0) & ((S**2).sum(axis=0) > 0)
    is_memory = np.arange(len(movable)) >= BODY
    S = S[:, movable]
    least = np.where(is_memory[movable], np.mean(r**2) / MEMORY_STEP**2, 0.0)
    return movable, S, np.concatenate([S, np.diag(np.sqrt(damping * (S**2).sum(axis=0) + least))])


def _flat(parts: Arrays) -> Arrays:
    residual, jacobian = (np.array(part) for part in parts)
    R = residual.shape[0]
    return residual.reshape(R, -1), jacobian.reshape(R, -1, jacobian.shape[-1])
