"""The same board, tyre and gait in the package and in `oracles/full_equations.py`, which shares no code with it."""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from oracles import full_equations as full

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Force, Linkage, RollingForce
from snakejax.dynamics.signals import AbstractSignal, Joint, Sines, Tracked
from snakejax.dynamics.tyres import Pacejka, Rayleigh
from snakejax.simulation.integrate import Accuracy, Trajectory, simulate
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

TIGHT = Accuracy(rtol=1e-11, atol=1e-12, max_steps=400_000)


class Crab(Linkage):
    """A constant angle [rad] of each wheelset on top of its joint."""

    front: Scalar = param("rad", default=0.0)
    back: Scalar = param("rad", default=0.0)

    def steer(self, joint, wheelset):
        return joint._replace(angle=joint.angle + (self.front if wheelset.steering > 0 else self.back))


class Push(Force):
    """A world-frame force [N] and a yaw moment [N m], all constant."""

    east: Scalar = param("N", default=0.0)
    north: Scalar = param("N", default=0.0)
    yaw: Scalar = param("N m", default=0.0)

    def wrench(self, motion):
        return *motion.into_body(self.east, self.north), self.yaw


class Drag(RollingForce):
    """Viscous rolling resistance of each wheelset."""

    viscosity: Scalar = param("N s/m", low=0.0, default=0.0)

    def resistance(self, wheel, motion):
        return self.viscosity * wheel.rolling


class Given(AbstractSignal):
    """A joint with a constant acceleration, for states drawn at random."""

    angle: Scalar = param("rad")
    rate: Scalar = param("rad/s")
    acceleration: Scalar = param("rad/s^2")

    def at(self, t):
        rate = self.rate + self.acceleration * t
        return Joint(self.angle + (self.rate + rate) / 2 * t, rate, jnp.asarray(self.acceleration))


def board_of(reference: full.Board, creep: float = 1e-3) -> Board:
    """The package's board with the numbers of `reference`."""
    return Board(
        mass=reference.mass,
        rotor_inertia=reference.rotor_inertia,
        wheelset_inertia=reference.wheel_inertia,
        half_length=reference.half_length,
        inertia=reference.inertia,
        offset=reference.offset,
        creep_speed=creep,
    )


def gait_of(reference: full.Gait) -> Gait:
    """The package's gait under the controller (8) with the numbers of `reference`, but for its crab angle."""

    def tracked(sine: full.Sine) -> Tracked:
        command = Sines.of([[sine.amplitude, sine.frequency, sine.phase]])
        return Tracked(command, reference.stiffness, reference.damping)

    return Gait(phi=tracked(reference.steering), psi=tracked(reference.rotor))


def crabbed(gait: full.Gait, front: float, back: float) -> full.Gait:
    """`gait` with constant angles [rad] on top of the steering."""
    return replace(gait, crab=(front, back))


def push_of(east: float, north: float, yaw: float) -> Callable[..., full.Wrench]:
    """The reference's wrench of a constant world-frame force [N] and yaw moment [N m]."""

    def wrench(time, position, velocity):
        theta = position[full.THETA]
        cosine, sine = np.cos(theta), np.sin(theta)
        return full.Wrench(east * cosine + north * sine, north * cosine - east * sine, yaw)

    return wrench


PACEJKA = Pacejka(B=0.09, C=2.0, D=1.0, E=0.6)
"""Table II."""
TYRES = {
    "Pacejka": (PACEJKA, full.pacejka()),
    "Pacejka past its peak, with offsets": (
        Pacejka(B=4.0, C=1.6, D=2.0, E=-0.5, dSh=0.03, dSv=0.1),
        full.pacejka(4.0, 1.6, 2.0, -0.5, 0.03, 0.1),
    ),
    "Rayleigh": (Rayleigh(9.0), full.rayleigh(9.0)),
}
LOPSIDED = full.Board(mass=6.0, inertia=0.31, rotor_inertia=0.03, wheel_inertia=0.002, half_length=0.22, offset=0.04)
"""A board without the paper's symmetry: I is not m L^2 and the centre of mass is not in the middle."""


def table_2(
    tyre: Pacejka | Rayleigh, constraint: str = "coupled", creep: float = 1e-3, crab: tuple[float, float] = (0.0, 0.0)
) -> Model:
    """The board of Table II with the paper's I = m L^2."""
    return Model(Board(**TABLE_II, creep_speed=creep), tyre, constraint).add(crab=Crab(*crab))


simulate_compiled = eqx.filter_jit(simulate)


def run(model: Model, gait: Gait, times, start=(0.0, 0.0, 0.0), accuracy: Accuracy = TIGHT) -> Trajectory:
    """`simulate`, compiled once for each structure and number of times."""
    return simulate_compiled(model, gait, jnp.asarray(times), jnp.asarray(start), accuracy=accuracy)


def last_pose(model: Model, gait: full.Gait, duration: float) -> np.ndarray:
    """(x [m], y [m], heading [rad]) at the end of a run from rest."""
    return np.asarray(run(model, gait_of(gait), [0.0, duration]).pose[-1])


class Draw:
    """One random instant: a board, its joints, what acts on it and how it moves, for both sides."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.board = full.Board(
            mass=rng.uniform(0.5, 9.0),
            inertia=rng.uniform(0.1, 0.6),
            rotor_inertia=rng.uniform(0.0, 0.05),
            wheel_inertia=rng.uniform(0.0, 0.01),
            half_length=rng.uniform(0.1, 0.4),
            offset=rng.uniform(-0.05, 0.05),
        )
        self.steering = full.Steering(*rng.uniform(-1.2, 1.2, 2), *rng.uniform(-4.0, 4.0, 2))
        self.rotor = rng.uniform(-3.0, 3.0, 3)
        self.push = rng.uniform(-2.0, 2.0, 3)
        self.viscosity = rng.uniform(0.0, 3.0)
        self.pose = rng.uniform(-3.0, 3.0, 3)
        self.beta = rng.uniform(-1.0, 1.0)
        self.twist = rng.uniform(-1.5, 1.5, 3)

    @property
    def wrench(self) -> full.Wrench:
        """What the constant world-frame push is in the body frame."""
        return push_of(*self.push)(0.0, np.array([*self.pose, 0.0, 0.0, 0.0]), None)

    def model(self, tyre: Pacejka | Rayleigh, constraint: str) -> Model:
        """The package's board with every effect of this instant."""
        return Model(board_of(self.board), tyre, constraint).add(push=Push(*self.push), drag=Drag(self.viscosity))

    def gait(self) -> Gait:
        """Each wheelset and the rotor as drawn."""
        front, back, front_rate, back_rate = self.steering
        return Gait(Given(front, front_rate, 0.0), Given(*self.rotor), Given(back, back_rate, 0.0))

    def constrained(self, tyre: full.Tyre | None, structure: str) -> tuple[np.ndarray, np.ndarray]:
        """qdot and q'' from the 8-equation solve."""
        speed, _, spin = self.twist
        position = np.array([*self.pose, 0.0, 0.0, self.beta])
        velocity = full.starting_velocity(self.board, self.pose[2], self.steering, speed, spin, structure)
        velocity[full.PSI] = self.rotor[1]
        rolling = full.rolling_matrix(self.board, self.pose[2], self.steering) @ velocity
        instant = full.constrained_accelerations(
            self.board,
            tyre,
            position,
            velocity,
            self.steering,
            (self.rotor[2], 0.0),
            structure=structure,
            wrench=self.wrench,
            rolling_forces=tuple(self.viscosity * rolling),
        )
        return velocity, instant.acceleration


@eqx.filter_jit
def body_rates(model: Model, gait: Gait, body: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """The package's time derivative of the state of the skid structure."""
    return model.rates(jnp.zeros(()), (body, ()), gait)[0]


def rates_at(model: Model, gait: Gait, *body: float) -> np.ndarray:
    """`body_rates` as one array."""
    return np.array(body_rates(model, gait, tuple(jnp.float64(part) for part in body)))


def along_rate(theta: float, velocity: np.ndarray, acceleration: np.ndarray) -> float:
    """d/dt of the speed along theta [m/s^2] from the world velocity and acceleration."""
    axis, side = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    return axis @ acceleration[:2] + velocity[full.THETA] * (side @ velocity[:2])


DRAWS = range(200)
