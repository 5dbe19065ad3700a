"""Windows of a run: what they are called and which run they are cut from."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from snakejax import Board, Gait, Model, Noise, Pacejka, Run, Sines
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.law import law
from snakejax.dynamics.sampled_signals import Held
from snakejax.effects import library
from snakejax.estimation import multiple_shooting
from snakejax.estimation.multiple_shooting import Windows, cut_windows
from snakejax.simulation.integrate import simulate
from snakejax.vehicles.skid_steer import HUSKY, SkidSteer


def test_windows_name_the_run_they_are_cut_from_whatever_it_is_called() -> None:
    times = jnp.arange(400.0) / 100
    still = Gait(Sines.of([]), Sines.of([]))
    run = Run(
        "board[3]", "heldout", times, jnp.zeros((400, 3)), still, jnp.asarray([2.0, 0.1]), wander=jnp.ones((400, 3, 2))
    )
    windows = cut_windows(run, 1.5)
    assert [window.name for window in windows] == ["board[3][0]", "board[3][1]", "board[3][2]"]
    assert {window.recorded_as for window in windows} == {run.recorded_as} == {"board[3]"}
    assert all(window.moving and window.role == "heldout" for window in windows)
    np.testing.assert_array_equal(np.concatenate([w.times for w in windows]), times)
    assert all(w.wander is not None and w.wander.shape == (w.times.size, 3, 2) for w in windows)
    assert all(np.array_equal(w.payload, run.payload) for w in windows)


def test_a_window_that_runs_away_from_its_start_ends_no_fit() -> None:
    """A board at rest stays there, but a disturbance of its yaw rate grows by exp(a t / I): by 1e150 in 1.5 s."""
    size = {"mass": 7.0, "inertia": 0.44, "rotor_inertia": 0.02, "wheelset_inertia": 0.001, "half_length": 0.25}
    board = Board(**size, creep_speed=0.01)
    push = law("N = a * r", {"a": "N m s/rad"}, {"a": 101.0})
    model = Model(board, Pacejka(1e-3, 1.0, 1e-3, 0.0), "free").add(push=push)
    times, still = jnp.arange(300.0) / 100, Gait(Sines.of([]), Sines.of([]))
    run = Run("run", "train", times, jnp.zeros((300, 3)), still)
    windows = Windows.of(
        model, [run], Noise(jnp.asarray(1e-3), jnp.asarray(1e-3), source="made up"), ["tyre.D"], 1, 1.5
    )
    linearised = windows.at(windows.problem.values(), np.zeros_like(windows.problem.batch.start))
    assert np.isinf(linearised.residual).all(axis=(1, 2)).any()
    settled = windows.settle(windows.problem.values(), ["tyre.D"])
    assert settled.values["tyre.D"] == 1e-3


def test_windows_of_held_commands_show_what_a_clock_offset_does() -> None:
    """Windows begin at jumps of the commands: the derivative by a delay was 1e10 there. The change by the quotient is
    compared with that of windows simulated 0.03 s later."""
    rng, at = np.random.default_rng(4), np.arange(60) * 0.1
    speeds = {side: np.repeat(rng.uniform(-2, 6, 10), 6) for side in ("left", "right")}
    inputs = Inputs({side: Held.of(at, values) for side, values in speeds.items()})
    robot = SkidSteer(**HUSKY)
    model = Model(robot, Pacejka(5.0, 1.3, 60.0, 0.1), "free").add(clock=library(robot)["clock_offset"]())
    times = jnp.arange(0.0, 6.0, 0.02)
    pose = simulate(model, inputs, times, (0.0, 0.0, 0.3)).pose
    noise = Noise(jnp.asarray(2e-4), jnp.asarray(5e-4), source="made up")
    windows = Windows.of(model, [Run("run", "train", times, pose, inputs)], noise, ["effects.clock.T"], 1, 1.5)
    values, start = windows.problem.values(), np.asarray(windows.problem.batch.start)
    now, late = (windows.at(values | {"effects.clock.T": T}, start) for T in (0.0, 0.03))
    change = late.residual - now.residual
    off = change - 0.03 * now.jacobian[..., 0]
    assert np.linalg.norm(off) < 0.3 * np.linalg.norm(change)


def test_windows_settle_at_the_optimum_that_scipy_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drag and the start states of all windows at once; a model that a torque turns, as nothing turned the robot,
    settles above the noise, at the optimum too."""
    rng, times = np.random.default_rng(7), jnp.arange(0.0, 4.5, 0.03)
    turn = Inputs({"left": Sines.of([(2.0, 1.3, 0.0)]), "right": Sines.of([(3.0, 0.9, 1.0)])})
    robot = Model(SkidSteer(**HUSKY), Pacejka(5.0, 1.3, 60.0, 0.1), "free")
    pose = simulate(robot, turn, times, (0.0, 0.0, 0.3)).pose + rng.normal(size=(times.size, 3)) * [2e-3, 2e-3, 4e-3]
    noise = Noise(jnp.asarray(2e-3), jnp.asarray(4e-3), source="made up")
    free = ["effects.drag.c"]
    for torque in (0.0, 20.0):
        drag = law("X = -c * u", {"c": "N s/m"}, {"c": 0.0})
        model = robot.add(torque=law("N = t", {"t": "N m"}, {"t": torque}), drag=drag)
        windows = Windows.of(model, [Run("run", "train", times, pose, turn)], noise, free, 1, 1.5)
        settled = windows.settle({free[0]: 60.0}, free)
        movable = np.asarray(windows.problem.batch.free_start) > 0

        def residual(z: np.ndarray, windows=windows, movable=movable, settled=settled) -> np.ndarray:
            start = settled.start.copy()
            start[movable] = z[1:]
            return windows.at({free[0]: z[0]}, start).residual.ravel()

        begin = np.array([settled.values[free[0]] + 2.0, *(settled.start[movable] + 1e-3)])
        found = optimize.least_squares(residual, begin, x_scale="jac")
        assert settled.cost == pytest.approx(2 * found.cost, rel=3e-3)
        sd = np.sqrt(np.linalg.inv(found.jac.T @ found.jac)[0, 0])
        assert settled.values[free[0]] == pytest.approx(found.x[0], abs=sd)
        assert (settled.cost / settled.linearised.residual.size > 1.3) == (torque > 0)
        # Once the linear model is trusted, what it does not expect to be of use is not fitted.
        with monkeypatch.context() as patient:
            patient.setattr(multiple_shooting, "PATIENCE", 0)
            for useful, fitted in ((0.99 * settled.cost, False), (1.1 * settled.cost, True)):
                assert (windows.settle({free[0]: 60.0}, free, useful=useful).values[free[0]] != 60.0) == fitted
