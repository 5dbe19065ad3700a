"""Sleigh, roller racer and skid-steer robot against closed forms, balances of energy and published motion."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.scipy_runs import integrated

from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.multibody import kinetic_energy
from snakejax.dynamics.signals import Joint, Sines
from snakejax.dynamics.tyres import Pacejka
from snakejax.dynamics.vehicle_input import Input
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.vehicles.roller_racer import ROLLER_RACER, RollerRacer
from snakejax.vehicles.skid_steer import HUSKY, SkidSteer
from snakejax.vehicles.sleigh import ICE_SLEIGH, Sleigh

FINE = Accuracy(rtol=1e-11, atol=1e-12)


def sines(**terms) -> Inputs:
    return Inputs({name: Sines.of(each) for name, each in terms.items()})


def constant(**values: float) -> Inputs:
    return sines(**{name: [[value, 0.0, np.pi / 2]] for name, value in values.items()})


def test_the_sleigh_follows_its_closed_form() -> None:
    """Bloch, Nonholonomic Mechanics and Control (2003), 1.7: with k^2 = m a^2 / (I + m a^2), the energy E and
    s = sqrt(2 E / m), the blade's speed is s tanh(k^2 s t / a + c) and the yaw rate (s k / a) sech of the same."""
    sleigh = Sleigh(**ICE_SLEIGH)
    m, inertia, a = (float(part) for part in (sleigh.mass, sleigh.inertia, sleigh.arm))
    speed, spin = -0.3, 2.0
    times = np.linspace(0.0, 6.0, 61)
    model = Model(sleigh, no_traction(), "ideal")
    found = simulate(model, Inputs({}), times, (0.0, 0.0, 0.0, speed, 0.0, spin), accuracy=FINE)
    s = np.sqrt(speed**2 + (inertia / m + a**2) * spin**2)
    k = np.sqrt(m * a**2 / (inertia + m * a**2))
    phase = k**2 * s * times / a + np.arctanh(speed / s)
    u, r = found.state[0][3], found.state[0][4]
    np.testing.assert_allclose(u, s * np.tanh(phase), rtol=0, atol=1e-9)
    np.testing.assert_allclose(r, s * k / a / np.cosh(phase), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_sleigh_with_a_stiff_blade_comes_near_the_one_without_slip() -> None:
    times, start = np.linspace(0.0, 2.0, 21), (0.0, 0.0, 0.0, 0.4, 0.1, 1.0)
    sleigh = Sleigh(**ICE_SLEIGH)
    ideal = simulate(Model(sleigh, no_traction(), "ideal"), Inputs({}), times, start).pose
    gaps = []
    for stiff in (20.0, 200.0, 2000.0):
        tyre = Pacejka(B=1.0, C=1.0, D=stiff, E=0.0)
        gaps.append(float(jnp.abs(simulate(Model(sleigh, tyre, "free"), Inputs({}), times, start).pose - ideal).max()))
    assert gaps[0] > 5 * gaps[1] > 25 * gaps[2]


def racer_energy(model: Model, inputs: Inputs, trajectory) -> np.ndarray:
    def at(t, state):
        motion = model.motion(t, state[0], inputs)
        joints = motion.inputs
        V = (motion.u, motion.w, motion.r, *(joints[name].rate for name in model.board.free_joints))
        angles = {name: joint.angle for name, joint in joints.items()}
        return kinetic_energy(model.board, V, angles, {name: joint.rate for name, joint in joints.items()})

    return np.asarray(jax.vmap(at)(trajectory.command_times, trajectory.state))


class SprungRacer(RollerRacer):
    """A racer nobody holds: a spring pulls its handlebar straight, so its energy is constant."""

    inputs: ClassVar[tuple[Input, ...]] = ()
    free_joints: ClassVar[tuple[str, ...]] = ("handle",)
    independent: ClassVar[tuple[str, ...]] = ("u", "handle")

    def joint_torques(self, joints):
        return {"handle": -3.0 * joints["handle"].angle}


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["ideal", "free"])
def test_a_free_handlebar_keeps_the_energy(constraint: str) -> None:
    racer = SprungRacer(**{**ROLLER_RACER, "handle_mass": 0.4, "rear": 0.2})
    model, inputs = Model(racer, no_traction(), constraint), Inputs({})
    body, lags = model.initial_state(tuple(map(jnp.asarray, (0.0, 0.0, 0.1, 0.5, 0.0, 0.0))), jnp.zeros(()), inputs)
    found = integrated(model, inputs, np.linspace(0.0, 5.0, 51), ((*body[:-1], 0.5), lags))
    kinetic = racer_energy(model, inputs, found)
    total = kinetic + 1.5 * np.asarray(found.state[0][-1]) ** 2
    np.testing.assert_allclose(total, total[0], rtol=1e-9)
    assert np.ptp(kinetic) > 0.05


@pytest.mark.slow
def test_a_racer_without_force_keeps_its_energy_and_turns_on_a_circle() -> None:
    """With the handlebar at rest at an angle the wheels' axles meet in one point, about which it turns."""
    racer, angle = RollerRacer(**{**ROLLER_RACER, "handle_mass": 0.3}), 0.5
    model, inputs = Model(racer, no_traction(), "ideal"), constant(handle=angle)
    found = integrated(model, inputs, np.linspace(0.0, 4.0, 9), (0.0, 0.0, 0.0, 0.8, 0.0, 0.0))
    energy = racer_energy(model, inputs, found)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    pivot, front = float(racer.pivot), float(racer.front)
    radius = (pivot + front * np.cos(angle) - front * 0.0) / np.tan(angle) + front * np.sin(angle)
    turned = float(found.pose[-1, 2] - found.pose[0, 2])
    np.testing.assert_allclose(turned, 0.8 * 4.0 / radius, rtol=1e-8)


@pytest.mark.slow
def test_swinging_the_handlebar_drives_the_racer() -> None:
    """Krishnaprasad and Tsakiris (2001): from rest, swings about straight drive it ahead, ever faster, and the
    speed-up is even in the amplitude: four times as large for twice the angle."""
    racer = RollerRacer(**ROLLER_RACER)
    model, period = Model(racer, no_traction(), "ideal"), 2 * np.pi / 3.0
    times = np.arange(5) * 4 * period
    gained = {}
    for amplitude in (0.05, 0.1, -0.1):
        found = integrated(model, sines(handle=[[amplitude, 3.0, np.pi / 2]]), times)
        gained[amplitude] = np.asarray(found.state[0][3])
    assert (np.diff(np.abs(gained[0.1])) > 0).all()
    np.testing.assert_allclose(gained[-0.1], gained[0.1], rtol=1e-6)
    np.testing.assert_allclose(gained[0.1][1] / gained[0.05][1], 4.0, rtol=0.05)


def steady(left: float, right: float, **other: float) -> tuple[float, float, float]:
    """(u, w, r) of the robot under constant speeds of its rims [m/s] once it is steady."""
    robot = SkidSteer(**{**HUSKY, "wheel_radius": 1.0, **other})
    tyre = Pacejka(B=5.0, C=1.3, D=0.6 * 50 * 9.81 / 4, E=0.0)
    model = Model(robot, tyre, "free")
    speeds = constant(left=left, right=right)
    found = integrated(model, speeds, [0.0, 6.0, 12.0], (0.0,) * 6, method="Radau", rtol=1e-9, atol=1e-11)
    return tuple(float(part[-1]) for part in found.state[0][3:6])


@pytest.mark.slow
def test_the_robot_drives_straight_without_slip() -> None:
    u, w, r = steady(0.8, 0.8)
    np.testing.assert_allclose((u, w, r), (0.8, 0.0, 0.0), atol=1e-6)


def test_the_robots_centres_of_rotation_lie_outside_its_wheels() -> None:
    """Martinez, Mandow et al., IJRR 24 (2005): the contact points of a pair have a centre of rotation at
    y = (v_side - u) / r outside the wheels, so it turns less than a differential drive of its track."""
    u, w, r = steady(-0.4, 0.4)
    y_left, y_right = -(-0.4 - u) / r, -(0.4 - u) / r
    assert y_left > HUSKY["half_track"] and y_right < -HUSKY["half_track"]
    np.testing.assert_allclose(y_left, -y_right, rtol=1e-6)
    np.testing.assert_allclose((u, w), (0.0, 0.0), atol=1e-6)


@pytest.mark.slow
def test_the_robots_centre_of_rotation_leaves_the_axle_line_when_it_turns_at_speed() -> None:
    """x = -w / r is zero without mass in motion; the tyres' sideways force that carries the robot round a bend moves
    it ahead of the middle, the further the faster (Mandow et al. 2007)."""
    ahead = []
    for speed in (0.2, 0.5, 1.0):
        _, w, r = steady(0.6 * speed, 1.4 * speed)
        ahead.append(-w / r)
    assert 0 < ahead[0] < ahead[1] < ahead[2] and ahead[2] > 0.05


def test_the_ideal_robot_is_a_differential_drive() -> None:
    model = Model(SkidSteer(**{**HUSKY, "wheel_radius": 0.1}), no_traction(), "ideal")
    found = simulate(model, constant(left=3.0, right=5.0), np.linspace(0.0, 2.0, 5), (0.0, 0.0, 0.2))
    rate = (0.5 - 0.3) / HUSKY["effective_track"]
    np.testing.assert_allclose(found.pose[:, 2], 0.2 + rate * found.times, rtol=1e-9)
    path = np.linalg.norm(np.asarray(found.pose)[-1, :2])
    np.testing.assert_allclose(path, 2 * 0.4 / rate * np.sin(rate), rtol=1e-9)


@pytest.mark.slow
def test_a_free_joint_has_its_rate() -> None:
    joint = Joint(jnp.asarray(0.1), jnp.asarray(0.2), jnp.asarray(0.0))
    model = Model(SprungRacer(**ROLLER_RACER), no_traction(), "free")
    state = tuple(map(jnp.asarray, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.1)))
    assert model.constraint.free_joints(state, model.board) == {"handle": joint}
    assert float(model.rates(jnp.zeros(()), (state, ()), Inputs({}))[0][7]) == 0.2
