"""The fast functions against NumPy's, and their derivatives against the textbook."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.core.fast_math import arctan, hold, sine_cosine

RNG = np.random.default_rng(0)
SPREAD = np.concatenate([RNG.uniform(-s, s, 20_000) for s in (1e-8, 1.0, 10.0, 1e3, 1e5)])
EDGES = np.array(
    [0.0, -0.0, 1e-300, np.pi, np.pi / 2, -np.pi / 4, 3 * np.pi / 4, 0.66, -0.66, 1.0, 2.41421356237, 1e300]
)


def in_last_places(found, true):
    return np.abs(np.asarray(found) - true) / np.spacing(np.abs(true))


def test_sine_and_cosine_are_those_of_numpy() -> None:
    sine, cosine = sine_cosine(SPREAD)
    # Near a zero far from the origin the distance to it is what rounding leaves of the argument.
    for found, true in ((sine, np.sin(SPREAD)), (cosine, np.cos(SPREAD))):
        assert np.abs(np.asarray(found) - true).max() <= 2.3e-16
    near = np.abs(SPREAD) <= 1.0
    assert in_last_places(sine, np.sin(SPREAD))[near].max() <= 2
    for x in EDGES[:-1]:
        assert np.allclose(sine_cosine(x), (np.sin(x), np.cos(x)), rtol=0, atol=2.3e-16)


def test_arctan_is_that_of_numpy() -> None:
    for x in (SPREAD, EDGES):
        assert np.nanmax(np.where(x == 0, 0, in_last_places(arctan(x), np.where(x == 0, 1, np.arctan(x))))) <= 2
    np.testing.assert_array_equal(arctan(np.array([np.inf, -np.inf])), [np.pi / 2, -np.pi / 2])


def test_what_is_not_finite_is_not_hidden() -> None:
    for x in (np.nan, np.inf):
        assert np.isnan(np.asarray(sine_cosine(x))).all()
    assert np.isnan(float(arctan(np.nan)))


@pytest.mark.parametrize("x", [0.0, 0.3, -2.0, 5.5, 40.0])
def test_derivatives_in_both_modes(x) -> None:
    expected = {
        lambda x: sine_cosine(x)[0]: (np.cos(x), -np.sin(x)),
        lambda x: sine_cosine(x)[1]: (-np.sin(x), -np.cos(x)),
        arctan: (1 / (1 + x**2), -2 * x / (1 + x**2) ** 2),
    }
    for f, (first, second) in expected.items():
        assert jax.grad(f)(x) == pytest.approx(first, abs=1e-15)
        assert jax.jacfwd(jax.grad(f))(x) == pytest.approx(second, abs=1e-15)
        assert jax.jacfwd(jax.jacfwd(f))(x) == pytest.approx(second, abs=1e-15)


def test_hold_changes_nothing_under_any_transformation() -> None:
    def f(x):
        (y,) = hold(x**3)
        return y * jnp.exp(-y)

    def plain(x):
        return x**3 * jnp.exp(-(x**3))

    x = jnp.linspace(0.1, 1.0, 7)
    for change in (jax.vmap, jax.jit, lambda f: jax.vmap(jax.grad(f)), lambda f: jax.jit(jax.vmap(jax.jacfwd(f)))):
        np.testing.assert_allclose(change(f)(x), change(plain)(x), rtol=1e-14, atol=1e-15)
