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
from jaxtyping import Array, Float
from scipy import linalg, optimize

from ._batch import Batch
from ._bench import Bench
from ._effect import Force, Grip, Motion, Wheel, Wrench
from ._least_squares import Unknowns, domains_of, moved
from ._math import slip_angle
from ._model import Model
from ._simulate import Accuracy, motions, simulate
from ._study import DEPENDENT, Study
from ._units import Scalar, parameters, with_parameters

SPACING = 0.1
"""Time between the knots of a free force [s]."""
ACCURACY = Accuracy(rtol=1e-6, atol=1e-8, max_steps=6000, derivative="forward")
"""Finer than windows otherwise need: the steps of the solver must not jump over a knot."""
ROUNDS = 14
REACH, MEMORY = np.array([0.05, 0.05, 0.2, 0.1, 0.1, 0.5]), 0.1
"""How far one step moves a start state, m, rad, m/s, rad/s, and the memory of a tyre [rad]."""

ENOUGH = 1e-3
"""The estimate ends where a step lowers the total by less than this share of it."""


class FreeForce(Force):
    """A wrench that is piecewise linear in time: `values` (K, 3) at `start` + k `spacing`, constant outside."""

    start: Scalar
    spacing: Scalar
    values: Float[Array, "K 3"]

    def wrench(self, motion: Motion) -> Wrench:
        now = _between(self.values, (motion.time - self.start) / self.spacing)
        return now[0], now[1], now[2]


class FreeGrip(Grip):
    """Lateral force x (1 + g), g piecewise linear in time: `values` (K, 2), ahead of the middle and behind it."""

    start: Scalar
    spacing: Scalar
    values: Float[Array, "K 2"]

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        now = _between(self.values, (motion.time - self.start) / self.spacing)
        return force * (1 + now[0 if wheel.wheelset.place > 0 else 1])


def _between(values: Float[Array, "K c"], place: Scalar) -> Float[Array, " c"]:
    """`values` at the fractional index `place`, held constant beyond the ends."""
    held = jnp.clip(place, 0.0, values.shape[0] - 1.0)
    k = jnp.clip(jnp.floor(held).astype(int), 0, values.shape[0] - 2)
    part = held - k.astype(float)
    return (1 - part) * values[k] + part * values[k + 1]


class Track(NamedTuple):
    """How the board moves at every sample of every window, each (W, n); the wheelsets ahead of the middle first."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    theta: np.ndarray
    heading: np.ndarray
    u: np.ndarray
    w: np.ndarray
    r: np.ndarray
    steering_angle: np.ndarray
    steering_rate: np.ndarray
    rotor_angle: np.ndarray
    rotor_rate: np.ndarray
    slip: tuple[np.ndarray, np.ndarray]
    """Lateral slip speed [m/s]."""
    angle: tuple[np.ndarray, np.ndarray]
    """Slip angle [rad]."""


class Linear(NamedTuple):
    """Residuals (W, n, 3) and their derivatives by parameters, start states, force and grip knots, and the motion."""

    residual: np.ndarray
    by_parameters: np.ndarray
    by_start: np.ndarray
    by_force: np.ndarray
    by_grip: np.ndarray
    track: Track


@eqx.filter_jit
def _linearise(model: Model, at: Unknowns, batch: Batch, grid, knots):
    """Everything at one point, window by window: `grid` (W,) is the time of the first knot, `knots` (W, K, 3)."""
    domains = domains_of(model, at.names)
    P, S, K = len(at.names), at.start.shape[1], knots.shape[1]
    size = P + S + 5 * K

    def window(mine):
        piece, start, free, first, force = mine

        def residual(z):
            p, s, f, g = jnp.split(z, (P, P + S, P + S + 3 * K))
            values = moved(domains, at, p)
            here = with_parameters(model, {name: values[k] for k, name in enumerate(at.names)})
            here = eqx.tree_at(lambda m: m.board, here, replace_fn=lambda b: b.loaded(*piece.payload))
            h = jnp.asarray(SPACING)
            here = here.add(
                free_force=FreeForce(first, h, force + f.reshape(K, 3)), free_grip=FreeGrip(first, h, g.reshape(K, 2))
            )
            path = simulate(here, piece.gait, piece.times, start + free * s, accuracy=ACCURACY, throw=False)
            left = jnp.where(piece.weight > 0, (piece.pose - path.pose) * piece.weight, 0.0)
            return left, _track(here, piece.gait, path)

        def along(direction):
            return jax.jvp(residual, (jnp.zeros(size),), (direction,), has_aux=True)

        r, J, track = jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(size))
        return r, J, track

    return jax.lax.map(window, (batch, at.start, at.free_start, grid, knots))


def _track(model: Model, gait, path) -> Track:
    motion, _ = motions(model, gait, path)
    creep = model.board.creep_speed
    places = [wheelset.place > 0 for wheelset in model.board.wheelsets]
    pairs = [(w.lateral, slip_angle(w.lateral, w.rolling, creep)) for w in motion.wheels]
    sides = []
    for ahead in (True, False):
        mine = [pair for pair, place in zip(pairs, places, strict=True) if place == ahead] or pairs
        sides.append([sum(parts) / len(mine) for parts in zip(*mine, strict=True)])
    joints = (motion.steering.angle, motion.steering.rate, motion.rotor.angle, motion.rotor.rate)
    place = (motion.time, motion.x, motion.y, motion.theta, motion.heading, motion.u, motion.w, motion.r)
    return Track(*place, *joints, (sides[0][0], sides[1][0]), (sides[0][1], sides[1][1]))


class _Point(NamedTuple):
    """Parameter values (P,), start states (W, S), and the knots of each run (Kr, 3)."""

    values: np.ndarray
    start: np.ndarray
    force: tuple[np.ndarray, ...]


class Window(NamedTuple):
    """What one window says, its start state projected out: r = H f + G g + B p + noise, f and g at its own knots.

    `data` (N,) is the residual of a board without the free force; `back` gives the start from what is left over.
    """

    data: np.ndarray
    force: np.ndarray
    grip: np.ndarray
    parameters: np.ndarray
    back: tuple[np.ndarray, np.ndarray, np.ndarray]


class _Normal(NamedTuple):
    """The normal equations of one run in its force knots, channel after channel, and the parameters."""

    A: np.ndarray
    b: np.ndarray
    B: np.ndarray
    PP: np.ndarray
    p: np.ndarray


class Prior(NamedTuple):
    """The Gaussian process: standard deviation (3,) of X, Y, N, and their correlation time [s]."""

    sd: np.ndarray
    time: float

    def near(self, other: "Prior") -> bool:
        """Whether the two differ by less than a tenth in every part that is not negligible."""
        ratio = np.log([*self.sd, self.time]) - np.log([*other.sd, other.time])
        small = np.array([*(np.maximum(self.sd, other.sd) < 1e-3), False])
        return bool((np.abs(ratio)[~small] < 0.1).all())

    def root(self, count: int) -> np.ndarray:
        """Cholesky factor (count, count) of the Matérn-3/2 correlation between knots."""
        lag = np.sqrt(3.0) * SPACING * np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / self.time
        # The small constant keeps far knots from correlations so tiny that arithmetic with them is slow.
        return np.linalg.cholesky((1 + lag) * np.exp(-lag) + 1e-6 + 1e-8 * np.eye(count))

    def factor(self, count: int) -> np.ndarray:
        """Cholesky factor (3 count, 3 count) of the covariance of X, Y, N at knots, channel after channel."""
        return np.asarray(linalg.block_diag(*(s * self.root(count) for s in self.sd)))


FIRST = Prior(np.array([0.3, 0.3, 0.05]), 0.5)


class Posterior(NamedTuple):
    """Parameter step (P,), and the knots (Kr, 3) of each run with their variance."""

    step: np.ndarray
    force: list[np.ndarray]
    variance: list[np.ndarray]


def felt(normal: Sequence[_Normal]) -> np.ndarray:
    """Which of X, Y, N (3,) the board feels at all."""
    size = np.sum([np.diag(part.A).reshape(3, -1).sum(axis=1) for part in normal], axis=0)
    return size > 1e-9 * size.max()


def posterior(
    normal: Sequence[_Normal], prior: Prior, typical: tuple[np.ndarray, np.ndarray], sd: bool = False
) -> Posterior:
    """Force and parameters given the data: with f = L w the normal equations are I + L^T A L, w standard normal.

    `typical`: the step of the parameters to what is typical, and one over its variance.
    """
    pull, precision = typical
    N, v, parts = np.diag(precision + 1e-9), precision * pull, []
    for part in normal:
        L = prior.factor(len(part.b) // 3)
        chol = np.linalg.cholesky(np.eye(len(part.b)) + L.T @ (part.A @ L))
        Z = linalg.solve_triangular(chol, L.T @ np.column_stack([part.b, part.B]), lower=True)
        N, v = N + part.PP - Z[:, 1:].T @ Z[:, 1:], v + part.p - Z[:, 1:].T @ Z[:, 0]
        parts.append((L, chol, Z))
    factor = linalg.cho_factor(N)
    step = linalg.cho_solve(factor, v)
    force, variance = [], []
    for L, chol, Z in parts:
        force.append((L @ linalg.solve_triangular(chol.T, Z[:, 0] - Z[:, 1:] @ step)).reshape(3, -1).T)
        if sd:
            spread = linalg.solve_triangular(chol, L.T, lower=True)
            carried = spread.T @ Z[:, 1:]
            own = (spread**2).sum(axis=0) + np.einsum("kp,pk->k", carried, linalg.cho_solve(factor, carried.T))
            variance.append(own.reshape(3, -1).T)
    return Posterior(step, force, variance)


def fitted_prior(
    windows: Sequence[Window], felt: np.ndarray, prior: Prior, typical: tuple[np.ndarray, np.ndarray]
) -> Prior:
    """The prior under which the windows are most probable, each with a force of its own:

    -2 log evidence = log|I + L^T A L| + log|N| + y^2 - b^T (C^-1 + A)^-1 b - (the fall by the parameters)
    """
    pull, precision = typical
    K, P = windows[0].force.shape[1] // 3, len(pull)
    order = (np.arange(K)[None, :] * 3 + np.arange(3)[:, None]).reshape(-1)
    A, right = np.zeros((len(windows), 3 * K, 3 * K)), np.zeros((len(windows), 3 * K, 1 + P))
    PP, p = np.zeros((P, P)), np.zeros(P)
    for k, window in enumerate(windows):
        H, other = window.force[:, order], np.column_stack([window.data, window.parameters])
        A[k], right[k] = H.T @ H, H.T @ other
        PP, p = PP + window.parameters.T @ window.parameters, p + window.parameters.T @ window.data

    def unpacked(z: np.ndarray) -> Prior:
        sd = np.full(3, np.exp(np.clip(z[:-1], -12.0, 7.0)).max())
        sd[felt] = np.exp(np.clip(z[:-1], -12.0, 7.0))
        return Prior(sd, float(np.exp(np.clip(z[-1], np.log(0.15), np.log(5.0)))))

    def cost(z: np.ndarray) -> float:
        there = unpacked(z)
        L = there.factor(K)
        M = np.eye(3 * K) + L.T @ A @ L
        Z = np.linalg.solve(M, L.T @ right)
        inner = np.einsum("wki,wkj->ij", L.T @ right, Z)
        N, v = np.diag(precision + 1e-9) + PP - inner[1:, 1:], precision * pull + p - inner[1:, 0]
        size = np.linalg.slogdet(M)[1].sum() + np.linalg.slogdet(N)[1]
        far = float(((z - np.clip(z, -12.0, 7.0)) ** 2).sum())
        return float(size - inner[0, 0] - v @ np.linalg.solve(N, v)) + far

    start = np.log([*prior.sd[felt], prior.time])
    simplex = np.concatenate([start[None], start + 1.0 * np.eye(start.size)])
    options = {"initial_simplex": simplex, "xatol": 0.1, "fatol": 0.5, "maxfev": 120}
    return unpacked(optimize.minimize(cost, start, method="Nelder-Mead", options=options).x)


class Drive(eqx.Module):
    """The windows of a bench under a free force, compiled once."""

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
    study: Study

    @staticmethod
    def of(bench: Bench, effects: Sequence[str], values: Mapping[str, float], free: Sequence[str]) -> "Drive":
        """The model of `bench` with `effects` at `values`, those in `free` to be estimated."""
        full, study = bench.study.model, bench.windows.study
        known = parameters(full)
        moved_ = {n.split(".")[1] for n, v in values.items() if n.startswith("effects.") and v != float(known[n].value)}
        kept = {n: e for n, e in full.effects.items() if n in effects or n in moved_}
        model = Model(full.board, full.tyre, full.skid, OrderedDict(kept))
        model = with_parameters(model, {n: v for n, v in values.items() if n in parameters(model)})
        names = [window.name.rsplit("[", 1)[0] for window in study.runs]
        runs = tuple(dict.fromkeys(names))
        owner = np.array([runs.index(name) for name in names])
        times = np.array([float(window.times[0]) for window in study.runs])
        began = np.array([times[owner == k].min() for k in range(len(runs))])
        last = np.array([float(window.times[-1]) for window in study.runs])
        ended = np.array([last[owner == k].max() for k in range(len(runs))])
        first = np.floor((times - began[owner]) / SPACING + 1e-6).astype(int)
        length = max(float(window.times[-1] - window.times[0]) for window in study.runs)
        count = int(np.ceil(length / SPACING)) + 2
        batch = eqx.tree_at(
            lambda b: (b.start, b.free_start),
            study.batch,
            (study.batch.start[:, : 6 + model.memories], study.batch.free_start[:, : 6 + model.memories]),
        )
        return Drive(model, tuple(free), batch, owner, runs, began, ended, first, count, study)

    def typical(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The steps (P,) from `values` to what is typical, and one over their variance."""
        pull, strength = self.study.typical(dict(zip(self.names, values, strict=True)), self.names)
        return pull[: len(self.names)], DEPENDENT * strength[: len(self.names)] ** 2

    @property
    def counts(self) -> list[int]:
        """How many knots each run has."""
        return [int(self.first[self.owner == k].max()) + self.knots for k in range(len(self.runs))]

    def values(self) -> np.ndarray:
        """The free parameters as the model has them."""
        known = parameters(self.model)
        return np.array([float(known[name].value) for name in self.names])

    def linearise(self, point: _Point) -> Linear:
        """Residuals, derivatives and motion at `point`."""
        at = Unknowns(
            self.names,
            jnp.asarray(point.values),
            jnp.eye(len(self.names)),
            jnp.asarray(point.start),
            self.batch.free_start,
        )
        grid = jnp.asarray(self.began[self.owner] + SPACING * self.first)
        local = jnp.asarray(np.array([self.local(point.force, k) for k in range(len(self.owner))]))
        r, J, track = jax.tree.map(np.asarray, _linearise(self.model, at, self.batch, grid, local))
        P, S, K = len(self.names), point.start.shape[1], self.knots
        by_parameters, by_start, by_force, by_grip = np.split(J, (P, P + S, P + S + 3 * K), axis=-1)
        return Linear(r, by_parameters, by_start, by_force, by_grip, track)

    def local(self, force: Sequence[np.ndarray], window: int) -> np.ndarray:
        """The knots (K, 3) of one window, out of those of its run."""
        first = self.first[window]
        return force[self.owner[window]][first : first + self.knots]

    def windows(self, found: Linear, force: Sequence[np.ndarray]) -> list[Window]:
        """Each window with its start state projected out, linear in the force as a whole and not in its change."""
        free_start, made = np.asarray(self.batch.free_start), []
        for k in range(len(self.owner)):
            rows = found.residual[k].size
            r = found.residual[k].reshape(rows)
            P, S, F, G = (-part[k].reshape(rows, -1) for part in found[1:5])
            seen = np.abs(S).sum(axis=1) > 0
            r, P, S, F, G = (part[seen] for part in (r, P, S, F, G))
            reach = np.append(REACH, np.full(self.model.memories, MEMORY))
            brake = np.diag(1 / reach)[:, free_start[k] > 0]
            q, t = np.linalg.qr(np.concatenate([S[:, free_start[k] > 0], brake]))
            y = r + F @ self.local(force, k).reshape(-1)
            whole = np.concatenate([y[:, None], F, G, P], axis=1)
            whole = np.concatenate([whole, np.zeros((len(brake), whole.shape[1]))])
            inside = q.T @ whole
            y, F, G, P = np.split(whole - q @ inside, np.cumsum([1, F.shape[1], G.shape[1]]), axis=1)
            made.append(Window(y[:, 0], F, G, P, (t, inside[:, 0], inside[:, 1:])))
        return made

    def normal(self, windows: Sequence[Window]) -> list[_Normal]:
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
            made.append(_Normal(A, b, B, PP, p))
        return made

    def moved(self, point: _Point, windows: Sequence[Window], post: Posterior, share: float) -> _Point:
        """`point` after a `share` of the way to `post`, each start state following."""
        domains = domains_of(self.model, self.names)
        step = np.array(
            [np.clip(s, -1.0, 1.0) if d.multiplicative else s for s, d in zip(post.step, domains, strict=True)]
        )
        values = [
            np.clip(v * np.exp(share * s) if d.multiplicative else v + share * s, d.low, d.high)
            for v, s, d in zip(point.values, step, domains, strict=True)
        ]
        start, free_start = point.start.copy(), np.asarray(self.batch.free_start)
        for k, window in enumerate(windows):
            t, y, columns = window.back
            unused = np.zeros(window.grip.shape[1])
            left = y - columns @ np.concatenate([self.local(post.force, k).reshape(-1), unused, step])
            start[k, free_start[k] > 0] += share * np.linalg.lstsq(t, left, rcond=1e-12)[0]
        force = [share * new + (1 - share) * old for new, old in zip(post.force, point.force, strict=True)]
        return _Point(np.array(values), start, tuple(force))

    def total(self, found: Linear, point: _Point, prior: Prior) -> float:
        """The square of the residuals, and of how far the force and the parameters are from what is expected."""
        square = float((found.residual**2).sum())
        for force in point.force:
            root = prior.root(len(force))
            square += float((linalg.solve_triangular(root, force / prior.sd, lower=True) ** 2).sum())
        pull, precision = self.typical(point.values)
        square += float(precision @ pull**2)
        return square if np.isfinite(square) else np.inf

    def settled(self, start: np.ndarray) -> "Settled":
        """Parameters, start states and force, by Gauss-Newton from no force at all."""
        point = _Point(self.values(), start, tuple(np.zeros((count, 3)) for count in self.counts))
        prior, found, steady = FIRST, self.linearise(point), False
        for _ in range(ROUNDS):
            windows = self.windows(found, point.force)
            normal = self.normal(windows)
            if not steady:
                last, prior = prior, fitted_prior(windows, felt(normal), prior, self.typical(point.values))
                steady = prior.near(last)
            post = posterior(normal, prior, self.typical(point.values))
            before, share, gain = self.total(found, point, prior), 1.0, 0.0
            while share > 0.01 and gain <= 0:
                trial = self.moved(point, windows, post, share)
                there = self.linearise(trial)
                gain, share = before - self.total(there, trial, prior), share / 3
            if gain > 0:
                point, found = trial, there
            if gain < ENOUGH * before:
                break
        windows = self.windows(found, point.force)
        normal = self.normal(windows)
        post = posterior(normal, prior, self.typical(point.values), sd=True)
        return Settled(point, found, windows, prior, post, felt(normal))


class Settled(NamedTuple):
    """Where the estimate of a free force ended."""

    point: _Point
    found: Linear
    windows: list[Window]
    prior: Prior
    posterior: Posterior
    felt: np.ndarray
