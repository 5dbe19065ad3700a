"""Steps of the integration, rest, and derivatives of a run against finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.reference_board import PACEJKA, Crab, Drag, Push, board_of, gait_of, table_2
from jax.flatten_util import ravel_pytree
from oracles import full_equations as full

from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Gait, Inputs
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.dynamics.tyres import Pacejka
from snakejax.effects import ClockOffset, YawBias
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.vehicles.car import DART, Car
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

STRUCTURES = ["coupled", "free", "ideal"]
MOVING = (0.0, 0.0, 0.0, 1.2, 0.0, 0.3)
"""A start at 1.2 m/s and 0.3 rad/s."""


@pytest.mark.slow
def test_a_long_recording_may_take_more_steps():
    """What is asked for at 1000 times is not refused for the limit of a run of a few samples."""
    model, gait = table_2(PACEJKA, "free"), gait_of(full.FORWARD)
    few = Accuracy(max_steps=10)
    assert not bool(simulate(model, gait, jnp.linspace(0.0, 1.0, 3), accuracy=few, throw=False).finished)
    assert bool(simulate(model, gait, jnp.linspace(0.0, 1.0, 1000), accuracy=few, throw=False).finished)


def test_models_and_gaits_of_one_structure_share_a_program():
    """A second simulation, of other numbers and from another start, compiles nothing."""
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(lambda name, _, **__: compiled.append(name))
    times = jnp.linspace(0.0, 0.5, 3)
    poses = []
    for k in (1.0, 1.1):
        model = Model(Board(**TABLE_II), Pacejka(8.0 * k, 1.3, 0.9 * k, 0.2), "coupled")
        gait = Gait(Sines.of([[0.7 * k, 4.0, 0.0]]), Sines.of([[1.5, 4.0 * k, 0.0]]))
        compiled.clear()
        poses.append(simulate(model, gait, times, jnp.array([0.1 * k, 0.0, 0.2])).pose)
    assert not [name for name in compiled if "compile" in name]
    assert (poses[0][-1] != poses[1][-1]).all()


EIGHTH_ORDER = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Weights of the antisymmetric central difference with an error of the 8th order in the step."""


def differentiable(tyre: Pacejka, constraint: str, drive: float, start: tuple[float, ...]):
    """A run of 10 s in fixed steps: its parameters and its start as one vector, and the last pose as a function of it.

    The parameters are every number of the board, the tyre, three effects and the rotate gait; at `drive` 0 the joints
    stay still and nothing pushes.
    """
    model = Model(board_of(full.TABLE_2_BOARD), tyre, constraint)
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
    ("constraint", "tyre"),
    [
        pytest.param("coupled", PACEJKA, marks=pytest.mark.long),
        ("free", PACEJKA),
        pytest.param("ideal", no_traction(), marks=pytest.mark.long),
    ],
    ids=STRUCTURES,
)
def test_gradients_of_a_run(constraint, tyre):
    """Against finite differences in every parameter and the start; and finite at rest and when rolling backwards.

    With fixed steps the discrete run is as smooth as the equations. At rest the joints never move, and nothing may
    divide by the speed.
    """
    vector, pose = differentiable(tyre, constraint, 1.0, (0.1, 0.2, 0.3, 0.02, 0.03, 0.04))
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
        elsewhere, _ = differentiable(tyre, constraint, drive, start)
        assert jnp.isfinite(jacobian_at(elsewhere)).all()


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["coupled", "free"])
def test_derivatives_do_not_grow_while_the_board_rests(constraint):
    """In rest no step has an error, yet what could move the board must be told soundly: against simulations that are
    moved, by a yaw moment and by a speed at the start.
    """
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), constraint)
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


@pytest.mark.slow
def test_a_stiff_board_may_rest_for_long():
    """Where what is stable at rest would take more steps than there are, the steps are longer."""
    model = Model(Board(**TABLE_II, creep_speed=1e-6), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), "free")
    gait = Gait(*[Sines.of([[0.0, 4.0, 0.0]])] * 2)
    done = simulate(model, gait, jnp.linspace(0.0, 30.0, 31))
    assert done.finished and np.abs(done.pose).max() == 0.0


@pytest.mark.parametrize("delay", [0.3, pytest.param(-0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("constraint", ["coupled", "free"])
def test_a_board_that_rests_at_time_0_rested_before_whatever_the_clocks(constraint, delay):
    """Told by six numbers or by its pose."""
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=6.0, E=0.1), constraint)
    model = model.add(clock=ClockOffset(T=delay))
    gait = Gait(*(Tracked(Sines.of([[a, 4.0, 0.3]]), kp=100.0, kd=10.0) for a in (0.9, 1.6)))
    times, start = jnp.linspace(0.0, 1.5, 16), jnp.asarray([0.1, -0.2, 0.7])
    expected = simulate(model, gait, times, start).pose
    found = simulate(model, gait, times, jnp.append(start, jnp.zeros(3)), resting=True).pose
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_car_under_way_has_a_derivative_by_the_clock_of_its_held_commands():
    """The steps begin later with the run, and end at the jumps of the commands, which stay."""
    random, at = np.random.default_rng(1), np.arange(0.0, 3.0, 0.1)
    commands = {"steer": random.uniform(-0.3, 0.3, at.size), "drive": random.uniform(0.1, 0.5, at.size)}
    inputs = Inputs({name: Held.of(at, values) for name, values in commands.items()})
    tyre, times = Pacejka(4.0, 1.3, 3.0, 0.0), jnp.arange(0.5, 2.5, 0.02)
    car = Model(Car(**DART, force_gain=20.0, speed_loss=2.0), FrontRear(tyre, tyre), "free")
    how = Accuracy(rtol=1e-9, atol=1e-11, derivative="forward")

    def pose(delay):
        return simulate(car.add(clock_offset=ClockOffset(delay)), inputs, times, MOVING, accuracy=how).pose

    delay, step = jnp.asarray(0.013), 1e-4
    _, derivative = jax.jvp(pose, (delay,), (jnp.ones(()),))
    quotient = (pose(delay + step) - pose(delay - step)) / (2 * step)
    assert float(jnp.abs(quotient[-1]).max()) > 0.4
    np.testing.assert_allclose(derivative, quotient, atol=3e-6)
