"""Multiple shooting: recorded runs cut into short windows, each with a start of its own.

Over a whole run the error of a wrong model grows until it says nothing about its cause. Over a second or two it stays
small, and what a candidate effect would change is seen beside it.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import savgol_filter

from ._least_squares import Linearised, Unknowns, domains_of, first, linearise, narrowed, widened
from ._model import Model
from ._recording import Noise, Run
from ._simulate import Accuracy
from ._skid import Coupled
from ._study import Study, dependence_of

_linearise = eqx.filter_jit(linearise)

ACCURACY = Accuracy(rtol=3e-6, atol=3e-8, max_steps=4000, derivative="forward")
"""Looser, the derivatives of stiff windows are no longer sound; a window that needs more steps is given up."""
LENGTH = 1.5
"""Length of a window [s]: long enough to see an effect, short enough that its action stays nearly linear."""
THREADS = 2
ENOUGH = 0.003
"""A round that lowers the cost by less than this share is the last."""
START_ROUNDS = 6
LOST = 2.0
"""A window whose cost rises by more than this factor has lost the track of its start."""
SMOOTHING = 0.12
"""Half width [s] of the cubic through the samples that gives the velocities at the start of a window."""
FEWEST = 8
"""Samples that a cubic goes through at least."""
EVEN = 1e-3
"""Frames are evenly spaced where they come within this share of one on time."""


def cut(run: Run, length: float) -> list[Run]:
    """`run` in windows of `length` [s]; the last one may be shorter, and joins its neighbour where it is under half."""
    times = np.asarray(run.times)
    edges = np.arange(times[0], times[-1] + 1e-9, length)
    if len(edges) > 1 and times[-1] - edges[-1] < length / 2:
        edges = edges[:-1]
    pieces = np.searchsorted(times, edges - 1e-9)
    ends = [*pieces[1:], len(times)]
    size = int(np.median(np.diff([*pieces, len(times)])))
    windows = []
    for k, (a, b) in enumerate(zip(pieces, ends, strict=True)):
        part = slice(a, min(b, a + size))
        if np.isfinite(np.asarray(run.pose)[part]).all(axis=1).sum() >= 12:
            name = f"{run.name}[{k}]"
            wander = None if run.wander is None else run.wander[part]
            windows.append(
                Run(name, run.role, run.times[part], run.pose[part], run.gait, run.payload, True, wander=wander)
            )
    return windows


def velocities(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed pose (n, 3) and its rate (n, 3) at every sample, from local cubics through what was seen."""
    t, seen = np.asarray(run.times), np.asarray(run.pose)
    present = np.flatnonzero(np.isfinite(seen).all(axis=1))
    known, poses = t[present], seen[present]
    pose, rate = np.empty_like(seen), np.empty_like(seen)
    frame = float(np.median(np.diff(known)))
    half = int(SMOOTHING / frame + 1e-6)
    steady = np.zeros(len(known), bool)
    if half >= 4 and len(known) > 2 * half:
        # Where no frame is lost the cubic is the same filter everywhere.
        uneven = np.concatenate([[0], np.cumsum(np.abs(np.diff(known) - frame) > EVEN * frame)])
        steady[half : len(known) - half] = uneven[2 * half :] == uneven[: -2 * half]
        for out, order in ((pose, 0), (rate, 1)):
            found = savgol_filter(poses, 2 * half + 1, 3, deriv=order, delta=frame, axis=0)
            out[present[steady]] = found[steady]
    reach = (half + 0.5) * frame
    for k in np.delete(np.arange(len(t)), present[steady]):
        now = t[k]
        first, middle, last = np.searchsorted(known, [now - reach, now, now + reach])
        if last - first < FEWEST:
            around = np.arange(max(0, middle - FEWEST), min(len(known), middle + FEWEST))
            near = around[np.argsort(np.abs(known[around] - now))[:FEWEST]]
        else:
            near = np.arange(first, last)
        c = np.polyfit(known[near] - now, poses[near], min(3, len(known[near]) - 1))
        pose[k], rate[k] = c[-1], c[-2]
    return pose, rate


def states(model: Model, run: Run) -> np.ndarray:
    """A guess of the state (n, 6) at every sample, as `start_moving` takes it, from the smoothed recording alone.

    Under the coupled structure theta follows from thetadot = (s + D u)/2 with s the measured yaw rate and
    u = xdot cos(theta) + ydot sin(theta), from theta = heading at the start.
    """
    pose, rate = velocities(run)
    t, heading = np.asarray(run.times), pose[:, 2]
    if not isinstance(model.skid, Coupled):
        u = rate[:, 0] * np.cos(heading) + rate[:, 1] * np.sin(heading)
        w = rate[:, 1] * np.cos(heading) - rate[:, 0] * np.sin(heading)
        return np.stack([pose[:, 0], pose[:, 1], heading, u, w, rate[:, 2]], axis=1)
    gait = model.commanded(run.gait)
    phi = np.asarray(jax.vmap(lambda s: gait.phi.at(s).angle)(jnp.asarray(t)))
    behind = gait.phi_back
    back = -phi if behind is None else np.asarray(jax.vmap(lambda s: behind.at(s).angle)(jnp.asarray(t)))
    D = (np.tan(phi) - np.tan(back)) / (2 * float(model.board.half_length))
    theta = np.empty_like(heading)
    theta[0] = heading[0]
    for k in range(len(t)):
        u = rate[k, 0] * np.cos(theta[k]) + rate[k, 1] * np.sin(theta[k])
        if k + 1 < len(t):
            theta[k + 1] = theta[k] + (t[k + 1] - t[k]) * (rate[k, 2] + D[k] * u) / 2
    u = rate[:, 0] * np.cos(theta) + rate[:, 1] * np.sin(theta)
    return np.stack([pose[:, 0], pose[:, 1], heading, u, heading - theta, rate[:, 2]], axis=1)


def linearised(
    study: Study,
    values: Mapping[str, float],
    start: np.ndarray,
    runs: Sequence[int],
    free: Sequence[str] | None = None,
) -> Linearised:
    """Residuals of `runs` and their Jacobian by the parameters `free` (default: every movable one) and the start.

    The runs are shared out among `THREADS`.
    """
    P = len(study.names)
    width = P if free is None else study.width
    directions = np.eye(P)
    if free is not None:
        directions = np.zeros((width, P))
        directions[range(len(free)), [study.names.index(name) for name in free]] = 1.0
    numbers = np.array([values[name] for name in study.names])
    point = narrowed(
        Unknowns(study.names, jnp.asarray(numbers), jnp.asarray(directions), jnp.asarray(start), study.batch.free_start)
    )
    kept = point.directions.shape[0]

    def share(part: Sequence[int]) -> Linearised:
        found = _linearise(
            study.model,
            point,
            study.batch,
            *first(part, study.batch),
            jnp.zeros(kept),
            jnp.zeros_like(study.batch.start),
            study.accuracy,
        )
        return Linearised(*(np.asarray(leaf) for leaf in found))

    with ThreadPoolExecutor(THREADS) as pool:
        shares = list(pool.map(share, [list(runs)[k::THREADS] for k in range(THREADS)]))
    return widened(Linearised(*(sum(parts[1:], parts[0]) for parts in zip(*shares, strict=True))), width - kept, kept)


class Windows(eqx.Module):
    """The train runs of a study as windows, with all movable parameters as directions of one compiled Jacobian."""

    study: Study

    @staticmethod
    def of(
        model: Model, runs: Sequence[Run], noise: Noise, names: Sequence[str], width: int, length: float
    ) -> "Windows":
        """Windows of `length` [s] over `runs`; a run from rest keeps its first window at rest.

        At most `width` of the movable `names` can settle at a time.
        """
        pieces, starts, free = [], [], []
        memories = model.memories
        for run in runs:
            guess = states(model, run)
            for window in cut(run, length):
                pieces.append(window)
                at = int(np.searchsorted(np.asarray(run.times), float(window.times[0]) - 1e-9))
                rests = at == 0 and not run.moving
                began = np.where([1, 1, 1, 0, 0, 0], guess[at], 0.0) if rests else guess[at]
                starts.append([*began, *[0.0] * memories])
                free.append([1] * 3 + [0 if rests else 1] * (3 + memories))
        study = Study.of(model, pieces, noise, names, width, ACCURACY)
        study = eqx.tree_at(
            lambda s: (s.batch.start, s.batch.free_start),
            study,
            (jnp.asarray(np.array(starts)), jnp.asarray(np.array(free, float))),
        )
        return Windows(study)

    def at(self, values: Mapping[str, float], start: np.ndarray, free: Sequence[str] | None = None) -> Linearised:
        """Residuals (W, n, 3) and the Jacobian by `free` (default: every name) and by the start state."""
        return linearised(self.study, values, start, range(len(self.study.runs)), free)

    def settle(
        self, values: Mapping[str, float], free: Sequence[str], start: np.ndarray | None = None, rounds: int = 12
    ) -> "Settled":
        """Gauss-Newton on the windows: `free` parameters of all, start state of each, eliminated window by window.

        The tyre is drawn towards what is typical, weakly, in proportion to how far off the model is. A window whose
        start does not follow a step of the parameters is settled again by itself before the step is judged.
        """
        study = self.study
        domains = domains_of(study.model, free)
        now = dict(values)
        place = np.asarray(study.batch.start) if start is None else start
        place, found = self._started(now, free, place, self.at(now, place, free), range(len(study.runs)))
        cost, damping = self._total(found, now, free), 1e-4
        for _ in range(rounds if free and np.isfinite(cost) else 0):
            pull, strength = study.typical(now, free)
            weight = dependence_of(cost / max(found.residual.size, 1))
            prior = (pull[: len(free)], weight * strength[: len(free)] ** 2)
            step, moves = _newton(found, len(free), study.width, np.asarray(study.batch.free_start), damping, prior)
            trial = dict(now)
            for name, domain, move in zip(free, domains, step, strict=True):
                move = float(np.clip(move, -1.0, 1.0)) if domain.multiplicative else float(move)
                trial[name] = float(np.clip(domain.moved(now[name], move), domain.low, domain.high))
            there = place + moves
            tried = self.at(trial, there, free)
            lost = np.flatnonzero(~(_each(tried) < LOST * _each(found) + tried.residual[0].size))
            there, tried = self._started(trial, free, there, tried, lost)
            better = self._total(tried, trial, free)
            if not better < cost * (1 + 1e-9):
                damping *= 10
                if damping > 1e2:
                    break
                continue
            gain, cost = cost - better, better
            now, place, found, damping = trial, there, tried, max(damping / 10, 1e-9)
            if gain < max(0.1, ENOUGH * cost):
                break
        return Settled(now, place, found, _cost(found))

    def _started(self, values, free, place, found: Linearised, which) -> tuple[np.ndarray, Linearised]:
        """The windows numbered `which` with starts settled one by one, the parameters fixed."""
        which, place = np.asarray(which, int), place.copy()
        residual, jacobian = found.residual.copy(), found.jacobian.copy()
        free_start = np.asarray(self.study.batch.free_start)
        width, damping = self.study.width, np.full(len(place), 1e-4)
        for _ in range(START_ROUNDS):
            if not which.size:
                break
            there, promise = place.copy(), np.zeros(len(place))
            for k in which:
                r, S = residual[k].reshape(-1), jacobian[k].reshape(residual[k].size, -1)[:, width:]
                open_ = (free_start[k] > 0) & ((S**2).sum(axis=0) > 0)
                if np.isfinite(r).all() and open_.any():
                    S = S[:, open_]
                    move = np.linalg.lstsq(*_braked(S, damping[k], -r), rcond=1e-12)[0]
                    there[k, open_] += move
                    promise[k] = (r @ r) - ((r + S @ move) ** 2).sum()
            which = which[promise[which] > ENOUGH * (residual[which] ** 2).sum(axis=(1, 2)) + 0.1]
            if not which.size:
                break
            tried = linearised(self.study, values, there, which, free)
            gone = (residual**2).sum(axis=(1, 2))
            fell = np.array([k for k in which if (tried.residual[k] ** 2).sum() < gone[k]], int)
            place[fell], residual[fell], jacobian[fell] = there[fell], tried.residual[fell], tried.jacobian[fell]
            damping[which] *= 10
            damping[fell] /= 100
        return place, Linearised(residual, jacobian)

    def _total(self, found: Linearised, values: Mapping[str, float], free: Sequence[str]) -> float:
        """Cost of the residuals and of the distance from what is typical, which weighs less the nearer the noise is."""
        pull, strength = self.study.typical(values, free)
        far = float(((pull * strength) ** 2).sum())
        cost = _cost(found)
        return cost + far * dependence_of(cost / max(found.residual.size, 1)) if np.isfinite(cost) else np.inf


def _each(found: Linearised) -> np.ndarray:
    """Cost of each window."""
    return np.asarray((found.residual**2).sum(axis=(1, 2)))


def _cost(found: Linearised) -> float:
    cost = float((found.residual**2).sum())
    return cost if np.isfinite(cost) else np.inf


def _newton(found: Linearised, count: int, width: int, free_start: np.ndarray, damping: float, prior):
    """Steps (K,) of the first `count` parameters and (W, S) of the start states; `prior` is (mean, 1 / variance)."""
    parts = []
    normal, right = np.zeros((count, count)), np.zeros(count)
    for k, (r, J) in enumerate(zip(found.residual, found.jacobian, strict=True)):
        r, J = r.reshape(-1), J.reshape(-1, J.shape[-1])
        G, open_ = J[:, :count], free_start[k] > 0
        open_ &= (J[:, width:] ** 2).sum(axis=0) > 0
        S = J[:, width:][:, open_]
        S, G, r = _braked(S, damping, G, r)
        q, t = np.linalg.qr(S)
        G_ = G - q @ (q.T @ G)
        normal += G_.T @ G_
        right -= G_.T @ (r - q @ (q.T @ r))
        parts.append((q, t, r, G, open_))
    pull, precision = prior
    size = np.diag(normal)
    braked = normal + np.diag(damping * size + precision)
    step = _solved(braked, right + precision * pull)
    moves = np.zeros_like(free_start)
    for k, (q, t, r, G, open_) in enumerate(parts):
        moves[k, open_] = np.linalg.lstsq(t, -(q.T @ (r + G @ step)), rcond=1e-12)[0]
    return step, moves


def _braked(S: np.ndarray, damping: float, *others: np.ndarray) -> tuple[np.ndarray, ...]:
    """`S` with the damping of its columns as rows of their own, and `others` with as many rows of zeros."""
    brake = np.diag(np.sqrt(damping * (S**2).sum(axis=0)))
    return np.concatenate([S, brake]), *(np.concatenate([o, np.zeros((len(brake), *o.shape[1:]))]) for o in others)


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution of scaled normal equations; a parameter that moves nothing stays where it is."""
    if not right.size or not (np.isfinite(normal).all() and np.isfinite(right).all()):
        return np.zeros_like(right)
    size = np.sqrt(np.diag(normal))
    safe = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(normal / np.outer(safe, safe), right / safe, rcond=1e-14)[0] / safe


class Settled(NamedTuple):
    """Windows at the optimum of some parameters: their values, each window's start, what is left, and its square."""

    values: dict[str, float]
    start: np.ndarray
    found: Linearised
    cost: float
