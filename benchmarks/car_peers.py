"""Predictions of a real car 1, 2 and 3 s ahead: ours beside the model of its authors, a neural network and PySINDy.

    python benchmarks/car_peers.py [CASE] [--ours FIT.json] [--only NAME,NAME] [--table FILE]

CASE is the folder of a car on Vicon (default `data/car`). All models predict the same windows of its held-out
recordings, in the way of `snakejax predict`: from the 0.5 s before alone, each model estimates the state with which it
fits them best, and goes on under the recorded commands. Only train recordings are used to fit.

ours        the final model of `snakejax explain CASE --json FIT.json`; without `--ours` that command runs first
base        the base model in that file: wheels that do not slip
published   the model of the authors of the car (Lyons et al. 2024, DART, TU Delft) with the constants that they publish
            with their software. They fitted them to recordings of their own choice, which may include the held-out
            ones. Their pitch, which moves load between the axles, is left out
network     a single-track car with saturating tyres and lagging commands, and a neural network (two hidden layers of
            32, tanh) that adds to its three accelerations. Constants and network are trained together (Adam) on
            simulations of 1 s; every fifth block of 3 s is not fitted, and decides which iterate is kept
PySINDy     what the accelerations of the smoothed recordings have beyond those of the base model, by sparse regression
            (STLSQ) on polynomials of degree 2 in u, v, r and both commands. Of five thresholds the one is used whose
            simulations of the same blocks are best

What a fit spares matters. A first version spared the last fifth of each recording, with 1000 steps of Adam and a rate
of 3e-3. Its errors on the held-out recordings were known when the blocks took its place; the network's settings were
then chosen by its loss on the blocks. After 3 s the medians of the first version in circles, ramp and fast laps were
354, 2086 and 371 mm for the network, and 91, 1304 and 703 mm for PySINDy.

Equations: x ahead, y left, angles counter-clockwise, SI; u, v velocities of the centre of mass ahead and to the left,
r yaw rate, s steering command, T throttle, delta steering angle, l wheelbase.
"""

import abc
import argparse
import functools
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from snakejax import prepare_jax

prepare_jax()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pysindy  # noqa: E402

from snakejax import Case, Model, load_case, noise_of  # noqa: E402
from snakejax.commands.loading import load_models  # noqa: E402
from snakejax.commands.predicting import HORIZONS, LEAD  # noqa: E402
from snakejax.core.local_polynomials import local_cubics  # noqa: E402
from snakejax.dynamics.constants import GRAVITY  # noqa: E402
from snakejax.dynamics.constraints import Slipping, body_velocities  # noqa: E402
from snakejax.dynamics.model import no_traction  # noqa: E402
from snakejax.effects import library  # noqa: E402
from snakejax.estimation.multiple_shooting import SMOOTHING  # noqa: E402
from snakejax.estimation.prediction import (  # noqa: E402
    PredictionError,
    Predictions,
    predicted,
    prediction_errors,
    prediction_windows,
)
from snakejax.recording.continuous import LEAST_MOTION, continuous_parts, mean_speed  # noqa: E402
from snakejax.recording.run import Run  # noqa: E402
from snakejax.vehicles.car import Car  # noqa: E402

CAR = Path(__file__).resolve().parents[1] / "data" / "car"

STEP, SUBSTEPS = 0.02, 4
"""Grid of the train windows [s], and steps of the midpoint rule in it: stable for rates up to 400 1/s, which a tyre of
70 N/rad on each axle, B C D of the starting tyres, reaches at SLOW."""
SLOW = 0.35
"""Speed [m/s] below which the slip angle of the network's car is smoothed, so that SUBSTEPS are stable."""
LENGTH, STRIDE, HISTORY = 1.0, 0.5, 1.0
"""Length of a train window, time between two of them, and time of commands kept before one, ten usual lags [s]."""
BLOCK, FOLD = 3.0, 5
"""A train recording is cut into blocks of so many seconds, three windows long; the third of each FOLD chooses between
iterates and thresholds and is not fitted."""
CAUCHY = 2.385
"""Scale of Cauchy's loss for 95% efficiency (Holland and Welsch 1977), as in `explain`."""

THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Least weights of STLSQ, in units of the root mean square of the missing acceleration."""
RIDGE = 0.05
"""Penalty of STLSQ, the default of PySINDy."""
FASTEST = (20.0, 20.0, 200.0)
"""Accelerations [m/s^2, m/s^2, rad/s^2] of frames that are left out of the regression: twice what grip of 1 allows, and
the like about the yaw axis; there the car is carried or the cameras jump."""

HIDDEN, STEPS, BATCH, RATE, DECAY, EVERY = 32, 2000, 32, 1e-2, 1e-4, 50
"""The network: width, steps of Adam, windows in one, first learning rate, which falls to zero along a cosine, weight
decay, and steps between two looks at the spare windows. Rate and decay are those of {3e-3, 1e-2} and {1e-4, 1e-2} with
the least loss on the spare windows of `data/car`, in three trials of 1000 steps."""


class Peer(Slipping):
    """A car whose accelerations are a function of its velocities and of both commands."""

    @abc.abstractmethod
    def accelerations(self, board: Car, velocity: jax.Array, commands: jax.Array) -> jax.Array:
        """The rates (3,) of the velocities (u, v, r) under the commands (s, T)."""

    def rates(self, state, board, steered, twist, loads):
        """The time derivative of the state; the forces of the program's own tyres are not used."""
        u, v, r = state[3:6]
        commands = jnp.stack([steered.inputs["steer"].angle, steered.inputs["drive"].angle])
        moved = self.accelerations(board, jnp.stack([u, v, r]), commands)
        c, s = jnp.cos(state[2]), jnp.sin(state[2])
        return (u * c - v * s, u * s + v * c, r, moved[0], moved[1], moved[2])


def single_track(board: Car, velocity: jax.Array, delta, along, across) -> jax.Array:
    """The rates (3,) of (u, v, r) under the forces `along` and `across` each wheel, (front, rear) [N]."""
    u, v, r = velocity
    c, s = jnp.cos(delta), jnp.sin(delta)
    ahead, left = along[0] * c - across[0] * s, along[0] * s + across[0] * c
    yaw = board.front * left - board.rear * across[1]
    forces = (ahead + along[1]) / board.mass + v * r, (left + across[1]) / board.mass - u * r
    return jnp.stack([*forces, yaw / board.inertia])


def wheel_speeds(board: Car, velocity: jax.Array, delta):
    """Speeds along and across the front wheel, and along and across the rear one [m/s]."""
    u, v, r = velocity
    c, s, front = jnp.cos(delta), jnp.sin(delta), v + board.front * r
    return u * c + front * s, front * c - u * s, u, v - board.rear * r


class Published(Peer):
    """The model of the authors with their constants, SI.

        steering    delta = tanh curve of s - 0.027, another one to each side
        motor       F = (25.36 - 4.815 u) z / (1 + exp(-200 z)), z = T - 0.1638
        friction    1.266 tanh(7.666 u) + 0.7393 u - 0.1123 u^2
        in bends    (-0.1183 + 5.916 delta tanh(30 delta)) (0.7793 + 0.2262 (u - 0.5)) / (1 + exp(-40 (u - 0.3)))
        tyres       Y = -D N sin(C atan(B alpha)), alpha = atan2(across, along + exp(-3 along^2)), loads N at rest

    Both commands pass a first-order lag first. The constants are those of `model_parameters` in the file
    DART_dynamic_models.py of the public repository Lorenzo-Lyons/DART, rounded to four digits.
    """

    def accelerations(self, board: Car, velocity: jax.Array, commands: jax.Array) -> jax.Array:
        """The rates (3,) by the equations of the class."""
        u, q, z = velocity[0], commands[0] - 0.0270, commands[1] - 0.1638
        side = 0.5 * (jnp.tanh(30 * q) + 1)
        delta = side * 0.3658 * jnp.tanh(1.3929 * q) + (1 - side) * 0.5148 * jnp.tanh(1.0230 * q)
        motor = (25.358 - 4.8153 * u) * jax.nn.sigmoid(200 * z) * z
        friction = 1.2660 * jnp.tanh(7.6664 * u) + 0.7393 * u - 0.1123 * u**2
        bend = (-0.1183 + 5.9159 * delta * jnp.tanh(30 * delta)) * (0.7793 + 0.2262 * (u - 0.5))
        force = motor - friction - bend * jax.nn.sigmoid(40 * (u - 0.3))
        along_f, across_f, along_r, across_r = wheel_speeds(board, velocity, delta)
        slip = [jnp.arctan2(y, x + jnp.exp(-3 * x**2)) for x, y in ((along_f, across_f), (along_r, across_r))]
        Y_f = -0.8407 * 0.847 * GRAVITY * jnp.sin(0.8407 * jnp.arctan(8.5980 * slip[0]))
        Y_r = -0.8547 * 0.733 * GRAVITY * jnp.sin(0.9591 * jnp.arctan(11.549 * slip[1]))
        share = 0.847 / 1.580
        return single_track(board, velocity, delta, (share * force, (1 - share) * force), (Y_f, Y_r))

    @staticmethod
    def model() -> Model:
        """The whole model: masses and lengths as weighed and measured by the authors, lags, place of the markers."""
        # The inertia is that of a plate of the wheelbase by 0.08 m, as the authors take it.
        mass, length = 1.580, 0.1735
        rear = length * 0.847 / mass
        board = Car(mass=mass, inertia=mass * (length**2 + 0.08**2) / 12, front=length - rear, rear=rear)
        known = library(board)
        effects = {
            "steering_lag": known["steering_lag"](tau=0.1285),
            "drive_lag": known["drive_lag"](tau=0.0843),
            # The tracked point is 0.115 m ahead of the rear axle and 0.01 m to the right, turned by 7.7 mrad.
            "marker_offset": known["marker_offset"](mx=0.115 - rear, my=-0.01),
            "heading_offset": known["heading_offset"](h=-0.00769),
        }
        return Model(board, no_traction(), Published(), effects)


class Sparse(Peer):
    """The base model without slip, and a polynomial of degree 2 that is added to its accelerations.

        r = u tan(delta) / l, v = l_r r, delta and driving force F by `Car`
        u' = (F_r + F_f / cos(delta)) / (m + (m l_r^2 + I) tan(delta)^2 / l^2), r' and v' by the first line

    The state is (u, v, r): the polynomial also pulls v and r towards those of wheels without slip. `powers` (t, 5) of
    (u, v, r, s, T) over `scale`, within the `low` and `high` of the train frames; `weights` (t, 3).
    """

    scale: jax.Array
    low: jax.Array
    high: jax.Array
    powers: jax.Array
    weights: jax.Array

    def accelerations(self, board: Car, velocity: jax.Array, commands: jax.Array) -> jax.Array:
        """The rates (3,): those of the base and the polynomial."""
        variables = jnp.clip(jnp.concatenate([velocity, commands]), self.low, self.high) / self.scale
        return base_accelerations(board, velocity, commands) + self.terms(variables) @ self.weights

    def terms(self, variables: jax.Array) -> jax.Array:
        """The terms (t,) of the polynomial."""
        return jnp.prod(jnp.where(self.powers == 2, variables**2, jnp.where(self.powers == 1, variables, 1.0)), axis=1)


def base_accelerations(board: Car, velocity: jax.Array, commands: jax.Array) -> jax.Array:
    """The rates (3,) of the base model, by the equations of `Sparse`."""
    delta, length = board.steering_ratio * commands[0], board.front + board.rear
    force = board.driving_force(velocity[0], commands[1])
    bend = jnp.tan(delta) / length
    pulled = force * (1 - board.front_drive + board.front_drive / jnp.cos(delta))
    ahead = pulled / (board.mass + (board.mass * board.rear**2 + board.inertia) * bend**2)
    return jnp.stack([ahead, board.rear * bend * ahead, bend * ahead])


class Network(Peer):
    """A single-track car and a network that adds to its accelerations.

    `log` holds the logarithms of the trained constants: steering ratio, force gain, dead band, speed loss, stiffness B
    and grip D of both axles, and the lags of both commands. `scale` of (u, v, r, s, T) and `size` (3,) of the
    accelerations are root mean squares of the train frames.
    """

    log: jax.Array
    network: eqx.nn.MLP
    scale: jax.Array
    size: jax.Array

    @staticmethod
    def untrained(board: Car, scale: np.ndarray, size: np.ndarray, seed: int) -> "Network":
        """Constants of the case, tyres as a fit of the program starts with, and a network that adds nothing yet."""
        load = [float(board.load(wheelset)) * board.friction for wheelset in board.wheelsets]
        own = (board.steering_ratio, board.force_gain, board.dead_band, board.speed_loss)
        # B = 8 1/rad as in `starting_tyre`; the lags of servos and motors of this size are some 0.05 s.
        constants = np.array([*own, 8.0, 8.0, *load, 0.05, 0.05], float)
        network = eqx.nn.MLP(5, 3, HIDDEN, 2, activation=jnp.tanh, key=jax.random.key(seed))
        last = network.layers[-1]
        blank = (jnp.zeros_like(last.weight), jnp.zeros_like(last.bias))
        network = eqx.tree_at(lambda n: (n.layers[-1].weight, n.layers[-1].bias), network, blank)
        log = jnp.asarray(np.log(np.maximum(constants, 1e-3)))  # all are positive
        return Network(log, network, jnp.asarray(scale), jnp.asarray(size))

    @property
    def lags(self) -> jax.Array:
        """The time constants (2,) of both commands [s]."""
        return jnp.exp(self.log[8:])

    def accelerations(self, board: Car, velocity: jax.Array, commands: jax.Array) -> jax.Array:
        """The rates (3,): those of the single track, C = 1.4 as in `starting_tyre`, and of the network."""
        ratio, gain, band, loss, B_f, B_r, D_f, D_r = jnp.exp(self.log[:8])
        car = eqx.tree_at(
            lambda b: (b.steering_ratio, b.force_gain, b.dead_band, b.speed_loss), board, (ratio, gain, band, loss)
        )
        delta, force = ratio * commands[0], car.driving_force(velocity[0], commands[1])
        along_f, across_f, along_r, across_r = wheel_speeds(board, velocity, delta)
        slip_f, slip_r = (
            jnp.arctan(y / jnp.sqrt(x**2 + SLOW**2)) for x, y in ((along_f, across_f), (along_r, across_r))
        )
        Y = -D_f * jnp.sin(1.4 * jnp.arctan(B_f * slip_f)), -D_r * jnp.sin(1.4 * jnp.arctan(B_r * slip_r))
        X = board.front_drive * force, (1 - board.front_drive) * force
        more = self.network(jnp.concatenate([velocity, commands]) / self.scale) * self.size
        return single_track(board, velocity, delta, X, Y) + more

    def model(self, board: Car) -> Model:
        """The whole model with its lags."""
        known, (steer, drive) = library(board), np.asarray(self.lags)
        lags = {"steering_lag": known["steering_lag"](tau=steer), "drive_lag": known["drive_lag"](tau=drive)}
        return Model(board, no_traction(), self, lags)


class Windows(NamedTuple):
    """Train windows on a grid of STEP: `start` (w, 6), `pose` (w, n + 1, 3), and `commands` (w, h + n, 2), (s, T) in
    the middle of each step, those of HISTORY first."""

    start: jax.Array
    pose: jax.Array
    commands: jax.Array


class Frames(NamedTuple):
    """Frames of the train recordings: (u, v, r, s, T) as `variables` (f, 5), and the `rates` (f, 3) of u, v and r."""

    variables: np.ndarray
    rates: np.ndarray


def commands_at(run: Run, times: np.ndarray) -> np.ndarray:
    """Both commands (n, 2) of a run at `times` [s]."""
    at = jnp.asarray(times)
    return np.stack([np.asarray(jax.vmap(run.gait.signal(name).at)(at).angle) for name in ("steer", "drive")], axis=1)


TrainData = tuple[Frames, Windows, Windows]


def train_data(case: Case) -> TrainData:
    """Frames and windows to fit, and the spare windows, of the train recordings."""
    variables, rates = [], []
    cut: dict[bool, list[tuple[np.ndarray, ...]]] = {False: [], True: []}
    count, before = round(LENGTH / STEP), round(HISTORY / STEP)
    for run in case.recordings or case.runs:
        times, recorded = np.asarray(run.times), np.asarray(run.pose)
        if run.role != "train":
            continue
        block = (times - times[0]) // BLOCK
        for part in continuous_parts(times, recorded):
            if times[part[-1]] - times[part[0]] < LENGTH:
                continue
            pose, rate = local_cubics(times[part], recorded[part], SMOOTHING)
            state = body_velocities(pose, rate)
            moved = local_cubics(times[part], state[:, 3:], SMOOTHING)[1]
            own = (block[part] % FOLD != 2) & (np.hypot(state[:, 3], state[:, 4]) > LEAST_MOTION)
            own &= (np.abs(moved) < FASTEST).all(axis=1)
            variables.append(np.concatenate([state[:, 3:], commands_at(run, times[part])], axis=1)[own])
            rates.append(moved[own])
            for begin in np.arange(times[part[0]], times[part[-1]] - LENGTH, STRIDE):
                grid = begin + STEP * np.arange(count + 1)
                states = np.stack([np.interp(grid, times[part], column) for column in state.T], axis=1)
                one, two = (grid[[0, -1]] - times[0]) // BLOCK
                if one == two and mean_speed(grid, states[:, :3]) > LEAST_MOTION:
                    middles = begin + STEP * (np.arange(-before, count) + 0.5)
                    cut[bool(one % FOLD == 2)].append((states[0], states[:, :3], commands_at(run, middles)))
    fitted, spare = (stacked(cut[one]) for one in (False, True))
    return Frames(np.concatenate(variables), np.concatenate(rates)), fitted, spare


def stacked(rows: list[tuple[np.ndarray, ...]]) -> Windows:
    """The `Windows` of (start, pose, commands) each."""
    return Windows(*(jnp.asarray(np.array(part)) for part in zip(*rows, strict=True)))


def rolled(peer: Peer, board: Car, lags: jax.Array, windows: Windows) -> jax.Array:
    """The poses (w, n + 1, 3) that a peer with lagging commands simulates from the starts of `windows`."""
    stays, size = jnp.exp(-STEP / lags), STEP / SUBSTEPS

    def rates(y, commands):
        c, s = jnp.cos(y[2]), jnp.sin(y[2])
        place = jnp.stack([y[3] * c - y[4] * s, y[3] * s + y[4] * c, y[5]])
        return jnp.concatenate([place, peer.accelerations(board, y[3:], commands)])

    def step(y, commands):
        for _ in range(SUBSTEPS):
            middle = y + size / 2 * rates(y, commands)
            y = y + size * rates(middle, commands)
        return y, y[:3]

    def lag(acting, command):
        # What acts in the middle of a step, half of its change done.
        after = command + stays * (acting - command)
        return after, (acting + after) / 2

    def one(start, commands):
        _, acting = jax.lax.scan(lag, commands[0], commands)
        _, poses = jax.lax.scan(step, start, acting[-round(LENGTH / STEP) :])
        return jnp.concatenate([start[None, :3], poses])

    return jax.vmap(one)(windows.start, windows.commands)


def loss(peer: Peer, board: Car, lags: jax.Array, windows: Windows, noise: jax.Array) -> jax.Array:
    """Cauchy's loss of the mean squared error of each window, in multiples of the variance of the `noise` (3,)."""
    error = jnp.mean(((rolled(peer, board, lags, windows) - windows.pose) / noise) ** 2, axis=(1, 2))
    error = jnp.where(jnp.isfinite(error), error, 1e12)
    return jnp.mean(CAUCHY**2 * jnp.log1p(error / CAUCHY**2))


def adam(slope, weights, first, second, k):
    """The weights after step `k` of Adam, its usual factors 0.9 and 0.999 (Kingma and Ba 2015), and both moments."""
    length = jnp.sqrt(sum(jnp.sum(g**2) for g in jax.tree.leaves(slope)))
    slope = jax.tree.map(lambda g: jnp.where(jnp.isfinite(length), g / jnp.maximum(length, 1.0), 0.0), slope)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
    second = jax.tree.map(lambda n, g: 0.999 * n + 0.001 * g**2, second, slope)
    rate = RATE * 0.5 * (1 + jnp.cos(jnp.pi * k / STEPS))

    def move(w, m, n):
        return w - rate * m / (1 - 0.9 ** (k + 1)) / (jnp.sqrt(n / (1 - 0.999 ** (k + 1))) + 1e-8)

    return jax.tree.map(move, weights, first, second), first, second


def trained(case: Case, board: Car, data: TrainData, seed: int = 0) -> Model:
    """The network with the least loss on the spare windows, after each EVERY steps of Adam."""
    frames, fitted, spare = data
    noise = noise_of(case).channels
    scale, size = (np.sqrt(np.mean(part**2, axis=0)) for part in frames)
    peer = Network.untrained(board, scale, size, seed)
    moving, still = eqx.partition(peer, eqx.is_inexact_array)
    # The scales are no weights.
    frozen = (moving.scale, moving.size)

    def whole(weights):
        return eqx.tree_at(lambda p: (p.scale, p.size), eqx.combine(weights, still), frozen)

    def objective(weights, windows):
        one = whole(weights)
        squares = sum(jnp.sum(layer.weight**2) for layer in one.network.layers)
        return loss(one, board, one.lags, windows, noise) + DECAY * squares

    advance = eqx.filter_jit(lambda *at: adam(jax.grad(objective)(at[0], at[-1]), *at[:-1]))
    check = eqx.filter_jit(lambda weights, windows: loss(whole(weights), board, whole(weights).lags, windows, noise))
    rng, best = np.random.default_rng(seed), (float(check(moving, spare)), moving)
    first = second = jax.tree.map(jnp.zeros_like, moving)
    for k in range(STEPS):
        pick = rng.integers(0, len(fitted.start), BATCH)
        moving, first, second = advance(moving, first, second, jnp.asarray(k), Windows(*(p[pick] for p in fitted)))
        if (k + 1) % EVERY == 0 and (left := float(check(moving, spare))) < best[0]:
            best = left, moving
    left = float(check(best[1], fitted)), best[0]
    print("network: loss of the fitted windows {:.3g}, of the spare ones {:.3g}".format(*left), file=sys.stderr)
    return whole(best[1]).model(board)


def regressed(case: Case, board: Car, data: TrainData) -> Model:
    """The polynomial with the least loss on the spare windows among THRESHOLDS."""
    frames, _, spare = data
    noise = noise_of(case).channels
    base = jax.vmap(lambda v: base_accelerations(board, v[:3], v[3:]))(jnp.asarray(frames.variables))
    missing = frames.rates - np.asarray(base)
    scale, size = (np.sqrt(np.mean(part**2, axis=0)) for part in (frames.variables, missing))
    terms = pysindy.PolynomialLibrary(degree=2)
    columns = np.asarray(terms.fit([frames.variables / scale]).transform([frames.variables / scale])[0])
    ends = jnp.asarray(frames.variables.min(axis=0)), jnp.asarray(frames.variables.max(axis=0))
    none = jnp.full(2, 1e-4)  # commands without lag: a hundredth of a step
    best = None
    for threshold in THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=RIDGE)
        weights = np.asarray(optimizer.fit(columns, missing / size).coef_).T * size
        powers = jnp.asarray(np.asarray(terms.powers_))
        peer = Sparse(jnp.asarray(scale), *ends, powers, jnp.asarray(weights))
        left = float(loss(peer, board, none, spare, noise))
        if best is None or left < best[0]:
            best = left, peer
    assert best is not None
    kept = int((np.asarray(best[1].weights) != 0).sum())
    print(f"PySINDy: {kept} terms, loss of the spare windows {best[0]:.3g}", file=sys.stderr, flush=True)
    return Model(board, no_traction(), best[1])


def explained(case: Path, scratch: Path) -> Path:
    """The result of `snakejax explain` on a case."""
    result = scratch / "ours.json"
    subprocess.run(
        [sys.executable, "-m", "snakejax", "explain", str(case), "--json", str(result), "--quiet"], check=True
    )
    return result


def compared(case: Case, saved: dict[str, Model], names: list[str]) -> Predictions:
    """{group: {name: {horizon: error}}} of the held-out windows, of the predictors `names`."""
    held = [run for run in case.recordings or case.runs if run.role == "heldout"]
    windows = prediction_windows(held, LEAD, HORIZONS)
    data = functools.cache(lambda: train_data(case))
    ways: dict[str, Callable[[], Model]] = {
        "ours": lambda: saved["final"],
        "base": lambda: saved["base"],
        "published": Published.model,
        "network": lambda: trained(case, case.board, data()),
        "PySINDy": lambda: regressed(case, saved["base"].board, data()),
    }
    groups: dict[str, dict[str, dict[str, PredictionError]]] = {}
    for name in names or ways:
        model = ways[name]()
        for group, errors in prediction_errors(windows, predicted(model, windows), HORIZONS).items():
            groups.setdefault(group, {})[name] = errors
        print(f"{name}: done", file=sys.stderr, flush=True)
    return groups


def table(groups: Predictions) -> str:
    """The errors, and where ours does not have the least median."""
    lines, behind = [], []
    least: dict[str, int] = {name: 0 for models in groups.values() for name in models}
    for group, models in groups.items():
        columns = f"{'after':>6} {'position':>10} {'90%':>9} {'heading':>11} {'90%':>11} {'windows':>8}"
        lines += [group, f"  {'':10} {columns}"]
        for name, errors in models.items():
            for horizon, e in errors.items():
                lines.append(
                    f"  {name:10} {horizon:>4} s {1e3 * e.position:7.0f} mm {1e3 * e.position_90:6.0f} mm"
                    f" {1e3 * e.heading:6.0f} mrad {1e3 * e.heading_90:6.0f} mrad {e.windows:8}"
                )
        for horizon in next(iter(models.values())):
            for what, unit in (("position", "mm"), ("heading", "mrad")):
                medians = {name: 1e3 * getattr(errors[horizon], what) for name, errors in models.items()}
                least[min(medians, key=lambda name: medians[name])] += 1
                ahead = [f"{name} {m:.0f} {unit}" for name, m in medians.items() if m < medians.get("ours", 0.0)]
                if ahead:
                    told = f"{', '.join(ahead)}; ours {medians['ours']:.0f} {unit}"
                    behind.append(f"  {group}, {what} after {horizon} s: {told}")
    lines.append("Least median: " + ", ".join(f"{name} {count}" for name, count in least.items()))
    lines += ["Where ours is not ahead, the medians below its own:", *(behind or ["  none"])] if "ours" in least else []
    return "\n".join(lines) + "\n"


def main() -> None:
    """Fit the peers, predict, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", type=Path, nargs="?", default=CAR)
    parser.add_argument("--ours", type=Path, help="the JSON of `snakejax explain CASE` (default: run it)")
    parser.add_argument("--only", default="", help="names of predictors, separated by commas (default all)")
    parser.add_argument("--table", type=Path, help="write the table there too")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        saved = load_models(asked.ours or explained(asked.case, Path(scratch)))
    told = table(compared(load_case(asked.case), saved, [name for name in asked.only.split(",") if name]))
    print(told)
    if asked.table:
        asked.table.write_text(told, encoding="utf-8")


if __name__ == "__main__":
    main()
