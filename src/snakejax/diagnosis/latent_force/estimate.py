"""The free force: what drives the board beside its model, estimated on short windows without a word about its cause.

The board is driven by a force f(t), piecewise linear between knots. With r the whitened residuals of the windows and H
minus their derivative by the knots,

    r = H f + (tyre, start states) + noise        f ~ Gaussian process, its size and duration by maximum likelihood

gives f with its error.
"""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.parallel import in_threads
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.model import Model
from snakejax.estimation.batch import Batch
from snakejax.estimation.fit_journal import kept_fit
from snakejax.estimation.linearisation import Variables, domains_of
from snakejax.estimation.problem import DEPENDENT, Problem

from ..selection.candidates import CandidateSet
from .force_sensitivity import ForceLinearisation, MotionSamples, linearise_in_force
from .gaussian_process import FIRST, Normal, Posterior, Prior, Window, fitted_prior, observable_components, posterior
from .piecewise_force import SPACING

ROUNDS = 14
REACH = np.array([0.05, 0.05, 0.2, 0.1, 0.1, 0.5])
"""How far one step moves a start state: m, rad, m/s, rad/s."""
MEMORY = 0.1
"""How far one step moves the memory of a tyre [rad]."""
CHUNK = 8
"""Windows that one call of the compiled program takes: it serves recordings of any length, on every core."""
ENOUGH = 1e-3
"""The estimate ends where a step lowers the total by less than this share of it."""


class ForcePoint(NamedTuple):
    """Parameter values (P,), start states (W, S), and the knots of each run (Kr, 3)."""

    values: np.ndarray
    start: np.ndarray
    force: tuple[np.ndarray, ...]


class ForceEstimator(eqx.Module):
    """The windows of a candidate set under a free force, compiled once."""

    model: Model
    names: tuple[str, ...] = eqx.field(static=True)
    batch: Batch
    owner: np.ndarray
    """Which run (W,) each window belongs to, by its place in `runs`."""
    runs: tuple[str, ...] = eqx.field(static=True)
    began: np.ndarray
    """Time of the first knot of each run (R,)."""
    ended: np.ndarray
    """Time of the last sample of each run (R,)."""
    first: np.ndarray
    """Index (W,) of the first knot of each window in those of its run."""
    knots: int = eqx.field(static=True)
    problem: Problem

    @staticmethod
    def of(
        candidate_set: CandidateSet, effects: Sequence[str], values: Mapping[str, float], free: Sequence[str]
    ) -> "ForceEstimator":
        """The model of `candidate_set` with `effects` at `values`, those in `free` to be estimated."""
        full, problem = candidate_set.problem.model, candidate_set.windows.problem
        known = parameters(full)
        moved_ = {n.split(".")[1] for n, v in values.items() if n.startswith("effects.") and v != float(known[n].value)}
        kept = {n: e for n, e in full.effects.items() if n in effects or n in moved_}
        model = Model(full.board, full.tyre, full.constraint, OrderedDict(kept))
        model = with_parameters(model, {n: v for n, v in values.items() if n in parameters(model)})
        names = [window.recorded_as for window in problem.runs]
        runs = tuple(dict.fromkeys(names))
        owner = np.array([runs.index(name) for name in names])
        times = np.array([float(window.times[0]) for window in problem.runs])
        began = np.array([times[owner == k].min() for k in range(len(runs))])
        last = np.array([float(window.times[-1]) for window in problem.runs])
        ended = np.array([last[owner == k].max() for k in range(len(runs))])
        first = np.floor((times - began[owner]) / SPACING + 1e-6).astype(int)
        length = max(float(window.times[-1] - window.times[0]) for window in problem.runs)
        count = int(np.ceil(length / SPACING)) + 2
        batch = eqx.tree_at(
            lambda b: (b.start, b.free_start),
            problem.batch,
            (problem.batch.start[:, : 6 + model.memories], problem.batch.free_start[:, : 6 + model.memories]),
        )
        return ForceEstimator(model, tuple(free), batch, owner, runs, began, ended, first, count, problem)

    def typical(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The steps (P,) from `values` to what is typical, and one over their variance."""
        pull, strength = self.problem.typical(dict(zip(self.names, values, strict=True)), self.names)
        return pull[: len(self.names)], DEPENDENT * strength[: len(self.names)] ** 2

    @property
    def counts(self) -> list[int]:
        """How many knots each run has."""
        return [int(self.first[self.owner == k].max()) + self.knots for k in range(len(self.runs))]

    def values(self) -> np.ndarray:
        """The free parameters as the model has them."""
        known = parameters(self.model)
        return np.array([float(known[name].value) for name in self.names])

    def linearise(self, point: ForcePoint) -> ForceLinearisation:
        """Residuals, derivatives and motion at `point`."""
        grid = self.began[self.owner] + SPACING * self.first
        every = (self.batch, point.start, self.batch.free_start, grid, self.local(point.force))
        values, unit = jnp.asarray(point.values), jnp.eye(len(self.names))

        def linearised(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, MotionSamples]:
            padded = numbers[np.minimum(np.arange(CHUNK), len(numbers) - 1)]
            windows, start, free, *of_force = jax.tree.map(lambda leaf: jnp.asarray(leaf[padded]), every)
            done = linearise_in_force(self.model, Variables(self.names, values, unit, start, free), windows, *of_force)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(numbers)], done)

        chunks = [np.arange(k, min(k + CHUNK, len(grid))) for k in range(0, len(grid), CHUNK)]
        parts = in_threads(linearised, chunks)
        r, J, track = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
        P, S, K = len(self.names), point.start.shape[1], self.knots
        by_parameters, by_start, by_force, by_grip = np.split(J, (P, P + S, P + S + 3 * K), axis=-1)
        return ForceLinearisation(r, by_parameters, by_start, by_force, by_grip, track)

    def local(self, force: Sequence[np.ndarray]) -> np.ndarray:
        """The knots (W, K, 3) of each window, out of those of its run."""
        pairs = zip(self.owner, self.first, strict=True)
        return np.array([force[run][first : first + self.knots] for run, first in pairs])

    def windows(self, linearised: ForceLinearisation, force: Sequence[np.ndarray]) -> list[Window]:
        """Each window with its start state projected out, linear in the force as a whole and not in its change."""
        free_start, made = np.asarray(self.batch.free_start), []
        local, memories = self.local(force), self.model.memories
        for k in range(len(self.owner)):
            rows = linearised.residual[k].size
            r = linearised.residual[k].reshape(rows)
            P, S, F, G = (-part[k].reshape(rows, -1) for part in linearised[1:5])
            measured = np.abs(S).sum(axis=1) > 0
            r, P, S, F, G = (part[measured] for part in (r, P, S, F, G))
            reach = np.append(REACH, np.full(memories, MEMORY))
            brake = np.diag(1 / reach)[:, free_start[k] > 0]
            q, t = np.linalg.qr(np.concatenate([S[:, free_start[k] > 0], brake]))
            y = r + F @ local[k].reshape(-1)
            whole = np.concatenate([y[:, None], F, G, P], axis=1)
            whole = np.concatenate([whole, np.zeros((len(brake), whole.shape[1]))])
            inside = q.T @ whole
            y, F, G, P = np.split(whole - q @ inside, np.cumsum([1, F.shape[1], G.shape[1]]), axis=1)
            made.append(Window(y[:, 0], F, G, P, (t, inside[:, 0], inside[:, 1:])))
        return made

    def normal(self, windows: Sequence[Window]) -> list[Normal]:
        """The normal equations of each run."""
        P, made = len(self.names), []
        for k, count in enumerate(self.counts):
            A, b, B = np.zeros((3 * count, 3 * count)), np.zeros(3 * count), np.zeros((3 * count, P))
            PP, p = np.zeros((P, P)), np.zeros(P)
            for w in np.flatnonzero(self.owner == k):
                window = windows[int(w)]
                place = (self.first[w] + np.arange(self.knots)[:, None] + count * np.arange(3)).reshape(-1)
                A[place[:, None], place] += window.force.T @ window.force
                b[place] += window.force.T @ window.data
                B[place] += window.force.T @ window.parameters
                PP += window.parameters.T @ window.parameters
                p += window.parameters.T @ window.data
            made.append(Normal(A, b, B, PP, p))
        return made

    def moved(self, point: ForcePoint, windows: Sequence[Window], post: Posterior, share: float) -> ForcePoint:
        """`point` after a `share` of the way to `post`, each start state following."""
        domains = domains_of(self.model, self.names)
        step = np.array(
            [np.clip(s, -1.0, 1.0) if d.multiplicative else s for s, d in zip(post.step, domains, strict=True)]
        )
        values = [d.moved_inside(v, share * s) for v, s, d in zip(point.values, step, domains, strict=True)]
        start, free_start, local = point.start.copy(), np.asarray(self.batch.free_start), self.local(post.force)
        for k, window in enumerate(windows):
            t, y, columns = window.back
            unused = np.zeros(window.grip.shape[1])
            left = y - columns @ np.concatenate([local[k].reshape(-1), unused, step])
            start[k, free_start[k] > 0] += share * np.linalg.lstsq(t, left, rcond=1e-12)[0]
        force = [share * new + (1 - share) * old for new, old in zip(post.force, point.force, strict=True)]
        return ForcePoint(np.array(values), start, tuple(force))

    def total(self, linearised: ForceLinearisation, point: ForcePoint, prior: Prior) -> float:
        """The square of the residuals, and of how far the force and the parameters are from what is expected."""
        square = float((linearised.residual**2).sum()) + sum(prior.distance(force) for force in point.force)
        pull, precision = self.typical(point.values)
        square += float(precision @ pull**2)
        return square if np.isfinite(square) else np.inf

    @kept_fit
    def settled(self, start: np.ndarray) -> "ForceSolution":
        """Parameters, start states and force, by Gauss-Newton from no force at all."""
        point = ForcePoint(self.values(), start, tuple(np.zeros((count, 3)) for count in self.counts))
        prior, linearised, steady = FIRST, self.linearise(point), False
        for _ in range(ROUNDS):
            windows = self.windows(linearised, point.force)
            normal = self.normal(windows)
            if not steady:
                last, prior = (
                    prior,
                    fitted_prior(windows, observable_components(normal), prior, self.typical(point.values)),
                )
                steady = prior.near(last)
            post = posterior(normal, prior, self.typical(point.values))
            before, share, gain = self.total(linearised, point, prior), 1.0, 0.0
            trial, trial_linearised = point, linearised
            while share > 0.01 and gain <= 0:
                trial = self.moved(point, windows, post, share)
                trial_linearised = self.linearise(trial)
                gain, share = before - self.total(trial_linearised, trial, prior), share / 3
            if gain > 0:
                point, linearised = trial, trial_linearised
            if gain < ENOUGH * before:
                break
        windows = self.windows(linearised, point.force)
        normal = self.normal(windows)
        post = posterior(normal, prior, self.typical(point.values), sd=True)
        return ForceSolution(point, linearised, windows, prior, post, observable_components(normal))


class ForceSolution(NamedTuple):
    """Where the estimate of a free force ended."""

    point: ForcePoint
    linearised: ForceLinearisation
    windows: list[Window]
    prior: Prior
    posterior: Posterior
    observable: np.ndarray
