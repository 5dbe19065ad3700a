"""The nearest Rayleigh board, against published numbers and a search that shares nothing with it."""

import jax
import numpy as np
import pytest
from scipy import optimize

from snakejax import Accuracy, Model, Rayleigh, nearest_rayleigh, polynomial, preset, simulate
from snakejax.core.parameter import with_parameters
from snakejax.effects import BodyDrag, GripGradient
from snakejax.simulation.rayleigh_match import FOLLOWS, rayleigh

SHARP = Accuracy(rtol=1e-9, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(("load", "camber", "k_s", "mismatch"), [(2.54, 0.52, 10.6, 0.005), (5.08, 0.3, 77.0, 0.001)])
def test_the_rayleigh_board_nearest_to_the_papers_first_gait(load, camber, k_s, mismatch) -> None:
    """Claim P6: "shape and distance agree closely"; the numbers are those of an independent integration."""
    example = preset("paper-gait1", load, camber)
    found = nearest_rayleigh(example.model, example.gait, example.times, {"tyre.load": [load]})
    assert found.k_s.values[0] == pytest.approx(k_s, rel=0.01)
    assert found.mismatch.values[0] == pytest.approx(mismatch, rel=0.3)


@pytest.mark.slow
def test_the_nearest_k_s_is_that_of_a_scalar_search_and_its_polynomial_that_of_numpy() -> None:
    example = preset("paper-rotate")
    D = np.linspace(1.0, 8.0, 8)
    found = nearest_rayleigh(example.model, example.gait, example.times, {"tyre.D": D})

    run = jax.jit(lambda model: simulate(model, example.gait, example.times, accuracy=SHARP).pose[:, :2])
    for lane in (0, 3, 7):
        target = np.asarray(run(with_parameters(example.model, {"tyre.D": D[lane]})))
        length = np.linalg.norm(np.diff(target, axis=0), axis=1).sum()

        def mismatch(log_k, target=target, length=length):
            away = np.asarray(run(rayleigh(example.model, float(np.exp(log_k))))) - target
            return np.sqrt((away**2).sum(axis=1).mean()) / length

        k_s = found.k_s.values[lane]
        ends = (np.log(k_s / 2), np.log(k_s * 2))
        best = optimize.minimize_scalar(mismatch, bounds=ends, method="bounded", options={"xatol": 1e-7})
        assert k_s == pytest.approx(np.exp(best.x), rel=1e-4)
        assert found.mismatch.values[lane] == pytest.approx(best.fun, rel=1e-5)
        assert found.path.values[lane] == pytest.approx(length, rel=1e-6)
    curve = polynomial(D, found.k_s.values)
    np.testing.assert_allclose(np.polyval(np.polyfit(D, found.k_s, 4), D), curve(D), rtol=1e-6)
    assert curve.r_squared > 0.99


def test_where_no_k_s_fits_the_polynomial_keeps_to_the_longest_stretch() -> None:
    x = np.arange(12.0)
    k_s = 1 + x + 0.1 * x**4
    k_s[[2, 3]] = np.nan
    found = polynomial(x, k_s)
    assert found.fitted_range == (4.0, 11.0)
    assert found.coefficients == pytest.approx((0.1, 0, 0, 1, 1), abs=1e-8)
    assert found.r_squared == pytest.approx(1.0)
    assert polynomial(x, np.where(x < 5, k_s, np.nan)) is None


@pytest.mark.slow
def test_a_board_that_no_rayleigh_board_follows_has_no_k_s_but_a_mismatch() -> None:
    """Claim P9. A board without traction slides, which no k_s of the grid does."""
    example = preset("paper-forward")
    times = np.linspace(0, 7.7, 101)
    found = nearest_rayleigh(example.model, example.gait, times, {"tyre.D": [1e-6, 3.0]})
    assert np.isnan(found.k_s.values[0]) and found.mismatch.values[0] > 0
    assert np.isfinite(found.best.values).all()
    assert found.k_s.values[1] == found.best.values[1] and found.mismatch.values[1] < FOLLOWS


def test_a_rayleigh_board_keeps_what_needs_no_slip_angle() -> None:
    model = preset("paper-rotate").model.add(grip=GripGradient(g=0.1), drag=BodyDrag(c=1.0))
    found = rayleigh(model, 3.0)
    assert isinstance(found.tyre, Rayleigh) and float(found.tyre.k_s) == 3.0
    assert list(found.effects) == ["drag"] and float(found.effects["drag"].c) == 1.0


@pytest.mark.slow
def test_where_an_effect_is_varied_each_board_is_compared_with_rayleigh_boards_that_have_it() -> None:
    example = preset("paper-forward")
    base = example.model.add(body_drag=BodyDrag())
    together = nearest_rayleigh(base, example.gait, example.times, {"effects.body_drag.c": [0.0, 30.0]})
    fixed = with_parameters(base, {"effects.body_drag.c": 30.0})
    alone = nearest_rayleigh(fixed, example.gait, example.times, {"tyre.D": [float(fixed.tyre.D)]})
    assert together.mismatch.values[1] == pytest.approx(alone.mismatch.values[0], rel=1e-9)
    np.testing.assert_allclose(together.best.values[1], alone.best.values[0], rtol=1e-9)


def test_boards_of_their_own_kind_and_tyres_beyond_their_formulas_are_refused() -> None:
    example = preset("paper-rotate")
    for model in (rayleigh(example.model, 3.0), Model(example.model.board, example.model.tyre, "ideal")):
        with pytest.raises(ValueError, match="found for Pacejka boards only"):
            nearest_rayleigh(model, example.gait, [1.0], {"board.mass": [7.0]})
    with_payload = preset("paper-gait1")
    with pytest.raises(ValueError, match="beyond Bakker's formulas"):
        nearest_rayleigh(with_payload.model, with_payload.gait, [1.0], {"tyre.camber": [0.0, 1.0]})


def test_a_constant_k_s_has_no_r_squared() -> None:
    assert polynomial(np.arange(7.0), np.full(7, 9.0)).r_squared is None
    assert polynomial(np.arange(7.0), 9.0 + 1e-12 * np.arange(7.0)).r_squared is None


@pytest.mark.long
def test_a_board_that_cannot_be_simulated_is_told_from_one_that_none_follows(monkeypatch) -> None:
    from snakejax.simulation import parameter_sweep

    monkeypatch.setattr(parameter_sweep, "ACCURACY", Accuracy(rtol=1e-7, atol=1e-9, max_steps=20_000))
    example = preset("paper-rotate")
    found = nearest_rayleigh(example.model, example.gait, np.linspace(0, 2, 41), {"tyre.D": [1.0, 1e9]})
    assert np.isfinite(found.x.values[0]) and np.isfinite(found.mismatch.values[0])
    assert np.isinf(found.x.values[1]) and np.isnan([found[n].values[1] for n in ("k_s", "best", "mismatch")]).all()
