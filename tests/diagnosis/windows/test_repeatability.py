"""What a vehicle does not repeat: windows under the same commands, held or measured with noise."""

import numpy as np

from snakejax.diagnosis.windows.repeatability import repeatability_errors, steady_windows
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.signals import Logged
from snakejax.recording.run import Run


def test_the_repeatability_error_is_what_a_steady_circle_lacks() -> None:
    times = np.arange(30) * 0.05
    rng = np.random.default_rng(2)
    heading = 0.4 + 1.5 * times
    path = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]) * (1.0 + 0.2 * times)[:, None], axis=0) * 0.05
    gait = Inputs({"steer": Held.of([0.0], [0.3]), "drive": Held.of([0.0], [0.2])})
    varying = Inputs({"steer": Held.of([0.0, 0.7], [0.3, 0.1]), "drive": Held.of([0.0], [0.2])})
    noise = np.array([1e-3, 1e-3, 2e-3])
    runs = []
    for k in range(40):
        pose = np.column_stack([path, heading]) + rng.normal(size=(30, 3)) * noise
        runs.append(Run(f"w{k}", "train", times, pose, varying if k % 4 == 0 else gait, moving=True, cut_from="one"))
    assert steady_windows(runs) == [[k for k in range(40) if k % 4]]
    errors = repeatability_errors([runs[k] for k in range(40) if k % 4], noise)
    # Position counts two channels of 1 mm each.
    np.testing.assert_allclose(np.sqrt((errors**2).mean(axis=0)), [np.sqrt(2) * 1e-3, 2e-3], rtol=0.1)


def test_runs_that_turn_at_rates_of_their_own_do_not_repeat() -> None:
    times, rng = np.arange(30) * 0.05, np.random.default_rng(4)
    gait = Inputs({"steer": Held.of([0.0], [0.3]), "drive": Held.of([0.0], [0.2])})
    runs = []
    for k in range(60):
        heading = (1.5 + 0.1 * rng.normal()) * times
        path = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * 0.05
        pose = np.column_stack([path, heading])
        runs.append(Run(f"w{k}", "train", times, pose, gait, moving=True, cut_from="one"))
    errors = repeatability_errors(runs, np.array([1e-3, 1e-3, 2e-3]))
    # A rate off by 0.1 rad/s leaves 0.1 times the standard deviation of time about its mean in heading, where the
    # start heading is free; the position has a say in it too.
    expected = 0.1 * times.std()
    assert 0.7 * expected < np.sqrt((errors[:, 1] ** 2).mean()) < 2.0 * expected


def measured_run(name: str, left: np.ndarray, times: np.ndarray, cut_from: str | None = None) -> Run:
    """A window whose left wheel has the measured speeds `left`; the right one stands."""
    signals = {"left": Logged.of(times, left), "right": Logged.of(times, np.zeros_like(times))}
    return Run(name, "train", times, np.zeros((len(times), 3)), Inputs(signals), moving=True, cut_from=cut_from)


def test_measured_commands_are_steady_but_for_their_noise() -> None:
    times, rng = np.arange(40) * 0.05, np.random.default_rng(5)
    runs = [measured_run(f"w{k}", 5.0 + 0.3 * rng.normal(size=40), times) for k in range(40)]
    groups = steady_windows(runs)
    # 95% are steady by the range of four means, and nearly all of those have means within 2% of the first.
    assert sum(map(len, groups)) >= 34
    ramps = [measured_run(f"r{k}", 5.0 + np.linspace(-1, 1, 40) + 0.3 * rng.normal(size=40), times) for k in range(40)]
    assert sum(map(len, steady_windows(ramps))) <= 4
    swings = [measured_run(f"s{k}", 5.0 + np.sin(3.0 * times + k), times) for k in range(20)]
    assert steady_windows(swings) == []


def test_windows_are_compared_inside_their_recording() -> None:
    times = np.arange(40) * 0.05
    runs = [measured_run(f"w{k}", np.full(40, 5.0), times, cut_from=f"recording{k % 2}") for k in range(6)]
    assert steady_windows(runs) == [[0, 2, 4], [1, 3, 5]]
