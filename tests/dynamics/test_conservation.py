"""Energy, momentum and symmetry: what a planar vehicle on the floor must keep, and what traction takes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.reference_board import DRAWS, PACEJKA, TYRES, Draw, Given, board_of, gait_of, run, table_2
from oracles import full_equations as full

from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.tyres import Bakker, Pacejka, Rayleigh
from snakejax.simulation.integrate import Accuracy, motions


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


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["coupled", "free"])
@pytest.mark.parametrize("law", ["Pacejka", "Rayleigh", "Bakker"])
def test_traction_never_feeds_energy_in(law, constraint):
    """With no offsets, at any speed, forwards and backwards: what a board with a still rotor loses, traction takes."""
    for seed in DRAWS:
        draw, rng = Draw(seed), np.random.default_rng(1000 + seed)
        tyre = {
            "Pacejka": Pacejka(*(float(rng.uniform(low, high)) for low, high in PACEJKA_DOMAIN)),
            "Rayleigh": Rayleigh(rng.uniform(0.0, 100.0)),
            "Bakker": Bakker(rng.uniform(1.0, 6000.0), rng.uniform(-0.5, 0.5), offsets=False),
        }[law]
        still = Gait(draw.gait().phi, Given(0.3, 0.0, 0.0), draw.gait().phi_back)
        body = (*draw.pose, draw.beta, *draw.twist[::2]) if constraint == "coupled" else (*draw.pose, *draw.twist)
        model = Model(board_of(draw.board), tyre, constraint)
        gain, traction = power_balance(model, still, jnp.zeros(()), tuple(jnp.float64(part) for part in body))
        assert traction <= 0.0
        np.testing.assert_allclose(gain, traction, rtol=1e-9, atol=1e-9)


def gauss_nodes(duration: float, panels: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and weights of composite Gauss-Legendre quadrature with 6 nodes a panel."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    width = duration / panels
    left = width * np.arange(panels)[:, None]
    return (left + width * (nodes + 1) / 2).ravel(), np.tile(width / 2 * weights, panels)


@pytest.mark.parametrize("tyre", ["Pacejka", pytest.param("Rayleigh", marks=pytest.mark.long)])
@pytest.mark.parametrize("constraint", ["coupled", "free"])
def test_work_of_the_joints_becomes_motion_and_slip(constraint, tyre):
    """Kinetic energy gained + energy lost in slip = work of the torques that the full equations ask of the joints."""
    ours, theirs = TYRES[tyre]
    reference = full.integrate(
        full.TABLE_2_BOARD, theirs, full.FORWARD, np.array([0.0, 10.0]), structure=constraint, max_step=0.01
    )
    nodes, weights = gauss_nodes(10.0, 500)
    model, gait = table_2(ours, constraint), gait_of(full.FORWARD)
    trajectory = run(model, gait, [*nodes, 10.0])
    motion, forces = motions(model, gait, trajectory)
    power = sum(F * wheel.lateral for F, wheel in zip(forces, motion.wheels, strict=True))
    lost = weights @ np.asarray(power[:-1])
    last = tuple(part[-1] for part in trajectory.state[0])
    gained = kinetic_energy(model, gait, jnp.array(10.0), last)
    assert lost > 0.01
    np.testing.assert_allclose(gained + lost, reference.joint_work[-1], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["coupled", "free"])
def test_momentum_is_conserved_without_traction(constraint):
    """D = 0: I s + J_r psi' stays as it was, and so does m v where no wheel holds the board."""
    model, gait = table_2(no_traction(), constraint), gait_of(full.FORWARD)
    start = (0.1, -0.2, 0.3, 0.4, 0.0 if constraint == "coupled" else -0.1, 0.5)
    motion, _ = motions(model, gait, run(model, gait, jnp.linspace(0.0, 10.0, 30), start))
    board = model.board
    spin = board.total_inertia * motion.r + board.rotor_inertia * motion.rotor.rate
    np.testing.assert_allclose(spin, 0.4375 * 0.5, rtol=1e-9)
    if constraint == "free":
        cosine, sine = np.cos(motion.theta), np.sin(motion.theta)
        momentum = 7.0 * np.array([motion.u * cosine - motion.w * sine, motion.u * sine + motion.w * cosine])
        np.testing.assert_allclose(momentum, momentum[:, :1] * np.ones(30), rtol=1e-9)


STEPPED = Accuracy(step=0.005)
STRUCTURES = ["coupled", "free", "ideal"]
TIMES = jnp.linspace(0.0, 10.0, 11)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", STRUCTURES)
def test_a_run_may_start_anywhere(constraint):
    """Translating and turning the start translates and turns the run."""
    model, gait = table_2(PACEJKA, constraint, crab=(0.1, 0.03)), gait_of(full.FORWARD)
    here = run(model, gait, TIMES, accuracy=STEPPED).pose
    x, y, turn = 3.0, -2.0, 2.5
    there = run(model, gait, TIMES, (x, y, turn), STEPPED).pose
    cosine, sine = np.cos(turn), np.sin(turn)
    moved = np.stack(
        [x + cosine * here[:, 0] - sine * here[:, 1], y + sine * here[:, 0] + cosine * here[:, 1], turn + here[:, 2]],
        axis=1,
    )
    np.testing.assert_allclose(there, moved, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", STRUCTURES)
def test_a_mirrored_gait_gives_a_mirrored_run(constraint):
    """Joints, crab angles, start and tyre offsets mirrored at the x axis."""
    gait = full.FORWARD
    flipped = replace(
        gait,
        rotor=replace(gait.rotor, amplitude=-gait.rotor.amplitude),
        steering=replace(gait.steering, amplitude=-gait.steering.amplitude),
    )
    left, right = (
        run(
            table_2(Pacejka(0.09, 2.0, 1.0, 0.6, side * 0.02, side * 0.01), constraint, crab=(side * 0.1, side * 0.03)),
            gait_of(gait if side > 0 else flipped),
            TIMES,
            (0.0, side * 0.5, side * 0.4),
            STEPPED,
        ).pose
        for side in (1.0, -1.0)
    )
    assert np.ptp(left[:, 1]) > 1e-3
    np.testing.assert_allclose(left, right * jnp.array([[1.0, -1.0, -1.0]]), atol=1e-11)
