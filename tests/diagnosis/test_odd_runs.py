"""Runs that differ from the others, against refits with scipy and against chance."""

import numpy as np
import pytest
from scipy import stats

from snakejax.core.parameter import Domain
from snakejax.diagnosis.odd_runs import EXCLUDED, LEVEL, TRAIN_RUNS, OddRun, odd_runs, run_grams, run_that_alone_shows

RUNS, SAMPLES, FITTED = ("one", "two", "three", "four", "five"), 400, (0, 1, 2)
NAMES = {"tyre.D": 0, "tyre.B": 1, "tyre.C": 2, "marker_offset.x": 3, "yaw_bias.b": 4}


def made_up(seed: int, alike: float = 0.0, **shift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, columns and run numbers of five runs; in run three the parameters of `shift` are off by so many
    standard errors that this run alone would have of them. `alike`: the correlation of the last three columns."""
    rng = np.random.default_rng(seed)
    C = rng.normal(size=(len(RUNS) * SAMPLES, len(NAMES)))
    C[:, 3:] = alike * C[:, [2]] + np.sqrt(1.0 - alike**2) * C[:, 3:]
    C[:, 1] += 0.8 * C[:, 0]
    run = np.repeat(np.arange(len(RUNS)), SAMPLES)
    r = rng.normal(size=len(C)) + C[:, FITTED] @ np.array([0.3, -0.1, 0.2])
    for name, size in shift.items():
        odd = C[run == 2, NAMES[name.replace("__", ".")]]
        r[run == 2] += size / np.linalg.norm(odd) * odd
    return r, C, run


def found_in(seed: int, alike: float = 0.0, **shift: float) -> tuple[OddRun, ...]:
    return odd_runs(run_grams(*made_up(seed, alike, **shift)), RUNS, NAMES, FITTED)


def test_the_shift_is_that_of_a_refit_with_a_value_of_its_own() -> None:
    r, C, run = made_up(1, marker_offset__x=8.0)
    (odd,) = odd_runs(run_grams(r, C, run), RUNS, NAMES, FITTED)
    own = np.where(run == 2, C[:, 3], 0.0)
    A = np.column_stack([C[:, FITTED], own])
    covariance = np.linalg.inv(A.T @ A)
    assert (odd.run, odd.parameter) == ("three", "marker_offset.x")
    assert odd.shift == pytest.approx((covariance @ A.T @ r)[-1], rel=1e-9)
    assert odd.sd == pytest.approx(covariance[-1, -1] ** 0.5, rel=1e-9)
    fall = ((r - C[:, FITTED] @ np.linalg.lstsq(C[:, FITTED], r, rcond=None)[0]) ** 2).sum() - (
        (r - A @ np.linalg.lstsq(A, r, rcond=None)[0]) ** 2
    ).sum()
    assert odd.fall == pytest.approx(fall, rel=1e-9)
    assert odd.p_value == pytest.approx(stats.chi2.sf(fall, 1) * len(RUNS) * len(NAMES), rel=1e-6)


def test_a_run_is_called_odd_by_chance_as_often_as_the_level_says() -> None:
    """Of 1000 boards without an odd run 50 are expected, not fewer because three of the parameters act alike."""
    false = sum(bool(found_in(10_000 + k, alike=0.99)) for k in range(1000))
    assert stats.binom.ppf(0.002, 1000, LEVEL) <= false <= stats.binom.isf(0.002, 1000, LEVEL)


def test_a_run_with_another_tyre_is_found() -> None:
    """Seven standard errors of the run alone: the others share a fifth of it, chi^2 falls by 39 on average."""
    found = [found_in(2000 + k, tyre__D=7.0) for k in range(50)]
    assert sum(bool(odd) and odd[0].run == "three" for odd in found) >= 47
    named = [odd[0] for odd in found if odd]
    assert sum("tyre.D" in (odd.parameter, *odd.alike) for odd in named) >= 45


def test_a_shift_of_five_standard_errors_is_named() -> None:
    """Standard errors of the shift, with everything else fitted as well."""
    found = []
    for k in range(100):
        r, C, run = made_up(8000 + k)
        own = np.column_stack([C[:, FITTED], np.where(run == 2, C[:, 3], 0.0)])
        sd = np.linalg.inv(own.T @ own)[-1, -1] ** 0.5
        found.append(odd_runs(run_grams(r + 5.0 * sd * own[:, -1], C, run), RUNS, NAMES, FITTED))
    assert sum(bool(odd) and odd[0].run == "three" for odd in found) >= 95


def test_a_run_that_is_far_off_makes_no_other_odd() -> None:
    """It moves what is fitted in common, by which the others fail too."""
    found = [found_in(3000 + k, tyre__D=60.0) for k in range(50)]
    assert [odd[0].run for odd in found] == ["three"] * 50
    assert sum(len(odd) > 1 for odd in found) <= 3


def test_of_two_runs_none_is_the_odd_one() -> None:
    r, C, run = made_up(3, tyre__D=50.0)
    keep = (run == 1) | (run == 2)
    gram = run_grams(r[keep], C[keep], run[keep] - 1)
    assert len(gram) < TRAIN_RUNS
    assert odd_runs(gram, RUNS[1:3], NAMES, FITTED) == ()


def test_a_parameter_that_a_run_does_not_show_is_not_blamed() -> None:
    r, C, run = made_up(4)
    C[run == 2, 4] = 0.0
    r[run == 2] += 100.0 * C[run == 2, 3]
    (odd, *_) = odd_runs(run_grams(r, C, run), RUNS, NAMES, FITTED)
    assert (odd.parameter, odd.alike) == ("marker_offset.x", ())
    assert all(np.isfinite((other.shift, other.sd)).all() for other in (odd, *_))


def test_a_shift_of_a_logarithm_is_told_in_units() -> None:
    odd = OddRun("one", "tyre.D", 0.1, 0.02, 1e-4)
    told = odd.in_units(Domain("N", 0.0, np.inf, positive=True, multiplicative=True), 5.0)
    assert (told.shift, told.sd) == pytest.approx((0.5, 0.1))
    assert odd.in_units(Domain("m", -np.inf, np.inf, positive=False, multiplicative=False), 5.0) == odd


def test_a_parameter_that_no_run_shows_changes_nothing() -> None:
    r, C, run = made_up(3, marker_offset__x=8.0)
    shown = odd_runs(run_grams(r, C, run), RUNS, NAMES, FITTED)
    unseen = np.column_stack([C, np.zeros(len(C)), C[:, 1]])
    more = odd_runs(run_grams(r, unseen, run), RUNS, NAMES, (*FITTED, 5, 6))
    assert [odd.run for odd in shown] == [odd.run for odd in more] == ["three"]
    assert more[0].shift == pytest.approx(shown[0].shift, rel=1e-6)


def shown_by(seed: int, runs: tuple[int, ...], size: float) -> int | None:
    """Of an effect of `size` standard errors of a single run in the `runs`, fitted to all: the run that alone shows it,
    from the fit on."""
    r, C, run = made_up(seed)
    fitted = [*FITTED, 3]
    r[np.isin(run, runs)] += size / np.sqrt(SAMPLES) * C[np.isin(run, runs), 3]
    step = np.linalg.lstsq(C[:, fitted], r, rcond=None)[0]
    return run_that_alone_shows(run_grams(r - C[:, fitted] @ step, C, run), fitted, [3], step[-1:])


def test_an_effect_of_one_run_is_told_from_one_of_all() -> None:
    alone = [shown_by(4000 + k, (2,), 20.0) for k in range(50)]
    assert sum(run == 2 for run in alone) >= 45 and set(alone) <= {2, None}
    assert [shown_by(5000 + k, (0, 1, 2, 3, 4), 20.0) for k in range(50)] == [None] * 50
    weak = [shown_by(6000 + k, (0, 1, 2, 3, 4), 3.0) for k in range(200)]
    assert sum(run is not None for run in weak) <= stats.binom.isf(0.003, 200, EXCLUDED)


def test_an_effect_that_the_others_cannot_show_is_not_of_one_run() -> None:
    """Where only one run excites an effect, the others do not exclude it."""
    r, C, run = made_up(1)
    C[run != 2, 3] *= 0.02
    fitted = [*FITTED, 3]
    r += C[:, 3]
    step = np.linalg.lstsq(C[:, fitted], r, rcond=None)[0]
    assert run_that_alone_shows(run_grams(r - C[:, fitted] @ step, C, run), fitted, [3], step[-1:]) is None
