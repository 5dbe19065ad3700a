"""Comparison against residuals whose answer is known, and against a recording whose model is right."""

import equinox as eqx
import numpy as np
import pytest
import scipy.signal
from helpers.folders import DATA
from scipy import stats

from snakejax.core.errors import FitError
from snakejax.diagnosis.residuals import comparison
from snakejax.diagnosis.residuals.comparison import compare, compare_models
from snakejax.diagnosis.residuals.dependence import (
    LEVEL,
    VarianceShare,
    general_name,
    rate,
    residual_dependence,
    significant_shares,
)
from snakejax.diagnosis.residuals.intervals import interval_misfits, largest_residuals
from snakejax.diagnosis.residuals.replays import ResidualSeries, gait_phase
from snakejax.diagnosis.residuals.whiteness import autocorrelation, portmanteau, whiteness
from snakejax.estimation.fitting import fit
from snakejax.estimation.initial_model import starting_model
from snakejax.recording.case import load_case

TIMES = np.arange(0.0, 12.0, 0.01)
SD = np.array([0.0004, 0.0004, 0.0025])
GAITS = (4.0, 2.5, 3.1, 3.7)
"""Angular frequencies [rad/s] of four runs."""


def track(residual: np.ndarray, frequency: float = 4.0, name: str = "run", seed: int = 0) -> ResidualSeries:
    """A run that sways and turns, with a residual (n, 3) of our own."""
    wander = np.random.default_rng(seed + 1000).uniform(0.5, 1.5, 3)
    variables = {
        "gait_phase": np.mod(frequency * TIMES, 2 * np.pi),
        "x": 0.2 * TIMES * wander[0] + 0.05 * np.sin(frequency * TIMES),
        "heading": 0.6 * np.sin(0.31 * wander[1] * TIMES),
        "speed": 0.2 + 0.1 * np.sin(0.9 * wander[2] * TIMES + wander[0]),
        "time": TIMES,
    }
    return ResidualSeries(name, "train", TIMES, residual, SD, variables)


def noise(seed: int, lost: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    residual = rng.normal(size=(TIMES.size, 3))
    residual[rng.uniform(size=TIMES.size) < lost] = np.nan
    return residual


def slow_noise(seed: int, memory: float) -> np.ndarray:
    """Noise of variance 1 that forgets itself in `memory` [s]."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-(TIMES[1] - TIMES[0]) / memory)
    found = np.empty((TIMES.size, 3))
    found[0] = rng.normal(size=3)
    for k, kick in enumerate(rng.normal(size=(TIMES.size - 1, 3)) * np.sqrt(1 - keep**2)):
        found[k + 1] = keep * found[k] + kick
    return found


def runs(residuals) -> list[ResidualSeries]:
    return [track(r, f, f"run-{k}", k) for k, (f, r) in enumerate(zip(GAITS, residuals, strict=True))]


# --- Where and when --------------------------------------------------------------------------------------------------


def test_a_failing_second_is_found_in_its_channel() -> None:
    residual = np.where(np.arange(3) == 1, 5.0, 1.0) * np.ones((TIMES.size, 1))
    residual[:, 1] = np.where((TIMES >= 4.0) & (TIMES < 5.0), 5.0, 1.0)
    found = interval_misfits(track(residual), 1.0)
    assert len(found) == 36 and sum(s.samples for s in found) == 3 * TIMES.size
    bad = max(found, key=lambda s: s.misfit)
    assert (bad.channel, round(bad.begin), round(bad.end)) == ("y", 4, 5)
    assert 22.0 < bad.misfit <= 25.0
    assert all(s.misfit == pytest.approx(1.0) for s in found if s.channel != "y")


def test_a_stretch_without_a_sample_is_left_out() -> None:
    residual = noise(0)
    residual[(TIMES >= 2.0) & (TIMES < 4.5), 2] = np.nan
    begins = [round(s.begin) for s in interval_misfits(track(residual)) if s.channel == "heading"]
    assert begins == [0, 1, *range(4, 12)]


def test_the_worst_moments_lie_apart_and_have_units() -> None:
    residual = 0.1 * noise(1)
    residual[500:510, 0], residual[900, 2], residual[100, 1] = -9.0, 7.0, np.nan
    residual[505, 0] = -9.5
    first, second, third = largest_residuals([track(residual)], 3)
    assert first == ("run", TIMES[505], "x", -9.5, pytest.approx(-9.5 * 0.0004))
    assert second == ("run", TIMES[900], "heading", 7.0, pytest.approx(7.0 * 0.0025))
    assert abs(third.deviations) < 1.0


# --- Is it noise? ----------------------------------------------------------------------------------------------------


def test_portmanteau_without_gaps_is_ljung_and_box() -> None:
    """Q = n (n + 2) sum_k r_k^2 / (n - k) with r_k the autocorrelation at lag k."""
    e, n = noise(2)[:300, 0], 300
    r = np.array([e[k:] @ e[:-k] for k in range(1, 11)]) / (e @ e)
    expected = n * (n + 2) * np.sum(r**2 / (n - np.arange(1, 11)))
    statistic, lags, p_value = portmanteau(e, 10)
    assert (statistic, lags) == (pytest.approx(expected, rel=1e-12), 10)
    assert p_value == pytest.approx(stats.chi2.sf(expected, 10), rel=1e-9)


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("draw", ["normal", "uniform", "laplace"])
def test_portmanteau_rejects_noise_in_one_case_of_twenty(lost: float, draw: str) -> None:
    rng = np.random.default_rng(3)
    count, n = 1500, 500
    samples = getattr(rng, draw)(size=(count, n)) - (0.5 if draw == "uniform" else 0.0)
    samples[rng.uniform(size=(count, n)) < lost] = np.nan
    rejected = np.mean([portmanteau(row)[2] < 0.05 for row in samples])
    assert 0.035 < rejected < 0.068  # three standard deviations of 1500 draws


def test_portmanteau_with_long_gaps() -> None:
    rng = np.random.default_rng(4)
    samples = rng.normal(size=(1500, 600))
    samples[:, 100:350] = np.nan
    assert 0.033 < np.mean([portmanteau(row)[2] < 0.05 for row in samples]) < 0.068


@pytest.mark.parametrize("structure", ["slow", "offset", "swing"])
def test_a_weak_structure_is_not_white(structure: str) -> None:
    part = {"slow": slow_noise(5, 0.5), "offset": 1.0, "swing": np.sin(4.0 * TIMES)[:, None]}[structure]
    assert all(test.p_value < 1e-6 for test in whiteness(track(noise(6) + 0.4 * part)))


def test_what_was_never_seen_is_not_tested() -> None:
    residual = noise(7)
    residual[:, 2] = np.nan
    assert [test.channel for test in whiteness(track(residual))] == ["x", "y"]
    assert portmanteau(np.zeros(50))[2] == 1.0


# --- What does it depend on? -----------------------------------------------------------------------------------------


def test_the_variable_is_found_and_its_share_is_right() -> None:
    """y = sqrt(2) sin(phase) + noise: half of the variance of y is of the gait phase, nothing of the others."""
    residuals = [noise(k) for k in range(4)]
    for residual, frequency in zip(residuals, GAITS, strict=True):
        residual[:, 1] += np.sqrt(2) * np.sin(frequency * TIMES + 0.7)
    found = residual_dependence(runs(residuals))
    best = found[0]
    assert (best.variable, best.channel) == ("gait_phase", "y")
    assert best.share == pytest.approx(0.5, abs=0.03) and best.p_family < 0.01
    assert not [s for s in found if s.p_family < 0.05 and s.variable != "gait_phase"]


def test_only_what_is_not_chance_is_named_by_its_general_name() -> None:
    """The level is that of the family; place and slips have parts, a speed has none."""
    shares = [VarianceShare("slip_front", "x", 0.3, 0.001, LEVEL), VarianceShare("y", "x", 0.2, 0.001, 1.01 * LEVEL)]
    assert significant_shares(shares) == (shares[0],)
    names = ["x", "y", "slip_front", "slip_back", "speed", "heading", "gait_phase"]
    general = ["world_position"] * 2 + ["slip"] * 2 + names[4:]
    assert [general_name(name) for name in names] == general


def test_a_bend_over_place_is_found() -> None:
    """A curve, not a straight line: the residual of the heading grows with the square of the speed."""
    seen = runs([noise(10 + k, lost=0.1) for k in range(4)])
    for run in seen:
        run.residual[:, 2] += 80.0 * (run.variables["speed"] - 0.2) ** 2
    significant = [s for s in residual_dependence(seen) if s.p_family < 0.05]
    assert (significant[0].variable, significant[0].channel) == ("speed", "heading")


def test_what_accumulates_is_found_in_its_rate() -> None:
    """The board's forward speed is wrong with the gait; x and y drift away, and the world hides it."""
    seen = runs([noise(20 + k) for k in range(4)])
    for run, frequency in zip(seen, GAITS, strict=True):
        speed = 60.0 * np.cos(frequency * TIMES) + 40.0 * slow_noise(int(frequency * 10), 1.0)[:, 0]
        heading = run.variables["heading"]
        run.residual[:, :2] += np.cumsum(speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1), 0) * 0.01
    significant = [s for s in residual_dependence(seen) if s.p_family < 0.05]
    assert ("gait_phase", "forward_rate") in {(s.variable, s.channel) for s in significant}


def test_the_rate_is_turned_into_the_board() -> None:
    residual = np.stack([2.0 * TIMES, 3.0 * TIMES, 5.0 * TIMES], axis=1)
    run = track(residual)
    run.variables["heading"][:] = np.pi / 2
    np.testing.assert_allclose(rate(run)[100:-100], np.tile([3.0, -2.0, 5.0], (TIMES.size - 200, 1)), atol=1e-9)
    assert np.isnan(rate(run)[[0, -1]]).all()


@pytest.mark.parametrize("memory", [0.0, *(pytest.param(memory, marks=pytest.mark.slow) for memory in (0.1, 0.3))])
def test_chance_is_called_chance(memory: float) -> None:
    """Of 60 sets of runs about 3 may be called dependent at 5% for the whole family; 8 has probability 1%."""
    draw = (lambda seed: slow_noise(seed, memory)) if memory else noise
    least = [
        min(s.p_family for s in residual_dependence(runs([draw(4 * k + j) for j in range(4)]), flips=199))
        for k in range(60)
    ]
    assert sum(p <= 0.05 for p in least) <= 7


def test_the_gait_phase_is_that_of_the_largest_swing() -> None:
    for frequency in (0.9, 2.1, 4.0):
        angle = 0.5 * np.sin(frequency * TIMES + 0.3) + 0.1 * np.sin(2 * frequency * TIMES)
        away = gait_phase(TIMES, np.zeros_like(TIMES), angle) - frequency * TIMES
        assert np.abs(np.angle(np.exp(1j * away))).max() < 0.15
    assert not gait_phase(TIMES, np.zeros_like(TIMES)).any()


# --- Recordings ------------------------------------------------------------------------------------------------------


def some_runs(case, *names: str):
    """`case` with the runs named alone: fits take their time."""
    return eqx.tree_at(lambda c: c.runs, case, tuple(run for run in case.runs if run.name in names))


@pytest.mark.slow
def test_the_right_model_leaves_noise_and_a_wrong_one_does_not(recordings) -> None:
    names = ("train-forward-1", "train-arc-1", "train-wander-1", "heldout-reverse-1")
    case = some_runs(load_case(recordings / "board-h"), *names)
    found = fit(starting_model(case), case.runs, case.noise)
    seen = compare(found)
    assert seen.white and not seen.depends_on
    misfits = [s.misfit for s in seen.stretches]
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.02) and max(misfits) < 2.0
    assert abs(seen.worst[0].deviations) < 5.0
    assert {s.run for s in seen.stretches} == {run.name for run in case.runs}
    wrong = compare(fit(starting_model(case, "rayleigh"), case.runs, case.noise))
    assert not wrong.white and max(s.misfit for s in wrong.stretches) > 100.0
    assert wrong.depends_on, "Its force is wrong, and what it fails with repeats with the gait."


@pytest.mark.slow
def test_side_by_side(recordings) -> None:
    case = some_runs(load_case(recordings / "board-h"), "train-forward-1", "train-arc-1", "heldout-reverse-1")
    ideal, pacejka = compare_models(case, ("ideal", "pacejka"))
    assert (ideal.model, pacejka.model) == ("ideal", "pacejka")
    assert ideal.train and pacejka.train and pacejka.heldout and pacejka.failure is None
    assert pacejka.train.misfit < 1.1 < 100.0 < ideal.train.misfit
    assert pacejka.heldout.position_m < 0.001


def test_models_side_by_side_have_the_structure_and_the_loss_that_are_asked_for(monkeypatch) -> None:
    case, asked = load_case(DATA / "level-board"), []

    def fitted(model, runs, noise, *, threshold):
        asked.append((model.structure, threshold))
        raise FitError("not fitted")

    monkeypatch.setattr(comparison, "fit", fitted)
    sides = compare_models(case, ("ideal", "pacejka"), structure="coupled", threshold=3.0)
    assert asked == [("ideal", 3.0), ("coupled", 3.0)] and {side.failure for side in sides} == {"not fitted"}


def test_autocorrelation_is_that_of_an_autoregressive_process() -> None:
    """rho_k = a^k for e_t = a e_{t-1} + noise, in two runs with gaps; white noise stays within the bound."""
    random, a = np.random.default_rng(3), 0.8
    noise = random.standard_normal((2, 40_000))
    runs = scipy.signal.lfilter([1.0], [1.0, -a], noise, axis=1)
    runs[:, random.random(40_000) < 0.1] = np.nan
    values, _ = autocorrelation(list(runs), 6)
    assert values == pytest.approx(a ** np.arange(6), abs=0.03)
    white, bound = autocorrelation(list(noise), 40)
    assert white[0] == pytest.approx(1.0) and bound == pytest.approx(1.96 / np.sqrt(2 * 39_999))
    assert np.mean(np.abs(white[1:]) < bound) > 0.85
