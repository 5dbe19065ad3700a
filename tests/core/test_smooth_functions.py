"""Smooth functions through values at knots, against the splines of scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from snakejax.core.formula import evaluated, parsed
from snakejax.core.smooth_functions import spline, surface

LOW, HIGH = -0.5, 0.7


@pytest.mark.parametrize("n", [2, 3, 4, 9, 14])
def test_a_spline_is_the_natural_one_and_goes_on_along_its_ends(n: int) -> None:
    values = np.random.default_rng(n).normal(size=n)
    knots, v = np.linspace(LOW, HIGH, n), np.linspace(LOW, HIGH, 101)
    reference = CubicSpline(knots, values, bc_type="natural")
    np.testing.assert_allclose(spline(v, LOW, HIGH, *values), reference(v), atol=1e-11)
    for end, side in ((LOW, -1.0), (HIGH, 1.0)):
        beyond = end + side * np.array([0.1, 1.0, 3.0])
        np.testing.assert_allclose(
            spline(beyond, LOW, HIGH, *values), reference(end) + reference(end, 1) * (beyond - end), atol=1e-9
        )


def test_a_surface_is_a_spline_along_each_of_its_variables() -> None:
    rng = np.random.default_rng(1)
    values, v, w = rng.normal(size=(4, 4)), rng.uniform(LOW, HIGH, 7), rng.uniform(0.0, 2.0, 7)
    of_w = CubicSpline(np.linspace(0.0, 2.0, 4), values, axis=1, bc_type="natural")(w)
    expected = [CubicSpline(np.linspace(LOW, HIGH, 4), of_w[:, k], bc_type="natural")(v[k]) for k in range(7)]
    np.testing.assert_allclose(surface(v, LOW, HIGH, w, 0.0, 2.0, *values.ravel()), expected, atol=1e-12)


def test_both_are_parts_of_a_formula_and_have_derivatives() -> None:
    known = {"u": 0.1, "w": 0.9, **{f"c{k}": 0.3 * k**2 for k in range(4)}}
    tree = parsed("-u * spline(u, -0.5, 0.7, c0, c1, c2, c3) + surface(u, -0.5, 0.7, w, 0, 2, c0, c1, c2, c3)")

    def value(u: float) -> jax.Array:
        return evaluated(tree, known | {"u": u}, jnp)

    assert float(value(0.1)) == pytest.approx(float(evaluated(tree, known, np)), rel=1e-12)
    step = 1e-6
    slope = (float(value(0.1 + step)) - float(value(0.1 - step))) / (2 * step)
    assert float(jax.grad(value)(0.1)) == pytest.approx(slope, rel=1e-6)
