"""The loop of our own takes the steps of `diffrax.diffeqsolve`: its numbers agree to rounding, of every kind of run."""

from collections import OrderedDict

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, Model, Pacejka, Sines
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.sampled_signals import Held
from snakejax.effects import SteeringLag
from snakejax.simulation.integrate import Accuracy, Trajectory, simulate
from snakejax.vehicles.car import DART, Car

TIMES = jnp.arange(150) / 50
GAIT = Gait(Sines.of([[0.5, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]]))


def board(D: jax.Array | float = 3.0, structure: str = "free") -> Model:
    return Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=D, E=0.0), structure)


def car(D: jax.Array | float = 6.0) -> Model:
    tyre = FrontRear(Pacejka(6.0, 1.4, D, 0.1), Pacejka(8.0, 1.4, 5.5, 0.1))
    return Model(Car(**DART, steering_ratio=0.45, force_gain=22.0, dead_band=0.05, speed_loss=2.0), tyre, "free")


def held() -> Inputs:
    """Commands that jump every tenth of a second."""
    rng, at = np.random.default_rng(0), np.arange(30) / 10
    steer, drive = rng.uniform(-0.5, 0.5, at.size), rng.uniform(0.1, 0.3, at.size)
    return Inputs(OrderedDict(steer=Held.of(at, steer), drive=Held.of(at, drive)))


REST, MOVING = (0.0, 0.0, 0.3), (0.3, 0.1, 0.2, 1.5, 0.0, 0.3)
RUNS = {
    "from rest": (lambda D: board(D), GAIT, REST, Accuracy()),
    "in motion": (lambda D: board(D), GAIT, MOVING, Accuracy(rtol=1e-6, atol=1e-8)),
    "with a memory": (lambda D: board(D).add(lag=SteeringLag(0.05)), GAIT, REST, Accuracy()),
    "constrained": (lambda D: board(D, "coupled"), GAIT, REST, Accuracy()),
    "commands that jump": (lambda D: car(2 * D), held(), MOVING, Accuracy()),
    "steps of fixed length": (lambda D: board(D), GAIT, MOVING, Accuracy(step=1e-3)),
}


def both(name: str) -> tuple[Trajectory, Trajectory]:
    """The run by the loop, and by diffrax, which a reverse derivative needs."""
    model, gait, start, accuracy = RUNS[name]

    def run(D):
        return simulate(model(D), gait, TIMES, start, accuracy=accuracy)

    by_diffrax, _ = jax.vjp(run, jnp.asarray(3.0))
    return run(jnp.asarray(3.0)), by_diffrax


SHORT = ("with a memory", "commands that jump")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SHORT, *(pytest.param(n, marks=pytest.mark.long) for n in RUNS if n not in SHORT)])
def test_its_states_are_those_of_diffrax(name: str) -> None:
    own, others = both(name)
    assert bool(own.finished) and bool(others.finished)
    for ours, theirs in zip(jax.tree.leaves(own.state), jax.tree.leaves(others.state), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)


def test_runs_side_by_side_are_as_each_alone() -> None:
    def run(D):
        return simulate(board(D), GAIT, TIMES, accuracy=Accuracy(derivative="forward")).pose

    strengths = jnp.asarray([1.0, 3.0, 9.0])
    together = jax.vmap(run)(strengths)
    for D, pose in zip(strengths, together, strict=True):
        np.testing.assert_allclose(pose, run(D), rtol=0, atol=1e-10)


@pytest.mark.parametrize("derivative", ["forward", "reverse"])
def test_a_run_that_does_not_reach_its_end_is_infinite(derivative) -> None:
    few = Accuracy(max_steps=20, derivative=derivative)
    times = TIMES[:2] * 100
    cut = simulate(board(), GAIT, times, accuracy=few, throw=False)
    assert not bool(cut.finished) and np.isinf(np.asarray(cut.pose)).all()
