"""Sweeps against published numbers and against a search that shares nothing with theirs."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from snakejax import Accuracy, Rayleigh, nearest_rayleigh, preset, simulate
from snakejax._cli._options import varied
from snakejax._errors import InputError
from snakejax._sweep import FOLLOWS, _summed_up, rayleigh
from snakejax._units import with_parameters


@pytest.mark.slow
@pytest.mark.parametrize(("load", "camber", "k_s", "mismatch"), [(2.54, 0.52, 10.6, 0.005), (5.08, 0.3, 77.0, 0.001)])
def test_the_rayleigh_board_nearest_to_the_papers_first_gait(load, camber, k_s, mismatch) -> None:
    """Claim P6: "shape and distance agree closely"; the numbers are those of an independent integration."""
    example = preset("paper-gait1", load, camber)
    found = nearest_rayleigh([example.model], [load], example.gait, example.times)
    assert found.k_s[0] == pytest.approx(k_s, rel=0.01)
    assert found.mismatch[0] == pytest.approx(mismatch, rel=0.3)


@pytest.mark.slow
def test_the_nearest_k_s_is_that_of_a_scalar_search_and_its_polynomial_that_of_numpy() -> None:
    example = preset("paper-rotate")
    D = np.linspace(1.0, 8.0, 8)
    models = [with_parameters(example.model, {"tyre.D": d}) for d in D]
    found = nearest_rayleigh(models, D, example.gait, example.times)

    def pose(model):
        return np.asarray(simulate(model, example.gait, example.times, accuracy=Accuracy(rtol=1e-8)).pose)[:, :2]

    target = pose(models[3])
    length = np.linalg.norm(np.diff(target, axis=0), axis=1).sum()

    def mismatch(log_k):
        away = pose(rayleigh(models[3], float(np.exp(log_k)))) - target
        return np.sqrt((away**2).sum(axis=1).mean()) / length

    best = optimize.minimize_scalar(
        mismatch, bounds=(np.log(found.k_s[3] / 2), np.log(found.k_s[3] * 2)), method="bounded", options={"xatol": 1e-6}
    )
    assert found.k_s[3] == pytest.approx(np.exp(best.x), rel=1e-4)
    assert found.mismatch[3] == pytest.approx(best.fun, rel=1e-5)
    np.testing.assert_allclose(np.polyval(np.polyfit(D, found.k_s, 4), D), np.polyval(found.polynomial, D), rtol=1e-6)
    assert found.r_squared > 0.99


def test_where_no_k_s_fits_there_is_none_and_the_polynomial_keeps_to_the_longest_stretch() -> None:
    x = np.arange(12.0)
    k_s = 1 + x + 0.1 * x**4
    k_s[[2, 3]] = np.nan
    found = _summed_up(x, k_s, np.full(12, FOLLOWS / 2))
    assert found.fitted_range == (4.0, 11.0)
    assert found.polynomial == pytest.approx((0.1, 0, 0, 1, 1), abs=1e-8)
    assert found.r_squared == pytest.approx(1.0)
    few = _summed_up(x, np.where(x < 5, k_s, np.nan), np.full(12, 0.05))
    assert (few.polynomial, few.r_squared, few.fitted_range) == (None, None, None)


def test_a_rayleigh_board_keeps_what_needs_no_slip_angle() -> None:
    from snakejax.effects import BodyDrag, GripGradient

    model = preset("paper-rotate").model.add(grip=GripGradient(g=0.1), drag=BodyDrag(c=1.0))
    found = rayleigh(model, 3.0)
    assert isinstance(found.tyre, Rayleigh) and float(found.tyre.k_s) == 3.0
    assert list(found.effects) == ["drag"] and jnp.isclose(found.effects["drag"].c, 1.0)


@pytest.mark.parametrize("text", ["D", "D=1:2", "D=1:2:one", "D=2:1:5", "=1:2:3", "D=1:2:1", "D=nan:2:3"])
def test_values_that_are_none_are_refused(text) -> None:
    with pytest.raises(InputError, match="--vary"):
        varied(text)


@pytest.mark.slow
def test_where_an_effect_is_varied_each_board_is_compared_with_rayleigh_boards_that_have_it() -> None:
    from snakejax.effects import BodyDrag

    example = preset("paper-forward")
    base = example.model.add(body_drag=BodyDrag())
    models = [with_parameters(base, {"effects.body_drag.c": c}) for c in (0.0, 30.0)]
    together = nearest_rayleigh(models, [0.0, 30.0], example.gait, example.times)
    alone = nearest_rayleigh(models[1:], [30.0], example.gait, example.times)
    assert together.mismatch[1] == pytest.approx(alone.mismatch[0], rel=1e-9)
    np.testing.assert_allclose(together.k_s[1], alone.k_s[0], rtol=1e-9)
