"""Synthetic boards: random tyres and gaits, an effect if wanted, and the recording that motion capture would give."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax import (
    TABLE_II,
    Accuracy,
    Board,
    Case,
    Effect,
    Force,
    Gait,
    LateralForce,
    Model,
    Noise,
    Pacejka,
    Run,
    Scalar,
    Sines,
    Tracked,
    param,
    simulate,
)
from snakejax.dynamics.law import law
from snakejax.estimation.batch import stacked_gaits

NOISE = Noise(4e-4, 2.5e-3, "given")
SECONDS, RATE = 6.0, 100.0
TIMES = np.arange(int(SECONDS * RATE)) / RATE
TRAIN, HELDOUT = 3, 1
LONG_TIMES = np.arange(1200) / RATE
LONG_GAITS = {
    "train-forward-1": ([[0.9, 4.0, 0.0]], [[1.6, 4.0, 0.0]]),
    "train-forward-2": ([[0.9, 4.0, 0.0]], [[1.6, 4.0, 0.0]]),
    "train-rotate-1": ([[0.9, 2.0, 0.0]], [[1.6, 4.0, 0.0]]),
    "train-arc-1": ([[0.5, 3.0, 0.0], [0.25, 0.6, 0.0]], [[1.6, 3.0, 0.0]]),
    "train-wander-1": ([[0.5, 2.1, 0.0], [0.3, 3.7, 0.4]], [[1.2, 2.1, 0.2], [0.9, 4.3, 0.0]]),
    "heldout-reverse-1": ([[0.7, 3.0, 0.0]], [[1.4, 3.0, np.pi]]),
    "heldout-sweep-1": ([[0.4, 1.7, 0.3], [0.4, 2.9, 0.0]], [[1.0, 1.7, 0.0], [1.0, 2.9, 1.0]]),
}
"""Steering and rotor of the runs of `make_long`, each a sum of [amplitude in rad, rad/s, phase]."""
STRUCTURES = ("free", "coupled")


class Made(NamedTuple):
    """A board without an effect, the gait of each run, where each run starts (R, 3), when it is seen, and the names."""

    constraint: str
    model: Model
    gaits: tuple[Gait, ...]
    start: np.ndarray
    times: np.ndarray
    names: tuple[str, ...]


def make(seed: int, constraint: str) -> Made:
    """The board of number `seed`: tyres that slide at 1 to 5 N on each wheelset, three gaits to train on and another.

    Frequencies are 2 to 5 rad/s; one run has the rotor at twice the frequency of the steering, so that the board turns.
    """
    rng = np.random.default_rng([seed, STRUCTURES.index(constraint)])
    tyre = Pacejka(B=rng.uniform(5, 12), C=rng.uniform(1.2, 1.7), D=rng.uniform(1.0, 5.0), E=rng.uniform(-1.0, 0.6))
    gaits = []
    for k in range(TRAIN + HELDOUT):
        w = rng.uniform(2.0, 5.0) * (0.6 if k == 1 else 1.0)
        phi = [[rng.uniform(0.4, 0.9), w, rng.uniform(0, 0.5)], [rng.uniform(0, 0.15), 1.7 * w, rng.uniform(0, 6)]]
        turn = 2.0 if k == 1 else 1.0
        psi = [
            [rng.uniform(0.8, 1.6), turn * w, rng.uniform(0, 0.5)],
            [rng.uniform(0, 0.3), 0.7 * w, rng.uniform(0, 6)],
        ]
        gaits.append(Gait(*(Tracked(Sines.of(terms), kp=100.0, kd=10.0) for terms in (phi, psi))))
    start = np.column_stack([rng.uniform(-0.5, 0.5, (len(gaits), 2)), rng.uniform(-np.pi, np.pi, len(gaits))])
    names = tuple(f"{'train' if k < TRAIN else 'heldout'}-{k}" for k in range(TRAIN + HELDOUT))
    return Made(
        constraint, Model(Board(**TABLE_II, creep_speed=0.01), tyre, constraint), tuple(gaits), start, TIMES, names
    )


def make_long(seed: int, constraint: str) -> Made:
    """The board of number `seed` in five runs of 12 s to train on, which differ in kind, and two others."""
    rng = np.random.default_rng([seed, STRUCTURES.index(constraint), 12])
    tyre = Pacejka(B=rng.uniform(4, 10), C=rng.uniform(1.2, 1.6), D=rng.uniform(4.0, 9.0), E=rng.uniform(-0.3, 0.6))
    gaits = [Gait(*(Tracked(Sines.of(terms), kp=100.0, kd=10.0) for terms in pair)) for pair in LONG_GAITS.values()]
    start = np.column_stack([rng.uniform(-0.5, 0.5, (len(gaits), 2)), rng.uniform(-0.5, 0.5, len(gaits))])
    model = Model(Board(**TABLE_II, creep_speed=0.01), tyre, constraint)
    return Made(constraint, model, tuple(gaits), start, LONG_TIMES, tuple(LONG_GAITS))


@eqx.filter_jit
def _poses(model: Model, gaits: Gait, start, times):
    accuracy = Accuracy(rtol=1e-9, atol=1e-10)
    return jax.lax.map(lambda one: simulate(model, one[0], times, one[1], accuracy=accuracy).pose, (gaits, start))


def case(made: Made, seed: int | None = None, declared: str | None = None, **effects: Effect) -> Case:
    """What was seen of the board with `effects`, under the noise of `seed` (None: without noise), as a case.

    It says of the board that its skid is `declared`, or what it is.
    """
    gaits = stacked_gaits(made.gaits, made.times[-1])
    poses = np.asarray(_poses(made.model.add(**effects), gaits, jnp.asarray(made.start), jnp.asarray(made.times)))
    if seed is not None:
        poses = poses + np.random.default_rng(seed).normal(size=poses.shape) * np.asarray(NOISE.channels)
    runs = tuple(
        Run(name, name.split("-")[0], jnp.asarray(made.times), jnp.asarray(pose), gait)
        for name, pose, gait in zip(made.names, poses, made.gaits, strict=True)
    )
    return Case("made", "a board made up", declared or made.constraint, made.model.board, runs, NOISE)


class Spring(Force):
    """A spring of k to the point (0.6, -0.7) m."""

    k: Scalar = param("N/m", default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(self.k * (0.6 - motion.x), self.k * (-0.7 - motion.y))
        return X, Y, jnp.zeros_like(X)


class Carpet(Force):
    """A drag c of the body that comes in smoothly where x is above 0.3 m."""

    c: Scalar = param("N s/m", default=0.0)

    def wrench(self, motion):
        drag = self.c * 0.5 * (1 + jnp.tanh((motion.x - 0.3) / 0.2))
        return -drag * motion.u, -drag * motion.w, jnp.zeros_like(motion.u)


class Compass(Force):
    """A yaw moment of n that turns the board towards the heading 0.8 rad."""

    n: Scalar = param("N m", default=0.0)

    def wrench(self, motion):
        zero = jnp.zeros_like(motion.theta)
        return zero, zero, -self.n * jnp.sin(motion.theta - 0.8)


class Fading(LateralForce):
    """A grip that is less by some part of the share g."""

    g: Scalar = param("-", default=0.0)

    @abc.abstractmethod
    def part(self, motion):
        """How much of g is missing."""

    def lateral(self, force, wheel, motion):
        return force * (1 - self.g * self.part(motion))


class Warming(Fading):
    """A grip that falls with time, by up to the share g, within 6 s."""

    def part(self, motion):
        return jnp.tanh(motion.time / 6)


class RotorShake(Fading):
    """A grip that falls with the rate of the rotor, by up to the share g."""

    def part(self, motion):
        return jnp.tanh((motion.rotor.rate / 4) ** 2)


class SteeringDrag(Force):
    """A force of c N/rad^2 backwards with the square of the steering angle."""

    c: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        X = -self.c * motion.steering.angle**2
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


class Patch(Fading):
    """A grip that is less by the share g where y is above 0.1 m."""

    def part(self, motion):
        return 0.5 * (1 + jnp.tanh((motion.y - 0.1) / 0.15))


class Pile(Fading):
    """A grip that depends on the heading as that of a carpet whose pile lies along 0.3 rad: by up to the share g."""

    def part(self, motion):
        return jnp.cos(motion.theta - 0.3)


class FastGrip(Fading):
    """A grip that falls with the speed of the board, by up to the share g."""

    def part(self, motion):
        return jnp.tanh((motion.u**2 + motion.w**2) / 0.3**2)


class SteeringGrip(Fading):
    """A grip that falls with the steering angle, by up to the share g."""

    def part(self, motion):
        return jnp.tanh((motion.steering.angle / 0.5) ** 2)


class Cable(Force):
    """A yaw moment of k N m/rad against the angle of the rotor: a cable that is wound up."""

    k: Scalar = param("N m/rad", default=0.0)

    def wrench(self, motion):
        zero = jnp.zeros_like(motion.theta)
        return zero, zero, -self.k * motion.rotor.angle


class Kick(Force):
    """A force of c N s^2 forwards with the square of the steering rate."""

    c: Scalar = param("N s^2/rad^2", default=0.0)

    def wrench(self, motion):
        X = self.c * motion.steering.rate**2
        return X, jnp.zeros_like(X), jnp.zeros_like(X)


STRANGERS = {
    "spring": (Spring(0.15), "world_position"),
    "carpet": (Carpet(1.5), "world_position"),
    "compass": (Compass(0.03), "heading"),
    "warming": (Warming(0.35), "time"),
    "rotor_shake": (RotorShake(0.35), "rotor_rate"),
    "steering_drag": (SteeringDrag(1.0), "steering_angle"),
    "patch": (Patch(0.4), "world_position"),
    "pile": (Pile(0.3), "heading"),
    "fast_grip": (FastGrip(0.4), "speed"),
    "steering_grip": (SteeringGrip(0.3), "steering_angle"),
    "cable": (Cable(0.01), "rotor_angle"),
    "kick": (Kick(0.05), "steering_rate"),
}
"""Effects that no library holds, and the variable on which each depends."""


def _law(expression: str, **parameters: tuple[float, str]) -> Effect:
    """A law as text, with the value and the unit of each parameter."""
    units = {name: unit for name, (_, unit) in parameters.items()}
    return law(expression, units, {name: value for name, (value, _) in parameters.items()})


_MOUND = "exp(-((x - 0.4) ** 2 + (y - 0.1) ** 2) / 0.3 ** 2)"
_STICKING = "(1 + exp(-(speed / 0.1) ** 2))"
MORE_STRANGERS = {
    "washboard": (_law("east = a * sin(9 * x)", a=(0.3, "N")), "world_position"),
    "across": (_law("X = -c * r * w; Y = c * r * u", c=(1.0, "N s^2/(m rad)")), "yaw_rate"),
    "rotor_grip": (_law("grip = 1 - a * abs(rotor_rate)", a=(0.05, "s/rad")), "rotor_rate"),
    "dead_spot": (_law("N = -a * exp(-((rotor_angle - 0.5) / 0.3) ** 2)", a=(0.02, "N m")), "rotor_angle"),
    "mound": (_law(f"X = -a * u * {_MOUND}; Y = -a * w * {_MOUND}", a=(4.0, "N s/m")), "world_position"),
    "groove": (_law("north = -k * (y - y0)", k=(0.3, "N/m"), y0=(0.2, "m")), "world_position"),
    "rope": (_law("N = -k * (rotor_angle + steering_angle)", k=(0.01, "N m/rad")), "rotor_angle"),
    "tilting_wind": (_law("east = a * sin(0.8 * time); north = a * cos(0.8 * time)", a=(0.15, "N")), "time"),
    "stick_slip": (
        _law(f"X = -a * tanh(u / 0.05) * {_STICKING}; Y = -a * tanh(w / 0.05) * {_STICKING}", a=(0.15, "N")),
        "speed",
    ),
    "twist": (_law("N = a * steering_rate", a=(0.01, "N m s/rad")), "steering_rate"),
    "lift": (_law("grip = 1 - a * cos(2 * heading)", a=(0.3, "-")), "heading"),
    "pull": (_law("X = a * steering_angle * rotor_angle", a=(0.3, "N/rad^2")), "steering_angle"),
}
"""Twelve more, as laws that a formula gives."""
