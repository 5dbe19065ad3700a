"""The snakeboard in every structure against an independent solution of the full equations.

Equation, table and section numbers are those of the paper (Salman et al., CDC 2016); P1 is its rotate result. The
independent side is `oracles/full_equations.py`, which shares no code with the package.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.reference_board import (
    DRAWS,
    LOPSIDED,
    PACEJKA,
    TYRES,
    Crab,
    Drag,
    Draw,
    Push,
    along_rate,
    board_of,
    crabbed,
    gait_of,
    last_pose,
    push_of,
    rates_at,
    run,
    table_2,
)
from oracles import full_equations as full

from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.tyres import Pacejka, Rayleigh
from snakejax.simulation.integrate import Accuracy, simulate

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


RUNS = [(constraint, tyre) for constraint in ("coupled", "free") for tyre in TYRES] + [("ideal", None)]


@pytest.mark.slow
@pytest.mark.parametrize(("constraint", "tyre"), RUNS)
def test_runs_follow_the_full_equations(constraint, tyre):
    """10 s of a lopsided board that is pushed, rolls heavily and steers its wheelsets unequally: to 1e-7 m and rad."""
    ours, theirs = (no_traction(), None) if tyre is None else TYRES[tyre]
    gait, push, viscosity, pose = crabbed(full.FORWARD, 0.12, -0.05), (0.02, -0.03, 0.01), 0.05, (0.3, -0.2, 0.5)
    model = Model(board_of(LOPSIDED), ours, constraint)
    model = model.add(crab=Crab(*gait.crab), push=Push(*push), drag=Drag(viscosity))
    times = np.linspace(0.0, 10.0, 21)
    reference = full.integrate(
        LOPSIDED,
        theirs,
        gait,
        times,
        structure=constraint,
        wrench=push_of(*push),
        rolling_force=lambda speed: viscosity * speed,
        pose=pose,
    )
    trajectory = run(model, gait_of(gait), times, pose)
    np.testing.assert_allclose(trajectory.pose, reference.pose.T, rtol=0.0, atol=1e-7)


@pytest.mark.slow
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


@pytest.mark.slow
def test_printed_equations_never_leave_their_place_from_rest():
    """theta + beta swings against the rotor, I s = -J_r psi', and nothing else happens."""
    times = jnp.linspace(0.0, 7.7, 40)
    model, gait = table_2(PACEJKA, "printed"), gait_of(full.FORWARD)
    trajectory = run(model, gait, times)
    swing = -0.0238 * jax.vmap(gait.psi.at)(times).angle / 0.4375
    np.testing.assert_allclose(trajectory.pose[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(trajectory.pose[:, 2], swing, atol=1e-9)


@pytest.mark.slow
def test_stiff_rayleigh_tends_to_the_ideal_board():
    """Hard constraints are the limit of R = k_s v^2 / 2 (paper, eq. 1), with an error that falls as 1 / k_s."""
    ideal = last_pose(table_2(no_traction(), "ideal"), full.FORWARD, 5.0)
    stiffnesses = np.array([2000.0, 4000.0, 8000.0])
    poses = [last_pose(table_2(Rayleigh(k)), full.FORWARD, 5.0) for k in stiffnesses]
    errors = np.linalg.norm(poses - ideal, axis=1)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.05)
