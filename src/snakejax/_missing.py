"""The missing force: what must be added to a model that no known effect repairs, and what it depends on.

On short windows the board is driven by a free force f(t), piecewise linear between knots. With r the whitened residuals
of the windows and H minus their derivative by the knots,

    r = H f + (tyre, start states) + noise        f ~ Gaussian process, its size and duration by maximum likelihood

gives f with its error. A hypothesis such as "a yaw moment that depends on the rotor rate" is a family of histories f,
so it is a linear regression in the same residuals, and is judged by the runs it was not fitted to.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import linalg, optimize

from ._batch import Batch
from ._diagnose import NEARLY, Bench, Step
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
NOTHING = 0.02
"""A variable that explains less than this share explains nothing worth drawing."""


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


class _Linear(NamedTuple):
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


class RunForce(NamedTuple):
    """The missing wrench (K, 3) of one run at times `t` (K,), body frame, with standard deviations.

    A standard deviation is NaN where the structure does not feel that component at all.
    """

    run: str
    t: np.ndarray
    force: np.ndarray
    sd: np.ndarray


class Shape(NamedTuple):
    """How the missing action depends on `variable`: at the values `at` (m,) or (m, 2) it is `value` (m, c).

    `carrier` says what the value is: "X", "Y", "N" a component of the wrench; "world" a force along the world's axes;
    "grip" a relative change of the lateral forces; "drag" [N s/m] against (u, w); "yaw_drag" [N m s] against r.
    """

    variable: str
    feature: str
    carrier: str
    at: np.ndarray
    value: np.ndarray


class Missing(NamedTuple):
    """The missing force, run by run, and the variables it depends on with the share each explains, best first.

    A share is that part of the misfit above noise which a dependence on this variable alone predicts on runs left out.
    `misfit` is the mean square of the windows' residuals without and with the free force; `shape` is None where no
    variable predicts anything.
    """

    runs: tuple[RunForce, ...]
    depends_on: tuple[tuple[str, float], ...]
    shape: Shape | None
    misfit: tuple[float, float]


def missing_force(bench: Bench, step: Step, progress: Callable[[str], None] = lambda _: None) -> Missing:
    """Estimate the force that is missing beside `step.effects`, and find what it depends on.

    The tyre and the effects of `step` stay free, as do the start states of the windows.
    """
    progress("estimating the missing force")
    free = bench.free(step.effects)
    # Far from the recordings the fit of whole runs has gone astray: what is typical is the better start.
    near = step.optimum.misfit < NEARLY
    fresh = {} if near else {name: value for name, value in bench.study.values().items() if name in bench.tyre}
    settled = bench.windows.settle({**step.optimum.values, **fresh}, free)
    drive = _Drive.of(bench, step.effects, settled.values, free)
    now = drive.settled(settled.start[:, : 6 + drive.model.memories])
    progress("what does the missing force depend on?")
    depends_on, shape = _dependence(drive, now)
    samples = float((np.asarray(drive.batch.weight) > 0).sum())
    misfit = (settled.cost / samples, float((now.found.residual**2).sum()) / samples)
    return Missing(drive.forces(now), depends_on, shape, misfit)


class _Point(NamedTuple):
    """Parameter values (P,), start states (W, S), and the knots of each run (Kr, 3)."""

    values: np.ndarray
    start: np.ndarray
    force: tuple[np.ndarray, ...]


class _Window(NamedTuple):
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
    square: float


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


FIRST = Prior(np.array([0.3, 0.3, 0.05]), 0.5)


class Posterior(NamedTuple):
    """Parameter step (P,), and the knots (Kr, 3) of each run with their variance."""

    step: np.ndarray
    force: list[np.ndarray]
    variance: list[np.ndarray]


class _Drive(eqx.Module):
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
    def of(bench: Bench, effects: Sequence[str], values: Mapping[str, float], free: Sequence[str]) -> "_Drive":
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
        return _Drive(model, tuple(free), batch, owner, runs, began, ended, first, count, study)

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

    def linearise(self, point: _Point) -> _Linear:
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
        return _Linear(r, by_parameters, by_start, by_force, by_grip, track)

    def local(self, force: Sequence[np.ndarray], window: int) -> np.ndarray:
        """The knots (K, 3) of one window, out of those of its run."""
        first = self.first[window]
        return force[self.owner[window]][first : first + self.knots]

    def windows(self, found: _Linear, force: Sequence[np.ndarray]) -> list[_Window]:
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
            made.append(_Window(y[:, 0], F, G, P, (t, inside[:, 0], inside[:, 1:])))
        return made

    def normal(self, windows: Sequence[_Window]) -> list[_Normal]:
        """The normal equations of each run."""
        P, made = len(self.names), []
        for k, count in enumerate(self.counts):
            A, b, B = np.zeros((3 * count, 3 * count)), np.zeros(3 * count), np.zeros((3 * count, P))
            PP, p, square = np.zeros((P, P)), np.zeros(P), 0.0
            for w in np.flatnonzero(self.owner == k):
                window = windows[int(w)]
                place = (self.first[w] + np.arange(self.knots)[:, None] + count * np.arange(3)).reshape(-1)
                A[place[:, None], place] += window.force.T @ window.force
                b[place] += window.force.T @ window.data
                B[place] += window.force.T @ window.parameters
                PP += window.parameters.T @ window.parameters
                p += window.parameters.T @ window.data
                square += float(window.data @ window.data)
            made.append(_Normal(A, b, B, PP, p, square))
        return made

    def felt(self, normal: Sequence[_Normal]) -> np.ndarray:
        """Which of X, Y, N (3,) the board feels at all."""
        size = np.sum([np.diag(part.A).reshape(3, -1).sum(axis=1) for part in normal], axis=0)
        return size > 1e-9 * size.max()

    def posterior(self, normal: Sequence[_Normal], prior: Prior, values: np.ndarray, sd: bool = False) -> Posterior:
        """Force and parameters given the data: with f = L w the normal equations are I + L^T A L, w standard normal."""
        pull, precision = self.typical(values)
        N, v, parts = np.diag(precision + 1e-9), precision * pull, []
        for part, count in zip(normal, self.counts, strict=True):
            L = np.asarray(linalg.block_diag(*(s * prior.root(count) for s in prior.sd)))
            chol = np.linalg.cholesky(np.eye(3 * count) + L.T @ (part.A @ L))
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

    def fitted_prior(self, windows: Sequence[_Window], felt: np.ndarray, prior: Prior, values: np.ndarray) -> Prior:
        """The prior under which the windows are most probable, each with a force of its own:

        -2 log evidence = log|I + L^T A L| + log|N| + y^2 - b^T (C^-1 + A)^-1 b - (the fall by the parameters)
        """
        K, P = self.knots, len(self.names)
        order = (np.arange(K)[None, :] * 3 + np.arange(3)[:, None]).reshape(-1)
        A, right = np.zeros((len(windows), 3 * K, 3 * K)), np.zeros((len(windows), 3 * K, 1 + P))
        PP, p = np.zeros((P, P)), np.zeros(P)
        for k, window in enumerate(windows):
            H, other = window.force[:, order], np.column_stack([window.data, window.parameters])
            A[k], right[k] = H.T @ H, H.T @ other
            PP, p = PP + window.parameters.T @ window.parameters, p + window.parameters.T @ window.data
        pull, precision = self.typical(values)

        def unpacked(z: np.ndarray) -> Prior:
            sd = np.full(3, np.exp(np.clip(z[:-1], -12.0, 7.0)).max())
            sd[felt] = np.exp(np.clip(z[:-1], -12.0, 7.0))
            return Prior(sd, float(np.exp(np.clip(z[-1], np.log(0.15), np.log(5.0)))))

        def cost(z: np.ndarray) -> float:
            there = unpacked(z)
            L = np.asarray(linalg.block_diag(*(s * there.root(K) for s in there.sd)))
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

    def moved(self, point: _Point, windows: Sequence[_Window], post: Posterior, share: float) -> _Point:
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

    def total(self, found: _Linear, point: _Point, prior: Prior) -> float:
        """The square of the residuals, and of how far the force and the parameters are from what is expected."""
        square = float((found.residual**2).sum())
        for force in point.force:
            root = prior.root(len(force))
            square += float((linalg.solve_triangular(root, force / prior.sd, lower=True) ** 2).sum())
        pull, precision = self.typical(point.values)
        square += float(precision @ pull**2)
        return square if np.isfinite(square) else np.inf

    def forces(self, now: "_Settled") -> tuple[RunForce, ...]:
        """The force of each run at its knots."""
        made = []
        for k, name in enumerate(self.runs):
            count = int(np.ceil((self.ended[k] - self.began[k]) / SPACING)) + 1
            t, force = self.began[k] + SPACING * np.arange(count), now.posterior.force[k][:count]
            sd = np.where(now.felt, np.sqrt(now.posterior.variance[k][:count]), np.nan)
            made.append(RunForce(name, t, force, sd))
        return tuple(made)

    def settled(self, start: np.ndarray) -> "_Settled":
        """Parameters, start states and force, by Gauss-Newton from no force at all."""
        point = _Point(self.values(), start, tuple(np.zeros((count, 3)) for count in self.counts))
        prior, found, steady = FIRST, self.linearise(point), False
        for _ in range(ROUNDS):
            windows = self.windows(found, point.force)
            normal = self.normal(windows)
            if not steady:
                last, prior = prior, self.fitted_prior(windows, self.felt(normal), prior, point.values)
                steady = prior.near(last)
            post = self.posterior(normal, prior, point.values)
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
        post = self.posterior(normal, prior, point.values, sd=True)
        return _Settled(point, found, windows, prior, post, self.felt(normal))


class _Settled(NamedTuple):
    """Where the estimate of a free force ended."""

    point: _Point
    found: _Linear
    windows: list[_Window]
    prior: Prior
    posterior: Posterior
    felt: np.ndarray


class Design(NamedTuple):
    """One family of histories: `variable` through `feature`, acting on `carrier`; `columns` of the regression."""

    variable: str
    feature: str
    carrier: str
    terms: Callable[[np.ndarray], np.ndarray]
    columns: slice


class _Feature(NamedTuple):
    """A variable as a regression sees it: `seen` (..., W, n), and its terms (T, W, n) from values like it.

    For the two wheelsets, `sides` are their own values where these differ.
    """

    name: str
    seen: np.ndarray
    terms: Callable[[np.ndarray], np.ndarray]
    sides: tuple[np.ndarray, np.ndarray] | None = None


Terms = Callable[[np.ndarray], np.ndarray]


def _polynomial(seen: np.ndarray, degree: int) -> Terms:
    """Legendre polynomials over the range of `seen`, held constant beyond it."""
    low, high = np.percentile(seen, [0.5, 99.5])
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-9)

    def terms(values: np.ndarray) -> np.ndarray:
        z = np.clip((values - middle) / half, -1.0, 1.0)
        return np.moveaxis(np.polynomial.legendre.legvander(z, degree), -1, 0)

    return terms


def _harmonics(most: int) -> Terms:
    """1, cos, sin and so on up to `most` times the angle."""

    def terms(values: np.ndarray) -> np.ndarray:
        turns = [part(k * values) for k in range(1, most + 1) for part in (np.cos, np.sin)]
        return np.stack([np.ones_like(values), *turns])

    return terms


def _plane(seen: np.ndarray, degree: int) -> Terms:
    """Linear or quadratic in both coordinates of the place, seen from the middle of all places."""
    centre = seen.reshape(2, -1).mean(axis=1)
    size = max(float(np.abs(seen.reshape(2, -1) - centre[:, None]).max()), 1e-9)

    def terms(values: np.ndarray) -> np.ndarray:
        x, y = ((values[k] - centre[k]) / size for k in range(2))
        return np.stack([np.ones_like(x), x, y, x**2, x * y, y**2][: 3 if degree == 1 else 6])

    return terms


def _phase(drive: _Drive, track: Track) -> np.ndarray:
    """The phase [rad] of the strongest sine in each run's steering, or in its rotor where the steering rests."""
    phase = np.zeros_like(track.time)
    for k in range(len(drive.runs)):
        mine = drive.owner == k
        t = track.time[mine].ravel()
        joints = (track.steering_angle[mine].ravel(), track.rotor_angle[mine].ravel())
        angle = joints[0] if np.std(joints[0]) > 1e-6 else joints[1]
        angle = angle - angle.mean()
        found = []
        for w in np.arange(0.3, 15.0, 0.02):
            amplitude = np.exp(-1j * w * t) @ angle
            found.append((abs(amplitude), w, np.angle(amplitude)))
        _, w, start = max(found)
        phase[mine] = np.mod(w * track.time[mine] + start + np.pi / 2, 2 * np.pi)
    return phase


def _features(drive: _Drive, track: Track) -> dict[str, list[_Feature]]:
    """Each variable, as a few features: stiff ones, which go far beyond what was seen, and flexible ones."""

    def plain(name: str, seen: np.ndarray, sides=None) -> list[_Feature]:
        over = seen if sides is None else np.stack(sides)
        return [_Feature(name, seen, _polynomial(over, degree), sides) for degree in (2, 5)]

    def turning(name: str, seen: np.ndarray) -> list[_Feature]:
        return [_Feature(name, seen, _harmonics(most)) for most in (1, 2)]

    place = np.stack([track.x, track.y])
    slip, angle = track.slip, track.angle
    return {
        "world_position": [_Feature("place", place, _plane(place, degree)) for degree in (1, 2)],
        "heading": turning("heading", track.heading),
        "speed": plain("speed", np.hypot(track.u, track.w)),
        "slip": plain("slip_speed", (slip[0] + slip[1]) / 2, slip)
        + plain("slip_angle", (angle[0] + angle[1]) / 2, angle),
        "steering_angle": plain("steering_angle", track.steering_angle),
        "steering_rate": plain("steering_rate", track.steering_rate),
        "rotor_angle": plain("rotor_angle", track.rotor_angle),
        "rotor_rate": plain("rotor_rate", track.rotor_rate),
        "time": plain("time", track.time),
        "gait_phase": turning("gait_phase", _phase(drive, track)),
    }


PERIODIC = ("heading", "gait_phase")
WORLD = ("world_position", "heading", "time")
"""The variables on which a force along the axes of the world may depend."""


def _histories(feature: _Feature, variable: str, track: Track) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By carrier: histories of the wrench (T, W, n, 3) and of the grip of both sides (T, W, n, 2)."""
    g = feature.terms(feature.seen)
    none, zero = np.zeros((*g.shape, 2)), np.zeros_like(g)
    along = {
        "X": [(g, zero, zero)],
        "Y": [(zero, g, zero)],
        "N": [(zero, zero, g)],
        "drag": [(-g * track.u, -g * track.w, zero)],
        "yaw_drag": [(zero, zero, -g * track.r)],
    }
    if variable in WORLD:
        c, s = np.cos(track.theta), np.sin(track.theta)
        along["world"] = [(g * c, -g * s, zero), (g * s, g * c, zero)]
    made = {
        name: (np.concatenate([np.stack(part, axis=-1) for part in parts]), np.concatenate([none] * len(parts)))
        for name, parts in along.items()
    }
    sides = feature.sides or (feature.seen, feature.seen)
    grip = np.stack([feature.terms(side) for side in sides], axis=-1)
    made["grip"] = (np.zeros((*g.shape, 3)), grip)
    return made


class _Gram(NamedTuple):
    """Normal equations of one run in the parameters and all designs; `square` is that of the data."""

    matrix: np.ndarray
    right: np.ndarray
    square: float


def _regressions(drive: _Drive, now: _Settled) -> tuple[list[Design], list[_Gram], dict[str, list[_Feature]]]:
    """All designs, and the normal equations of each run."""
    track, P = now.found.track, len(drive.names)
    features, designs, force, grip = _features(drive, track), [], [], []
    count = P
    for variable, forms in features.items():
        for feature in forms:
            for carrier, (wrench, change) in _histories(feature, variable, track).items():
                designs.append(
                    Design(variable, feature.name, carrier, feature.terms, slice(count, count + len(wrench)))
                )
                count += len(wrench)
                force.append(wrench)
                grip.append(change)
    wrench, change = np.concatenate(force), np.concatenate(grip)
    K, grams = drive.knots, [_Gram(np.zeros((count, count)), np.zeros(count), 0.0) for _ in drive.runs]
    for k, window in enumerate(now.windows):
        run = drive.owner[k]
        first = drive.began[run] + SPACING * drive.first[k]
        hats = np.maximum(1 - np.abs((track.time[k][:, None] - first) / SPACING - np.arange(K)), 0.0)
        # Least squares onto the knots; one that no sample touches stays at zero.
        onto = np.linalg.solve(hats.T @ hats + 1e-6 * np.eye(K), hats.T)
        f = np.einsum("kn,tnc->kct", onto, wrench[:, k]).reshape(3 * K, -1)
        g = np.einsum("kn,tnc->kct", onto, change[:, k]).reshape(2 * K, -1)
        H = np.concatenate([window.parameters, window.force @ f + window.grip @ g], axis=1)
        matrix, right, square = grams[run]
        grams[run] = _Gram(matrix + H.T @ H, right + H.T @ window.data, square + float(window.data @ window.data))
    return designs, grams, features


class _Scored(NamedTuple):
    """A design with the fall of chi^2 on runs left out, and the strength of the ridge that predicts best."""

    design: Design
    fall: float
    ridge: float


RIDGES = (1e-6, 1e-4, 1e-2, 1e-1)


class _Judge:
    """Regressions fitted to all runs but one, and judged by that one."""

    def __init__(self, grams: Sequence[_Gram], typical: tuple[np.ndarray, np.ndarray]):
        self.grams, self.typical, self.P = grams, typical, len(typical[0])
        self.whole = np.sum([gram.matrix for gram in grams], axis=0)
        self.right = np.sum([gram.right for gram in grams], axis=0)
        self.without = [self.left(k, slice(0, 0), 0.0) for k in range(len(grams))]

    def solved(self, matrix: np.ndarray, right: np.ndarray, columns: slice, ridge: float) -> np.ndarray:
        """Coefficients of the parameters and of the design in `columns`."""
        pick = np.r_[0 : self.P, columns]
        pull, precision = self.typical
        extra = np.concatenate([precision, ridge * np.diag(self.whole)[columns]])
        A = matrix[np.ix_(pick, pick)] + np.diag(extra)
        b = right[pick] + np.concatenate([precision * pull, np.zeros(len(pick) - self.P)])
        size = np.sqrt(np.diag(A))
        safe = np.where(size > 0, size, 1.0)
        return np.linalg.lstsq(A / np.outer(safe, safe), b / safe, rcond=1e-12)[0] / safe

    def left(self, k: int, columns: slice, ridge: float) -> float:
        """chi^2 of run `k` under a regression fitted to the others."""
        gram, pick = self.grams[k], np.r_[0 : self.P, columns]
        c = self.solved(self.whole - gram.matrix, self.right - gram.right, columns, ridge)
        return gram.square - 2 * float(gram.right[pick] @ c) + float(c @ gram.matrix[np.ix_(pick, pick)] @ c)

    def judged(self, design: Design) -> _Scored:
        """The fall of chi^2 on runs left out, at the best ridge."""
        runs = range(len(self.grams))
        falls = [sum(self.without[k] - self.left(k, design.columns, ridge) for k in runs) for ridge in RIDGES]
        best = int(np.argmax(falls))
        return _Scored(design, float(falls[best]), RIDGES[best])

    def fitted(self, scored: _Scored) -> np.ndarray:
        """The coefficients of a design in a regression on all runs."""
        return self.solved(self.whole, self.right, scored.design.columns, scored.ridge)[self.P :]


def _dependence(drive: _Drive, now: _Settled) -> tuple[tuple[tuple[str, float], ...], Shape | None]:
    """The share of the misfit above noise that each variable explains on runs left out, and how the best one acts."""
    designs, grams, features = _regressions(drive, now)
    judge = _Judge(grams, drive.typical(now.point.values))
    dof = float((np.asarray(drive.batch.weight) > 0).sum() - np.asarray(drive.batch.free_start).sum())
    # Four standard deviations of noise more, so that nothing is explained where there is nothing to explain.
    excess = max(sum(judge.without) - dof, 0.0) + 4 * np.sqrt(2 * dof)
    scored = sorted((judge.judged(design) for design in designs), key=lambda s: -s.fall)
    best: dict[str, _Scored] = {}
    for one in scored:
        best.setdefault(one.design.variable, one)
    shares = tuple((name, float(np.clip(one.fall / excess, 0.0, 1.0))) for name, one in best.items())
    if shares[0][1] < NOTHING:
        return shares, None
    won = best[shares[0][0]]
    feature = next(f for f in features[won.design.variable] if f.terms is won.design.terms)
    return shares, _shape(won.design, feature, judge.fitted(won))


def _shape(design: Design, feature: _Feature, coefficients: np.ndarray) -> Shape:
    """The action over the range of its variable."""
    if design.variable == "world_position":
        ranges = [np.linspace(np.percentile(part, 2), np.percentile(part, 98), 6) for part in feature.seen]
        at = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, 2)
        terms = feature.terms(at.T)
    else:
        low, high = np.percentile(feature.seen if feature.sides is None else np.stack(feature.sides), [2, 98])
        low, high = (-np.pi, np.pi) if design.variable in PERIODIC else (low, high)
        at = np.linspace(low, high, 25)
        terms = feature.terms(at)
    return Shape(design.variable, design.feature, design.carrier, at, terms.T @ coefficients.reshape(-1, len(terms)).T)


_SEEN = {
    "heading": "motion.heading",
    "speed": "jnp.hypot(motion.u, motion.w + 1e-9)",
    "slip_speed": "sum(wheel.lateral for wheel in motion.wheels) / len(motion.wheels)",
    "slip_angle": "sum(jnp.arctan2(w.lateral, jnp.abs(w.rolling) + 0.01) for w in motion.wheels) / len(motion.wheels)",
    "steering_angle": "motion.steering.angle",
    "steering_rate": "motion.steering.rate",
    "rotor_angle": "motion.rotor.angle",
    "rotor_rate": "motion.rotor.rate",
    "time": "motion.time",
    # Of one sine: its frequency follows from angle and acceleration.
    "gait_phase": "jnp.arctan2(jnp.sign(s.angle) * jnp.sqrt(jnp.abs(s.angle * s.acceleration) + 1e-12), s.rate)",
}
_SEEN_BY_WHEEL = {
    "slip_speed": "wheel.lateral",
    "slip_angle": "jnp.arctan2(wheel.lateral, jnp.abs(wheel.rolling) + 0.01)",
}
_UNITS = {"X": "N", "Y": "N", "N": "N m", "world": "N", "grip": "-", "drag": "N s/m", "yaw_drag": "N m s"}
_ACTS = {
    "X": "return {0}, jnp.zeros_like({0}), jnp.zeros_like({0})",
    "Y": "return jnp.zeros_like({0}), {0}, jnp.zeros_like({0})",
    "N": "return jnp.zeros_like({0}), jnp.zeros_like({0}), {0}",
    "drag": "return -({0}) * motion.u, -({0}) * motion.w, jnp.zeros_like(motion.u)",
    "yaw_drag": "return jnp.zeros_like(motion.r), jnp.zeros_like(motion.r), -({0}) * motion.r",
    "grip": "return force * (1 + {0})",
}


def starter(missing: Missing) -> str:
    """A Python file with an effect of the user's own that acts as the missing force was found to.

    Its parameters are zero, and it then changes nothing; the values found stand in its docstring.

    **Raises:** `ValueError` where no variable was found on which the force depends.
    """
    shape = missing.shape
    if shape is None:
        raise ValueError("No variable was found on which the missing force depends, so there is nothing to start from.")
    terms, values = _form(shape)
    drop = shape.carrier == "grip"
    names = [name for name in terms if not (drop and not terms[name][0])]
    g = _sum(names, [terms[name][0] for name in names])
    if shape.carrier == "world":
        sides = {"east": [f"{n}x" for n in names], "north": [f"{n}y" for n in names]}
        found = dict(zip([*sides["east"], *sides["north"]], values.T.ravel(), strict=True))
        lines = [f"{side} = {_sum(mine, [terms[n][0] for n in names])}" for side, mine in sides.items()]
        lines += ["X, Y = motion.into_body(east, north)", "return X, Y, jnp.zeros_like(X)"]
    else:
        found = {name: value for name, value in zip(terms, values[:, 0], strict=True) if name in names}
        lines = [
            f"g = {g}" if len(g) < 100 else "g = " + g.replace(" + self.p2", "\n        g += self.p2"),
            _ACTS[shape.carrier].format("g"),
        ]
    seen = _SEEN_BY_WHEEL.get(shape.feature) if drop else None
    if shape.variable == "world_position":
        lines = ["x, y = motion.x, motion.y", *lines]
    else:
        joint = ["s = motion.steering"] if shape.feature == "gait_phase" else []
        lines = [*joint, f"v = {seen or _SEEN[shape.feature]}", *lines]
    method = "lateral(self, force, wheel, motion)" if drop else "wrench(self, motion)"
    unit = _UNITS[shape.carrier]
    fields = [f'    {name}: sj.Scalar = sj.param("{_unit(unit, name, shape)}", default=0.0)' for name in found]
    body = "\n".join(f"        {line}" for line in lines)
    values_found = ", ".join(f"{name}={value:.4g}" for name, value in found.items())
    return f'''"""A missing action that depends on {shape.variable}, as `snakejax explain` found it. Mend it at will.

Fit it:  snakejax fit CASE --effect THIS_FILE.py:MissingForce
Found:   {values_found}
"""

import jax.numpy as jnp
import snakejax as sj


class MissingForce(sj.{"Grip" if drop else "Force"}):
    sentence = "{_SENTENCES[shape.carrier]} depends on {shape.variable}."
{chr(10).join(fields)}

    def {method}:
{body}
'''


_SENTENCES = {
    "X": "A force along the body",
    "Y": "A force across the body",
    "N": "A yaw moment",
    "world": "A force fixed in the world",
    "grip": "The lateral grip",
    "drag": "The drag of the body",
    "yaw_drag": "The damping of turning",
}


def _sum(names: Sequence[str], terms: Sequence[str]) -> str:
    return " + ".join(f"self.{n} * {t}" if t else f"self.{n}" for n, t in zip(names, terms, strict=True))


def _unit(unit: str, name: str, shape: Shape) -> str:
    """The unit of one coefficient: over a metre for the slopes of a place, else that of the action."""
    if shape.variable != "world_position" or name.startswith("c"):
        return unit
    return "1/m" if unit == "-" else f"{unit}/m"


def _form(shape: Shape) -> tuple[dict[str, tuple[str, np.ndarray]], np.ndarray]:
    """Terms by coefficient name, as code and as values at `shape.at`, and the coefficients (T, c) that fit best.

    Of a place c + a x + b y; of an angle two harmonics, or one for each component; of anything else
    c + p tanh(v/s) + q tanh((v/s)^2): a line, a parabola or a bend that levels off, as the scale s has it.
    """
    one = np.ones(len(shape.at))
    if shape.variable == "world_position":
        x, y = shape.at.T
        terms = {"c": ("", one), "a": ("x", x), "b": ("y", y)}
        return terms, _fitted(terms, shape.value)[0]
    if shape.variable in PERIODIC:
        terms = {"c": ("", one)}
        for k, turn in ((1, "v"), (2, "2 * v"))[: 2 if shape.value.shape[1] == 1 else 1]:
            angle = k * shape.at
            terms |= {f"p{k}": (f"jnp.cos({turn})", np.cos(angle)), f"q{k}": (f"jnp.sin({turn})", np.sin(angle))}
        return terms, _fitted(terms, shape.value)[0]
    best = None
    for s in np.abs(shape.at).max() * np.array([0.3, 0.45, 0.65, 1.0, 1.5, 3.0]):
        z = shape.at / float(f"{s:.2g}")
        odd, even = f"jnp.tanh(v / {s:.2g})", f"jnp.tanh((v / {s:.2g}) ** 2)"
        terms = {"c": ("", one), "p": (odd, np.tanh(z)), "q": (even, np.tanh(z**2))}
        coefficients, left = _fitted(terms, shape.value)
        if best is None or left < best[0]:
            best = (left, terms, coefficients)
    assert best is not None
    return best[1], best[2]


def _fitted(terms: Mapping[str, tuple[str, np.ndarray]], value: np.ndarray) -> tuple[np.ndarray, float]:
    """Least squares of `value` (m, c) on the terms, with a light ridge: coefficients and what is left."""
    A = np.stack([term for _, term in terms.values()], axis=1)
    normal = A.T @ A
    c = np.linalg.solve(normal + 1e-4 * np.diag(np.diag(normal)), A.T @ value)
    return c, float(((value - A @ c) ** 2).sum())
