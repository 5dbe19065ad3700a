"""Multiple shooting (Bock 1981): recorded runs are cut into short windows, each with its own start state.

Over a whole run the error of an incomplete model grows until it no longer shows its cause. Over 1 to 2 s it stays
small, and the change that a candidate effect makes is of comparable size.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.local_polynomials import local_cubics
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import Accuracy

from .block_linearisation import linearise_runs
from .fit_journal import kept_fit
from .linearisation import Linearised, domains_of
from .many_runs import FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING, eliminated_step, start_step
from .problem import Problem, dependence_of

ACCURACY = Accuracy(rtol=3e-6, atol=3e-8, max_steps=4000, derivative="forward")
"""With larger tolerances the derivatives of stiff windows are inaccurate; a window that needs more steps fails."""
LENGTH = 1.5
"""Length of a window [s]: long enough for an effect to show, short enough for residuals nearly linear in it."""
ENOUGH = 0.003
"""The iteration ends with a step that lowers the cost by less than this fraction."""
LEAST_DECREASE = 0.1
"""A decrease of chi^2 that is too small to go on for."""
GROWTH = 10.0
"""Factor on the damping after a step that did not lower the cost; twice as large after each further one (Nielsen
1999)."""
PATIENCE = 5
"""After so many steps the linear model has come near enough to say what can be reached."""
START_ROUNDS = 6
"""Largest number of steps of the start states alone."""
START_DAMPING = 1e-4
"""The damping of the first of them."""
LOST = 2.0
"""The start state of a window is solved again if a step of the parameters raises its cost by more than this factor."""
SMOOTHING = 0.12
"""Half width [s] of the local cubics (Savitzky and Golay 1964) that give the velocities at the start of a window."""


def cut_windows(run: Run, length: float) -> list[Run]:
    """Cut `run` into windows of `length` [s]; a rest shorter than half a window is not used.

    A window needs at least 12 complete samples.
    """
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
            window = dataclasses.replace(
                run,
                name=f"{run.name}[{k}]",
                times=run.times[part],
                pose=run.pose[part],
                moving=True,
                log=None,
                wander=None if run.wander is None else run.wander[part],
                cut_from=run.name,
            )
            windows.append(window)
    return windows


def initial_states(model: Model, run: Run) -> np.ndarray:
    """First guess of the state (n, 6) at every sample, for `initial_state`, from the smoothed recording alone."""
    times = np.asarray(run.times)
    pose, rate = local_cubics(times, np.asarray(run.pose), SMOOTHING)
    return model.constraint.observed(times, pose, rate, model.board, lambda: model.commanded(run.gait))


class Windows(eqx.Module):
    """Windows of recorded runs, with all parameters of the problem as directions of one compiled Jacobian."""

    problem: Problem

    @staticmethod
    def of(
        model: Model, runs: Sequence[Run], noise: Noise, names: Sequence[str], width: int, length: float
    ) -> "Windows":
        """Windows of `length` [s] over `runs`; the first window of a run from rest starts at rest.

        At most `width` of the parameters `names` can be free at a time.
        """
        pieces, starts, free = [], [], []
        memories = model.memories
        for run in runs:
            guess = initial_states(model, run)
            for window in cut_windows(run, length):
                pieces.append(window)
                first_sample = int(np.searchsorted(np.asarray(run.times), float(window.times[0]) - 1e-9))
                at_rest = first_sample == 0 and not run.moving
                start = np.where([1, 1, 1, 0, 0, 0], guess[first_sample], 0.0) if at_rest else guess[first_sample]
                starts.append([*start, *[0.0] * memories])
                free.append([1] * 3 + [0 if at_rest else 1] * (3 + memories))
        problem = Problem.of(model, pieces, noise, names, width, ACCURACY)
        problem = eqx.tree_at(
            lambda s: (s.batch.start, s.batch.free_start),
            problem,
            (jnp.asarray(np.array(starts)), jnp.asarray(np.array(free, float))),
        )
        return Windows(problem)

    def at(self, values: Mapping[str, float], start: np.ndarray, free: Sequence[str] | None = None) -> Linearised:
        """Residuals (W, n, 3) of the windows; their Jacobian by `free` (default: all names) and the start states."""
        return linearise_runs(self.problem, values, start, range(len(self.problem.runs)), free)

    @kept_fit
    def settle(
        self,
        values: Mapping[str, float],
        free: Sequence[str],
        start: np.ndarray | None = None,
        rounds: int = 12,
        useful: float = np.inf,
        linearised: Linearised | None = None,
    ) -> "WindowSolution":
        """Minimise chi^2 over the windows by damped Gauss-Newton steps; start states are eliminated window by window.

        The variables are the `free` parameters, common to all windows, and one start state for each window. A weak
        prior, whose weight falls with the misfit, pulls the tyre towards typical values. Before a step is accepted or
        rejected, the start state of every window whose cost rose by more than `LOST` is solved again.

        **Arguments:** `values`, `start` (W, S): where the iteration begins; `rounds`: largest number of steps;
        `useful`: the largest chi^2 of use; after `PATIENCE` steps it ends where the linear model expects more.
        `linearised`: the windows there, if they are known and their start states have settled.
        """
        problem, current = self.problem, dict(values)
        free_start = np.asarray(problem.batch.free_start)
        starts = np.asarray(problem.batch.start) if start is None else start
        if linearised is None:
            everywhere = range(len(problem.runs))
            starts, linearised = self._started(current, free, starts, self.at(current, starts, free), everywhere)
        cost, damping, growth = self._total(linearised, current, free), FIRST_DAMPING, GROWTH
        for k in range(rounds if free and np.isfinite(cost) else 0):
            pull, strength = problem.typical(current, free)
            weight = dependence_of(cost / max(linearised.residual.size, 1))
            prior = (pull[: len(free)], weight * strength[: len(free)] ** 2)
            flat = _flat(linearised, free, problem.width)
            step, moves, promise = eliminated_step(flat, len(free), free_start, damping, prior)
            hopeless = k >= PATIENCE and cost - promise > useful
            if damping <= FIRST_DAMPING and (hopeless or promise < max(LEAST_DECREASE, ENOUGH * cost)):
                break
            trial = self._moved(current, free, step)
            trial_starts, trial_linearised = self._recovered(trial, free, starts + moves, linearised, cost)
            trial_cost = self._total(trial_linearised, trial, free)
            if not trial_cost < cost * (1 + 1e-9):
                damping, growth = damping * growth, 2 * growth
                if damping > MOST_DAMPING:
                    break
                continue
            decrease, cost = cost - trial_cost, trial_cost
            current, starts, linearised = trial, trial_starts, trial_linearised
            damping, growth = max(damping * float(damping_factor(decrease / promise)), LEAST_DAMPING), GROWTH
            if decrease < max(LEAST_DECREASE, ENOUGH * cost):
                break
        return WindowSolution(current, starts, linearised, _cost(linearised))

    def _moved(self, values: Mapping[str, float], free: Sequence[str], step: np.ndarray) -> dict[str, float]:
        """`values` after the `step` (K,) of the parameters `free`, inside their domains."""
        moved = dict(values)
        for name, domain, move in zip(free, domains_of(self.problem.model, free), step, strict=True):
            move = float(np.clip(move, -1.0, 1.0)) if domain.multiplicative else float(move)
            moved[name] = domain.moved_inside(values[name], move)
        return moved

    def _recovered(self, values, free, starts, before: Linearised, cost: float) -> tuple[np.ndarray, Linearised]:
        """Start states (W, S) and residuals at `values`, with the start states of those windows solved again whose cost
        is above `LOST` times that `before`; not where the others alone cost more than the `cost` of all before."""
        linearised = self.at(values, starts, free)
        each = _each(linearised)
        lost = ~(each < LOST * _each(before) + linearised.residual[0].size)
        if not each[~lost].sum() < cost:
            return starts, linearised
        return self._started(values, free, starts, linearised, np.flatnonzero(lost))

    def _started(self, values, free, starts, linearised: Linearised, windows) -> tuple[np.ndarray, Linearised]:
        """Start states (W, S) and residuals after the start states of `windows` are fitted, the parameters fixed."""
        windows, starts = np.asarray(windows, int), starts.copy()
        residual, jacobian = linearised.residual.copy(), linearised.jacobian.copy()
        free_start = np.asarray(self.problem.batch.free_start)
        width, damping = self.problem.width, np.full(len(starts), START_DAMPING)
        for _ in range(START_ROUNDS):
            if not windows.size:
                break
            trial_starts, promise = starts.copy(), np.zeros(len(starts))
            for k in windows:
                r, S = residual[k].reshape(-1), jacobian[k].reshape(residual[k].size, -1)[:, width:]
                move, promise[k] = start_step(r, S, free_start[k], damping[k])
                trial_starts[k] += move
            cost = (residual**2).sum(axis=(1, 2))
            windows = windows[promise[windows] > ENOUGH * cost[windows] + LEAST_DECREASE]
            if not windows.size:
                break
            trial_linearised = linearise_runs(self.problem, values, trial_starts, windows, free)
            decrease = cost - (trial_linearised.residual**2).sum(axis=(1, 2))
            improved = windows[decrease[windows] > 0]
            starts[improved], residual[improved], jacobian[improved] = (
                trial_starts[improved],
                trial_linearised.residual[improved],
                trial_linearised.jacobian[improved],
            )
            damping[np.setdiff1d(windows, improved)] *= GROWTH
            damping[improved] *= damping_factor(decrease[improved] / promise[improved])
        return starts, Linearised(residual, jacobian)

    def _total(self, linearised: Linearised, values: Mapping[str, float], free: Sequence[str]) -> float:
        """chi^2 plus the weak prior, whose weight falls as the misfit approaches that of noise."""
        pull, strength = self.problem.typical(values, free)
        penalty = float(((pull * strength) ** 2).sum())
        cost = _cost(linearised)
        return cost + penalty * dependence_of(cost / max(linearised.residual.size, 1)) if np.isfinite(cost) else np.inf


def damping_factor(ratio: Float[np.ndarray, "..."] | float) -> np.ndarray:
    """The factor on the damping after a step that lowered chi^2 by `ratio` r times what the linear model promised.

    max(1 / `GROWTH`, 1 - (2 r - 1)^3) (Nielsen 1999): where the linear model is poor the damping stays, or the next
    step would be in vain.
    """
    return np.maximum(1 / GROWTH, 1 - (2 * np.asarray(ratio) - 1) ** 3)


def _each(linearised: Linearised) -> np.ndarray:
    """chi^2 (W,) of each window."""
    return np.asarray((linearised.residual**2).sum(axis=(1, 2)))


def _cost(linearised: Linearised) -> float:
    cost = float((linearised.residual**2).sum())
    return cost if np.isfinite(cost) else np.inf


def _flat(linearised: Linearised, free: Sequence[str], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (W, m) and Jacobian (W, m, K + S) by the K `free` parameters, of `width` columns, and the starts."""
    residual, jacobian = (np.asarray(part) for part in linearised)
    used = [*range(len(free)), *range(width, jacobian.shape[-1])]
    return residual.reshape(len(residual), -1), jacobian.reshape(len(residual), -1, jacobian.shape[-1])[..., used]


class WindowSolution(NamedTuple):
    """Optimum of a fit by windows: parameter `values`, `start` (W, S), residuals and Jacobian, and chi^2 (`cost`)."""

    values: dict[str, float]
    start: np.ndarray
    linearised: Linearised
    cost: float
