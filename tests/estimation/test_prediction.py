"""Errors of predictions: of the true model near the noise, of a car without slip by hand, and of nothing later."""

from collections import OrderedDict

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.core.errors import InputError
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.tyres import Pacejka
from snakejax.estimation.prediction import (
    LeadIn,
    PredictionWindow,
    predicted,
    prediction_errors,
    prediction_windows,
    prior_strength,
)
from snakejax.recording.run import Run
from snakejax.simulation.integrate import simulate
from snakejax.vehicles.car import DART, Car

POSITION, HEADING = 1e-4, 5e-4
HORIZONS = (0.5, 1.0)
STEADY = Car(**DART, steering_ratio=0.4, force_gain=0.0 + 1e-9)
"""A car that no force drives: without slip it goes on as it was."""


def inputs(seconds: float, steer: float | None = None) -> Inputs:
    rng = np.random.default_rng(4)
    at = np.arange(round(10 * seconds)) / 10
    turned = rng.uniform(-0.5, 0.5, at.size // 6 + 1).repeat(6)[: at.size] if steer is None else np.full(at.size, steer)
    signals = OrderedDict(steer=Held.of(at, turned), drive=Held.of(at, rng.uniform(0.1, 0.3, at.size)))
    return Inputs(signals)


def recording(times: np.ndarray, pose: np.ndarray, gait: Inputs, group: str | None = None) -> Run:
    labels = () if group is None else (("group", group),)
    return Run("lap", "heldout", jnp.asarray(times), jnp.asarray(pose), gait, moving=True, labels=labels)


@pytest.mark.slow
def test_the_true_model_predicts_to_near_the_noise() -> None:
    tyre = FrontRear(Pacejka(6.0, 1.4, 6.0, 0.1), Pacejka(8.0, 1.4, 5.5, 0.1))
    truth = Model(Car(**DART, steering_ratio=0.45, force_gain=22.0, dead_band=0.05, speed_loss=2.0), tyre, "free")
    gait = inputs(6.0)
    times = np.arange(300) / 50
    pose = np.asarray(simulate(truth, gait, jnp.asarray(times), (0.3, 0.1, 0.2, 1.5, 0.0, 0.3)).pose)
    noisy = pose + np.random.default_rng(1).normal(size=pose.shape) * [POSITION, POSITION, HEADING]
    windows = prediction_windows([recording(times, noisy, gait, "laps")], 0.5, HORIZONS)
    assert len(windows) == 10 and len(windows[-1].known) == 1
    errors = prediction_errors(windows, predicted(truth, windows), HORIZONS)["laps"]
    assert [errors[h].windows for h in ("0.5", "1")] == [10, 9]
    assert errors["1"].position < 15 * POSITION and errors["1"].heading < 4 * HEADING
    # A tyre that grips by a third less is far off.
    worse = Model(truth.board, FrontRear(Pacejka(4.0, 1.4, 4.0, 0.1), Pacejka(5.0, 1.4, 4.0, 0.1)), "free")
    assert (
        prediction_errors(windows, predicted(worse, windows), HORIZONS)["laps"]["1"].position > 5 * errors["1"].position
    )


def circle(times: np.ndarray, speed: float, rate: float) -> np.ndarray:
    heading = rate * times
    return np.column_stack([speed / rate * np.sin(heading), speed / rate * (1 - np.cos(heading)), heading])


@pytest.mark.slow
def test_a_car_without_slip_that_coasts_is_off_by_what_one_computes_by_hand() -> None:
    """It rolls on at its speed in a circle of curvature tan(delta) / l; the recording turns twice as fast."""
    steer, speed = 0.3, 1.2
    wheelbase = DART["front"] + DART["rear"]
    rate = speed * np.tan(0.4 * steer) / wheelbase
    times = np.arange(200) / 50
    # v = l_r r: the centre of mass moves across the body too.
    slip = np.arctan(DART["rear"] * rate / speed)
    travelled = np.hypot(speed, DART["rear"] * rate)

    def motion(turning: float, h: np.ndarray) -> np.ndarray:
        path = circle(h, travelled, turning)
        c, s = np.cos(slip), np.sin(slip)
        return np.column_stack([c * path[:, 0] - s * path[:, 1], s * path[:, 0] + c * path[:, 1], path[:, 2]])

    gait = inputs(4.0, steer)
    model = Model(STEADY, Pacejka(1.0, 1.0, 0.0, 0.0), "ideal")
    exact = prediction_windows([recording(times, motion(rate, times), gait)], 0.5, HORIZONS)[:1]
    found = prediction_errors(exact, predicted(model, exact), HORIZONS)["heldout"]
    assert found["1"].position < 1e-5 and found["1"].heading < 1e-5
    # After the lead-in of the first window the recording goes on straight, along the velocity that it had.
    pose = motion(rate, times)
    turn = times > 0.5 + 1e-9
    way = travelled * (times[turn] - 0.5)
    at = int(np.flatnonzero(~turn)[-1])
    course = pose[at, 2] + slip
    pose[turn] = pose[at] + np.column_stack([way * np.cos(course), way * np.sin(course), 0 * way])
    first = prediction_windows([recording(times, pose, gait)], 0.5, HORIZONS)[:1]
    off = prediction_errors(first, predicted(model, first), HORIZONS)["heldout"]
    for h in HORIZONS:
        chord = circle(np.array([h]), travelled, rate)[0]
        assert off[f"{h:g}"].heading == pytest.approx(rate * h, rel=1e-3)
        assert off[f"{h:g}"].position == pytest.approx(np.hypot(chord[0] - travelled * h, chord[1]), rel=1e-3)


@pytest.mark.slow
def test_nothing_measured_after_the_lead_in_is_used() -> None:
    times, gait = np.arange(200) / 50, inputs(4.0, 0.3)
    pose = circle(times, 1.2, 0.8)
    changed = pose.copy()
    changed[times > 0.5 + 1e-9] += [0.3, -0.2, 0.1] * (times[times > 0.5 + 1e-9, None] - 0.5)
    model = Model(STEADY, Pacejka(1.0, 1.0, 0.0, 0.0), "ideal")
    both = [prediction_windows([recording(times, p, gait)], 0.5, HORIZONS)[:1] for p in (pose, changed)]
    for one in both:  # The noise of a frame is that of the whole recording.
        one[0] = one[0]._replace(noise=np.array([1e-4, 1e-4, 1e-4]))
    np.testing.assert_array_equal(*(predicted(model, one)[0] for one in both))


def lead_ins(relaxation: float, spread: float, jump: float) -> list[tuple[np.ndarray, np.ndarray, LeadIn]]:
    """40 lead-ins of 0.5 s: true start, start of least chi^2 and the linear problem there. Velocities deviate by
    `spread` from their mean, zero, and decay within `relaxation` seconds; in the first 0.1 s the cameras are off by
    `jump` times the noise."""
    rng, t = np.random.default_rng(2), np.arange(11) / 20
    jacobian = np.zeros((11, 3, 6))
    for c in range(3):
        jacobian[:, c, c] = -100.0
        jacobian[:, c, 3 + c] = -100.0 * relaxation * (1 - np.exp(-t / relaxation))
    made = []
    for _ in range(40):
        truth = np.concatenate([np.zeros(3), rng.normal(0, spread, 3)])
        off = rng.normal(size=3) * jump * (t < 0.1)[:, None]
        residual = -jacobian @ truth + off + rng.normal(size=(11, 3))
        best = np.linalg.lstsq(jacobian.reshape(-1, 6), -residual.reshape(-1))[0]
        # The prior is of the velocities alone.
        deviation = np.where(np.arange(6) < 3, 0.0, best)
        made.append((truth, best, LeadIn(t[-1] - t, residual + jacobian @ best, jacobian, deviation)))
    return made


def test_a_prior_holds_velocities_that_soon_follow_the_commands() -> None:
    """Their start would else explain how the first frames are off."""
    made = lead_ins(0.3, 0.02, 8.0)
    strength = prior_strength([one for *_, one in made])
    assert (strength[:3] == 0).all() and (strength[3:] > 0).all()

    def error(prior: np.ndarray) -> float:
        """Of the place where the vehicle comes to rest beside its mean path."""
        off = np.array([best + one.settled(prior)[0] - truth for truth, best, one in made])
        return float(np.sqrt(((off[:, :3] + 0.3 * off[:, 3:]) ** 2).mean()))

    assert error(strength) < 0.6 * error(np.zeros(6))


def test_velocities_that_no_command_tells_keep_the_values_of_the_lead_in() -> None:
    """A vehicle that rolls freely for minutes, at velocities 2 m/s and 2 rad/s from those of the prior."""
    made = lead_ins(100.0, 2.0, 0.0)
    strength = prior_strength([one for *_, one in made])
    moved = np.array([one.settled(strength)[0] - one.settled(np.zeros(6))[0] for *_, one in made])
    assert abs(moved[:, 3:]).max() < 0.02


def test_the_state_under_a_prior_is_that_of_the_normal_equations() -> None:
    ((*_, one), *_), strength = lead_ins(0.3, 1.0, 0.0), np.array([0, 0, 0, 3.0, 0.5, 8.0])
    step, factor = one.settled(strength)
    weight = np.repeat(factor, 3)
    J, r = one.jacobian.reshape(-1, 6) * weight[:, None], one.residual.reshape(-1) * weight
    normal = J.T @ J + np.diag(strength**2)
    np.testing.assert_allclose(step, -np.linalg.solve(normal, J.T @ r + strength**2 * one.deviation), rtol=1e-9)


def test_medians_and_nine_tenths() -> None:
    window = PredictionWindow("laps", None, 0, (0,), np.zeros((1, 3)), np.ones(3))  # type: ignore[arg-type]
    poses = [np.array([[3.0 * k, 4.0 * k, 2 * np.pi - 0.1 * k]]) for k in range(1, 10)] + [np.full((1, 3), np.inf)]
    error = prediction_errors([window] * 10, poses, (1.0,))["laps"]["1"]
    assert (error.position, error.windows) == (27.5, 10) and error.heading == pytest.approx(0.55)
    assert error.position_90 == np.inf


def test_a_car_that_stands_is_not_predicted() -> None:
    times = np.arange(200) / 50
    with pytest.raises(InputError, match="s of motion and then"):
        prediction_windows([recording(times, np.zeros((200, 3)), inputs(4.0))], 0.5, HORIZONS)


def test_no_window_spans_a_gap() -> None:
    times, gait = np.arange(400) / 50, inputs(8.0)
    pose = circle(times, 1.2, 0.8)
    pose[195:215] = np.nan
    windows = prediction_windows([recording(times, pose, gait)], 0.5, HORIZONS)
    spans = [(float(w.run.times[0]), float(w.run.times[w.lead_frames - 1]) + HORIZONS[w.known[-1]]) for w in windows]
    assert spans and all(end <= 3.9 or begin >= 4.3 - 1e-9 for begin, end in spans)
