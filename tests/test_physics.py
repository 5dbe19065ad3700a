"""The package against an independent solution of the full equations, conservation laws, symmetries and derivatives.

Equation, table and section numbers are those of the paper (Salman et al., CDC 2016); P1 is its rotate result. The
independent side is `systems/full_equations.py`, which shares no code with the package.
"""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from systems import full_equations as full

from snakejax._board import TABLE_II, Board
from snakejax._effect import Force, Linkage, Rolling
from snakejax._gait import AbstractSignal, Gait, Joint, Sines, Tracked
from snakejax._model import Model, no_traction
from snakejax._simulate import Accuracy, Trajectory, motions, simulate
from snakejax._tyre import Bakker, Pacejka, Rayleigh
from snakejax._units import Scalar, param
from snakejax.effects import ClockOffset, YawBias

TIGHT = Accuracy(rtol=1e-11, atol=1e-12, max_steps=400_000)
STEPPED = Accuracy(step=0.005)

# --- The same board, tyre and gait on both sides -------------------------------------------------------------------


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


class Drag(Rolling):
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
    tyre: Pacejka | Rayleigh, skid: str = "coupled", creep: float = 1e-3, crab: tuple[float, float] = (0.0, 0.0)
) -> Model:
    """The board of Table II with the paper's I = m L^2."""
    return Model(Board(**TABLE_II, creep_speed=creep), tyre, skid).add(crab=Crab(*crab))


simulate_compiled = eqx.filter_jit(simulate)


def run(model: Model, gait: Gait, times, start=(0.0, 0.0, 0.0), accuracy: Accuracy = TIGHT) -> Trajectory:
    """`simulate`, compiled once for each structure and number of times."""
    return simulate_compiled(model, gait, jnp.asarray(times), jnp.asarray(start), accuracy=accuracy)


def last_pose(model: Model, gait: full.Gait, duration: float) -> np.ndarray:
    """(x [m], y [m], heading [rad]) at the end of a run from rest."""
    return np.asarray(run(model, gait_of(gait), [0.0, duration]).pose[-1])


# --- The full equations ----------------------------------------------------------------------------------------------


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

    def model(self, tyre: Pacejka | Rayleigh, skid: str) -> Model:
        """The package's board with every effect of this instant."""
        return Model(board_of(self.board), tyre, skid).add(push=Push(*self.push), drag=Drag(self.viscosity))

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
close = {"rtol": 1e-10, "atol": 1e-10}


@pytest.mark.parametrize("tyre", TYRES)
def test_coupled_accelerations_are_those_of_the_full_equations(tyre):
    """Section II (2)-(4) with traction on beta, steering angles of any size on the two wheelsets."""
    ours, theirs = TYRES[tyre]
    for seed in DRAWS:
        draw = Draw(seed)
        velocity, acceleration = draw.constrained(theirs, "coupled")
        speed, _, spin = draw.twist
        rates = rates_at(draw.model(ours, "coupled"), draw.gait(), *draw.pose, draw.beta, speed, spin)
        np.testing.assert_allclose(rates[:4], velocity[[full.X, full.Y, full.THETA, full.BETA]], **close)
        np.testing.assert_allclose(rates[4], along_rate(draw.pose[2], velocity, acceleration), **close)
        np.testing.assert_allclose(rates[5], acceleration[full.THETA] + acceleration[full.BETA], **close)


def test_ideal_accelerations_are_those_of_the_full_equations():
    """The constraints (3) and betadot = 0."""
    for seed in DRAWS:
        draw = Draw(seed)
        velocity, acceleration = draw.constrained(None, "ideal")
        rates = rates_at(draw.model(no_traction(), "ideal"), draw.gait(), *draw.pose, draw.twist[0])
        np.testing.assert_allclose(rates[:3], velocity[[full.X, full.Y, full.THETA]], **close)
        np.testing.assert_allclose(rates[3], along_rate(draw.pose[2], velocity, acceleration), **close)


def test_printed_accelerations_are_those_of_the_full_equations():
    """Equation (4) to the letter, with F_1 = F_2 on the reference's side: the multipliers absorb the difference.

    As in the paper, the centre of mass is in the middle and nothing resists rolling.
    """
    for seed in DRAWS:
        draw = Draw(seed)
        draw.viscosity, draw.board = 0.0, replace(draw.board, offset=0.0)
        velocity, acceleration = draw.constrained(full.printed_pacejka(), "printed")
        rows = [full.X, full.Y, full.THETA, full.BETA]
        state = (*draw.pose, draw.beta, *velocity[rows])
        rates = rates_at(draw.model(PACEJKA, "printed"), draw.gait(), *state)
        np.testing.assert_allclose(rates[4:], acceleration[rows], **close)


@pytest.mark.parametrize("tyre", TYRES)
def test_free_accelerations_are_those_of_newtons_law(tyre):
    """Two points of a rigid body pushed by the floor, in the world frame."""
    ours, theirs = TYRES[tyre]
    for seed in DRAWS:
        draw = Draw(seed)
        theta, (u, w, r) = draw.pose[2], draw.twist
        axis, side = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
        velocity = np.array([*(u * axis + w * side), r])
        rolling = full.rolling_matrix(draw.board, theta, draw.steering)[:, :3] @ velocity
        acceleration = full.free_accelerations(
            draw.board,
            theirs,
            theta,
            velocity,
            draw.steering,
            draw.rotor[2],
            wrench=draw.wrench,
            rolling_forces=tuple(draw.viscosity * rolling),
        )
        rates = rates_at(draw.model(ours, "free"), draw.gait(), *draw.pose, u, w, r)
        np.testing.assert_allclose(rates[:3], velocity, **close)
        np.testing.assert_allclose(rates[3] - r * w, axis @ acceleration[:2], **close)
        np.testing.assert_allclose(rates[4] + r * u, side @ acceleration[:2], **close)
        np.testing.assert_allclose(rates[5], acceleration[2], **close)


RUNS = [(skid, tyre) for skid in ("coupled", "free") for tyre in TYRES] + [("ideal", None)]


@pytest.mark.slow
@pytest.mark.parametrize(("skid", "tyre"), RUNS)
def test_runs_follow_the_full_equations(skid, tyre):
    """10 s of a lopsided board that is pushed, rolls heavily and steers its wheelsets unequally: to 1e-7 m and rad."""
    ours, theirs = (no_traction(), None) if tyre is None else TYRES[tyre]
    gait, push, viscosity, pose = crabbed(full.FORWARD, 0.12, -0.05), (0.02, -0.03, 0.01), 0.05, (0.3, -0.2, 0.5)
    model = Model(board_of(LOPSIDED), ours, skid)
    model = model.add(crab=Crab(*gait.crab), push=Push(*push), drag=Drag(viscosity))
    times = np.linspace(0.0, 10.0, 21)
    reference = full.integrate(
        LOPSIDED,
        theirs,
        gait,
        times,
        structure=skid,
        wrench=push_of(*push),
        rolling_force=lambda speed: viscosity * speed,
        pose=pose,
    )
    trajectory = run(model, gait_of(gait), times, pose)
    np.testing.assert_allclose(trajectory.pose, reference.pose.T, rtol=0.0, atol=1e-7)


# --- Check values ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("skid", "tyre", "heading"),
    [
        ("coupled", PACEJKA, 0.919),
        ("coupled", Rayleigh(9.0), 1.003),
        ("free", PACEJKA, 2.076),
        ("free", Rayleigh(9.0), 1.294),
        ("ideal", no_traction(), 1.684),
    ],
    ids=["coupled Pacejka", "coupled Rayleigh", "free Pacejka", "free Rayleigh", "ideal"],
)
def test_rotate_turns_as_far_as_the_paper_and_the_reference_say(skid, tyre, heading):
    """P1: Table II and the rotate gait for 14 s; the paper reads about 0.95 rad for both of its models."""
    assert last_pose(table_2(tyre, skid, creep=1e-4), full.ROTATE, 14.0)[2] == pytest.approx(heading, abs=0.002)


@pytest.mark.parametrize(
    ("gait", "duration", "pose"),
    [
        (full.ROTATE, 14.0, (0.013834, 0.004189, 0.98778)),
        (full.FORWARD, 7.7, (0.031363, 0.004788, 0.03946)),
    ],
    ids=["rotate", "forward"],
)
def test_crab_angle_check_values(gait, duration, pose):
    """Rayleigh with k_s = 9 and both wheelsets turned by a further 0.1 rad."""
    model = table_2(Rayleigh(9.0), crab=(0.1, 0.1))
    np.testing.assert_allclose(last_pose(model, gait, duration), pose, atol=6e-6)


@pytest.mark.parametrize(("load", "force"), [(2.0, 1722.54), (4.0, 3096.61), (6.0, 3833.10)])
def test_bakker_check_values(load, force):
    """SAE 870421 at 4 degrees of slip and no camber; load in kN, force in N."""
    slip, lateral = jnp.deg2rad(4.0), jnp.array(0.1)
    assert float(Bakker(1000.0 * load).force(slip, lateral)) == pytest.approx(force, abs=0.005)


@pytest.mark.parametrize(("load", "slip", "camber"), [(2.0, 7.0, 3.0), (0.0025, -2.0, 30.0), (5.0, 12.0, -5.0)])
def test_bakker_under_camber(load, slip, camber):
    """Against the same formulas in kN and degrees; the second is a robot's load."""
    tyre = Bakker(1000.0 * load, jnp.deg2rad(camber))
    force = float(tyre.force(jnp.deg2rad(slip), jnp.array(0.1)))
    assert force == pytest.approx(full.bakker_force(load, slip, camber), rel=1e-12)


# --- The printed equations -------------------------------------------------------------------------------------------


def test_printed_equations_do_not_depend_on_the_tyre():
    """The multipliers of (4) absorb F: dx/dB = dx/dC = dx/dD = dx/dE = 0 along a run of a board under way."""
    gait, times = gait_of(full.FORWARD), jnp.linspace(0.0, 4.0, 5)

    def pose(coefficients):
        model = table_2(Pacejka(*coefficients), "printed")
        accuracy = Accuracy(step=0.005, derivative="forward")
        return simulate(model, gait, times, (0.0, 0.0, 0.2, 0.3, 0.0, 0.5), accuracy=accuracy).pose

    coefficients = jnp.array([0.09, 2.0, 1.0, 0.6])
    sensitivity = jax.jit(jax.jacfwd(pose))(coefficients)
    assert jnp.ptp(pose(coefficients)[:, 0]) > 0.1
    np.testing.assert_allclose(sensitivity, 0.0, atol=1e-12)


def test_printed_equations_never_leave_their_place_from_rest():
    """theta + beta swings against the rotor, I s = -J_r psi', and nothing else happens."""
    times = jnp.linspace(0.0, 7.7, 40)
    model, gait = table_2(PACEJKA, "printed"), gait_of(full.FORWARD)
    trajectory = run(model, gait, times)
    swing = -0.0238 * jax.vmap(gait.psi.at)(times).angle / 0.4375
    np.testing.assert_allclose(trajectory.pose[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(trajectory.pose[:, 2], swing, atol=1e-9)


def test_stiff_rayleigh_tends_to_the_ideal_board():
    """Hard constraints are the limit of R = k_s v^2 / 2 (paper, eq. 1), with an error that falls as 1 / k_s."""
    ideal = last_pose(table_2(no_traction(), "ideal"), full.FORWARD, 5.0)
    stiffnesses = np.array([2000.0, 4000.0, 8000.0])
    poses = [last_pose(table_2(Rayleigh(k)), full.FORWARD, 5.0) for k in stiffnesses]
    errors = np.linalg.norm(poses - ideal, axis=1)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.05)


# --- Energy and momentum ---------------------------------------------------------------------------------------------


def kinetic_energy(model: Model, gait: Gait, t: Scalar, body: tuple[Scalar, ...]) -> Scalar:
    """qdot^T M qdot / 2 [J] with the mass matrix (2); the motion's r is thetadot + betadot."""
    motion = model.motion(t, body, gait)
    board, spin, rotor, steering = motion.board, motion.r, motion.rotor.rate, motion.steering.rate
    turning = board.total_inertia * spin**2 + board.rotor_inertia * (2 * spin * rotor + rotor**2)
    steered = 2 * board.wheelset_inertia * steering**2
    return (board.mass * (motion.u**2 + motion.w**2) + turning + steered) / 2


@eqx.filter_jit
def power_balance(model: Model, gait: Gait, t: Scalar, body: tuple[Scalar, ...]) -> tuple[Scalar, Scalar]:
    """Rate of change of the kinetic energy along the motion, and the power -sum F_i v_i of traction [W]."""
    motion = model.motion(t, body, gait)
    forces = model.traction(motion, ())
    traction = -sum(F * wheel.lateral for F, wheel in zip(forces, motion.wheels, strict=True))
    rates = model.rates(t, (body, ()), gait)[0]
    _, gain = jax.jvp(lambda t, body: kinetic_energy(model, gait, t, body), (t, body), (jnp.ones(()), rates))
    return gain, traction


PACEJKA_DOMAIN = [(0.05, 30.0), (0.1, 2.0), (0.0, 20.0), (-5.0, 1.0)]
"""Ranges of B, C, D and E within which the force never reverses."""


@pytest.mark.parametrize("skid", ["coupled", "free"])
@pytest.mark.parametrize("law", ["Pacejka", "Rayleigh", "Bakker"])
def test_traction_never_feeds_energy_in(law, skid):
    """With no offsets, at any speed, forwards and backwards: what a board with a still rotor loses, traction takes."""
    for seed in DRAWS:
        draw, rng = Draw(seed), np.random.default_rng(1000 + seed)
        tyre = {
            "Pacejka": Pacejka(*(float(rng.uniform(low, high)) for low, high in PACEJKA_DOMAIN)),
            "Rayleigh": Rayleigh(rng.uniform(0.0, 100.0)),
            "Bakker": Bakker(rng.uniform(1.0, 6000.0), rng.uniform(-0.5, 0.5), offsets=False),
        }[law]
        still = Gait(draw.gait().phi, Given(0.3, 0.0, 0.0), draw.gait().phi_back)
        body = (*draw.pose, draw.beta, *draw.twist[::2]) if skid == "coupled" else (*draw.pose, *draw.twist)
        model = Model(board_of(draw.board), tyre, skid)
        gain, traction = power_balance(model, still, jnp.zeros(()), tuple(jnp.float64(part) for part in body))
        assert traction <= 0.0
        np.testing.assert_allclose(gain, traction, rtol=1e-9, atol=1e-9)


def gauss_nodes(duration: float, panels: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and weights of composite Gauss-Legendre quadrature with 6 nodes a panel."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    width = duration / panels
    left = width * np.arange(panels)[:, None]
    return (left + width * (nodes + 1) / 2).ravel(), np.tile(width / 2 * weights, panels)


@pytest.mark.parametrize("tyre", ["Pacejka", "Rayleigh"])
@pytest.mark.parametrize("skid", ["coupled", "free"])
def test_work_of_the_joints_becomes_motion_and_slip(skid, tyre):
    """Kinetic energy gained + energy lost in slip = work of the torques that the full equations ask of the joints."""
    ours, theirs = TYRES[tyre]
    reference = full.integrate(
        full.TABLE_2_BOARD, theirs, full.FORWARD, np.array([0.0, 10.0]), structure=skid, max_step=0.01
    )
    nodes, weights = gauss_nodes(10.0, 500)
    model, gait = table_2(ours, skid), gait_of(full.FORWARD)
    trajectory = run(model, gait, [*nodes, 10.0])
    motion, forces = motions(model, gait, trajectory)
    power = sum(F * wheel.lateral for F, wheel in zip(forces, motion.wheels, strict=True))
    lost = weights @ np.asarray(power[:-1])
    last = tuple(part[-1] for part in trajectory.state[0])
    gained = kinetic_energy(model, gait, jnp.array(10.0), last)
    assert lost > 0.01
    np.testing.assert_allclose(gained + lost, reference.joint_work[-1], rtol=1e-6)


@pytest.mark.parametrize("skid", ["coupled", "free"])
def test_momentum_is_conserved_without_traction(skid):
    """D = 0: I s + J_r psi' stays as it was, and so does m v where no wheel holds the board."""
    model, gait = table_2(no_traction(), skid), gait_of(full.FORWARD)
    start = (0.1, -0.2, 0.3, 0.4, 0.0 if skid == "coupled" else -0.1, 0.5)
    motion, _ = motions(model, gait, run(model, gait, jnp.linspace(0.0, 10.0, 30), start))
    board = model.board
    spin = board.total_inertia * motion.r + board.rotor_inertia * motion.rotor.rate
    np.testing.assert_allclose(spin, 0.4375 * 0.5, rtol=1e-9)
    if skid == "free":
        cosine, sine = np.cos(motion.theta), np.sin(motion.theta)
        momentum = 7.0 * np.array([motion.u * cosine - motion.w * sine, motion.u * sine + motion.w * cosine])
        np.testing.assert_allclose(momentum, momentum[:, :1] * np.ones(30), rtol=1e-9)


# --- Symmetries ------------------------------------------------------------------------------------------------------

SKIDS = ["coupled", "free", "ideal"]
TIMES = jnp.linspace(0.0, 10.0, 11)


def test_a_long_recording_may_take_more_steps():
    """What is asked for at 1000 times is not refused for the limit of a run of a few samples."""
    model, gait = table_2(PACEJKA, "free"), gait_of(full.FORWARD)
    few = Accuracy(max_steps=10)
    assert not bool(simulate(model, gait, jnp.linspace(0.0, 1.0, 3), accuracy=few, throw=False).finished)
    assert bool(simulate(model, gait, jnp.linspace(0.0, 1.0, 1000), accuracy=few, throw=False).finished)


@pytest.mark.parametrize("skid", SKIDS)
def test_a_run_may_start_anywhere(skid):
    """Translating and turning the start translates and turns the run."""
    model, gait = table_2(PACEJKA, skid, crab=(0.1, 0.03)), gait_of(full.FORWARD)
    here = run(model, gait, TIMES, accuracy=STEPPED).pose
    x, y, turn = 3.0, -2.0, 2.5
    there = run(model, gait, TIMES, (x, y, turn), STEPPED).pose
    cosine, sine = np.cos(turn), np.sin(turn)
    moved = np.stack(
        [x + cosine * here[:, 0] - sine * here[:, 1], y + sine * here[:, 0] + cosine * here[:, 1], turn + here[:, 2]],
        axis=1,
    )
    np.testing.assert_allclose(there, moved, atol=1e-11)


@pytest.mark.parametrize("skid", SKIDS)
def test_a_mirrored_gait_gives_a_mirrored_run(skid):
    """Joints, crab angles, start and tyre offsets mirrored at the x axis."""
    gait = full.FORWARD
    flipped = replace(
        gait,
        rotor=replace(gait.rotor, amplitude=-gait.rotor.amplitude),
        steering=replace(gait.steering, amplitude=-gait.steering.amplitude),
    )
    left, right = (
        run(
            table_2(Pacejka(0.09, 2.0, 1.0, 0.6, side * 0.02, side * 0.01), skid, crab=(side * 0.1, side * 0.03)),
            gait_of(gait if side > 0 else flipped),
            TIMES,
            (0.0, side * 0.5, side * 0.4),
            STEPPED,
        ).pose
        for side in (1.0, -1.0)
    )
    assert np.ptp(left[:, 1]) > 1e-3
    np.testing.assert_allclose(left, right * jnp.array([[1.0, -1.0, -1.0]]), atol=1e-11)


# --- Derivatives -----------------------------------------------------------------------------------------------------

EIGHTH_ORDER = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Weights of the antisymmetric central difference with an error of the 8th order in the step."""


def differentiable(tyre: Pacejka, skid: str, drive: float, start: tuple[float, ...]):
    """A run of 10 s in fixed steps: its parameters and its start as one vector, and the last pose as a function of it.

    The parameters are every number of the board, the tyre, three effects and the rotate gait; at `drive` 0 the joints
    stay still and nothing pushes.
    """
    model = Model(board_of(full.TABLE_2_BOARD), tyre, skid)
    model = model.add(crab=Crab(0.1, 0.05), push=Push(0.02 * drive, -0.01 * drive, 0.01 * drive), drag=Drag(0.02))
    gait = gait_of(full.Gait(rotor=full.Sine(1.570 * drive, 4.0), steering=full.Sine(0.916 * drive, 2.0)))
    leaves, rest = eqx.partition((model, gait, jnp.array(start)), eqx.is_inexact_array)
    vector, unravel = ravel_pytree(leaves)

    def pose(vector):
        model, gait, start = eqx.combine(unravel(vector), rest)
        return simulate(model, gait, jnp.array([0.0, 10.0]), start, accuracy=Accuracy(step=0.01)).pose[-1]

    return vector, pose


@pytest.mark.slow
@pytest.mark.parametrize(
    ("skid", "tyre"), [("coupled", PACEJKA), ("free", PACEJKA), ("ideal", no_traction())], ids=SKIDS
)
def test_gradients_of_a_run(skid, tyre):
    """Against finite differences in every parameter and the start; and finite at rest and when rolling backwards.

    With fixed steps the discrete run is as smooth as the equations. At rest the joints never move, and nothing may
    divide by the speed.
    """
    vector, pose = differentiable(tyre, skid, 1.0, (0.1, 0.2, 0.3, 0.02, 0.03, 0.04))
    jacobian_at = jax.jit(jax.jacrev(pose))
    jacobian = jacobian_at(vector)
    steps = 1e-4 * np.where(vector == 0.0, 0.3, np.abs(vector))
    offsets = [sign * k for k in EIGHTH_ORDER for sign in (1, -1)]
    weights = [sign * weight for weight in EIGHTH_ORDER.values() for sign in (1, -1)]
    moved = np.asarray(vector) + np.multiply.outer(offsets, np.diag(steps))
    poses = jax.jit(jax.vmap(pose))(jnp.asarray(moved.reshape(-1, vector.size)))
    differences = np.tensordot(weights, poses.reshape(*moved.shape[:2], 3), axes=1) / steps[:, None]
    scale = np.abs(jacobian).max(axis=0)
    errors = np.abs(jacobian - differences.T) / np.where(scale > 0.0, scale, 1.0)
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)

    for drive, start in ((0.0, (0.0,) * 6), (1.0, (0.0, 0.0, 0.0, -0.4, 0.0, 0.2))):
        elsewhere, _ = differentiable(tyre, skid, drive, start)
        assert jnp.isfinite(jacobian_at(elsewhere)).all()


@pytest.mark.parametrize("skid", ["coupled", "free"])
def test_derivatives_do_not_grow_while_the_board_rests(skid):
    """In rest no step has an error, yet what could move the board must be told soundly: against simulations that are
    moved, by a yaw moment and by a speed at the start.
    """
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), skid)
    model = model.add(yaw_bias=YawBias())
    gait, times = Gait(*[Sines.of([[0.0, 4.0, 0.0]])] * 2), jnp.linspace(0.0, 0.8, 17)

    def pose(moment, speed, accuracy):
        moved = eqx.tree_at(lambda m: m.effects["yaw_bias"].t, model, moment)
        start = jnp.zeros(6).at[3].set(speed)
        return simulate(moved, gait, times, start, accuracy=accuracy).pose

    rough = Accuracy(rtol=3e-6, atol=3e-8, max_steps=4000, derivative="forward")
    fine = Accuracy(rtol=1e-9, atol=1e-13, max_steps=100_000)
    zero, small = jnp.zeros(()), jnp.asarray(1e-5)
    slopes = jax.jit(jax.jacfwd(lambda m, s: pose(m, s, rough), argnums=(0, 1)))(zero, zero)
    run = jax.jit(lambda m, s: pose(m, s, fine))
    sides = (run(small, zero), run(-small, zero)), (run(zero, small), run(zero, -small))
    for slope, (up, down) in zip(slopes, sides, strict=True):
        expected = np.asarray(up - down) / (2 * float(small))
        np.testing.assert_allclose(slope, expected, rtol=0, atol=2e-3 * np.abs(expected).max())


def test_a_stiff_board_may_rest_for_long():
    """Where what is stable at rest would take more steps than there are, the steps are longer."""
    model = Model(Board(**TABLE_II, creep_speed=1e-6), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), "free")
    gait = Gait(*[Sines.of([[0.0, 4.0, 0.0]])] * 2)
    done = simulate(model, gait, jnp.linspace(0.0, 30.0, 31))
    assert done.finished and np.abs(done.pose).max() == 0.0


@pytest.mark.parametrize("delay", [0.3, -0.3])
@pytest.mark.parametrize("skid", ["coupled", "free"])
def test_a_board_that_rests_at_time_0_rested_before_whatever_the_clocks(skid, delay):
    """Told by six numbers or by its pose."""
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), skid)
    model = model.add(clock=ClockOffset(T=delay))
    gait = Gait(*(Tracked(Sines.of([[a, 4.0, 0.3]]), kp=100.0, kd=10.0) for a in (0.9, 1.6)))
    times, start = jnp.linspace(0.0, 1.5, 16), jnp.asarray([0.1, -0.2, 0.7])
    expected = simulate(model, gait, times, start).pose
    found = simulate(model, gait, times, jnp.append(start, jnp.zeros(3)), resting=True).pose
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
