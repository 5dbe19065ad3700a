"""Levenberg and Marquardt's least squares on problems whose minimum is known, and the bounds of parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from snakejax.core.parameter import Domain
from snakejax.estimation.levenberg_marquardt import Curvature, StoppingRule, levenberg_marquardt
from snakejax.estimation.linear_residuals import LinearResiduals
from snakejax.estimation.linearisation import REACH, Variables, retract


def rule(enough=1e-12, crawl=0.0, samples=1e9, most=60):
    return StoppingRule(jnp.asarray(enough), jnp.asarray(crawl), jnp.asarray(samples), jnp.asarray(most))


def linearised(residuals, z):
    """`residuals` at `z` as those of one run, all of whose variables are parameters."""
    z = jnp.asarray(z, float)
    r, J, none = residuals(z), jax.jacfwd(residuals)(z), np.zeros(len(z))
    return LinearResiduals(np.asarray(r)[None], np.asarray(J)[None], none, none)


def minimum(residuals, start, unit=1.0, **ending):
    """z, the residuals there, the number of steps, and whether nothing is left to gain."""
    ended = levenberg_marquardt(
        lambda z: linearised(residuals, z), np.asarray(start), jnp.asarray(unit), rule(**ending)
    )
    return ended.z, ended.residuals.residual[0], ended.steps, ended.settled


def test_a_quadratic_ends_where_the_normal_equations_say():
    draw = np.random.default_rng(0)
    # Columns of sizes from 1e-3 to 1e3: the steps must not depend on units.
    J, y = draw.normal(size=(40, 4)) * np.array([1e-3, 1.0, 30.0, 1e3]), draw.normal(size=40)
    z, r, _, settled = minimum(lambda z: jnp.asarray(J) @ z - jnp.asarray(y), np.zeros(4))
    best = np.linalg.lstsq(J, y, rcond=None)[0]
    np.testing.assert_allclose(z * np.abs(J).max(axis=0), best * np.abs(J).max(axis=0), atol=1e-6)
    np.testing.assert_allclose(r, J @ best - y, atol=1e-6)
    assert settled


def test_the_valley_of_rosenbrock_is_followed_to_its_end():
    z, _, steps, settled = minimum(lambda z: jnp.stack([10 * (z[1] - z[0] ** 2), 1 - z[0]]), [-1.2, 1.0])
    np.testing.assert_allclose(z, [1.0, 1.0], atol=1e-6)
    assert settled and steps < 60


def bent(z):
    """Residuals with a second derivative: that along d is q(d) = (2 d0^2, 2 d0 d1, 0, 0) at any point."""
    return jnp.stack([z[0] ** 2 + z[1], z[0] * z[1] - z[2], z[1] + 2 * z[2], z[2] - 1.0])


def test_a_step_is_bent_by_the_second_derivative_that_the_step_before_showed():
    """a / 2 of min |J a + q(d)|^2 + |D a|^2, and nothing where the steps have other directions."""
    at, tried = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.005])
    here, there = linearised(bent, at), linearised(bent, at + tried)
    second = here.beyond(tried, there)
    np.testing.assert_allclose(second[0], [2 * tried[0] ** 2, 2 * tried[0] * tried[1], 0, 0], atol=1e-15)
    damping, step = np.array([3.0, 4.0, 5.0]), 0.5 * tried
    J, wanted = here.jacobian[0], np.array([2 * step[0] ** 2, 2 * step[0] * step[1], 0, 0])
    expected = -np.linalg.solve(J.T @ J + np.diag(damping**2), J.T @ wanted) / 2
    curvature = Curvature(tried, second)
    np.testing.assert_allclose(curvature.acceleration(here, step, damping), expected, rtol=1e-9)
    assert not curvature.acceleration(here, np.array([0.01, 0.02, 0.0]), damping).any()


def test_a_step_to_where_the_residuals_are_not_finite_is_taken_back():
    """ln z from 8 to 1: an undamped step leads below zero, where there is no logarithm."""
    z, r, _, settled = minimum(lambda z: jnp.stack([jnp.log(z[0]), 1e-3 * z[0]]), [8.0])
    assert settled and np.isfinite(r).all() and z[0] == pytest.approx(1.0, abs=1e-4)


def test_a_start_without_finite_residuals_ends_there():
    z, _, _, settled = minimum(lambda z: jnp.stack([jnp.log(z[0]), z[0]]), [-1.0])
    assert z[0] == -1.0 and not settled


def canyon(z):
    """A valley that bends: walls 100 times as steep as its floor, along a sine."""
    return jnp.stack([100 * (z[1] - jnp.sin(z[0])), z[0] - 2.0])


def test_a_bending_canyon_is_followed_in_fewer_steps_than_scipy_takes():
    """Moré's MINPACK, which scipy calls, with as many derivatives: each of its steps is straight."""
    z, _, steps, settled = minimum(canyon, [0.0, 0.0], unit=30.0, enough=1e-9)
    np.testing.assert_allclose(z, [2.0, np.sin(2.0)], atol=1e-5)
    jacobian = jax.jit(jax.jacfwd(canyon))
    theirs = least_squares(jax.jit(canyon), [0.0, 0.0], lambda z: np.asarray(jacobian(z)), method="lm", max_nfev=2000)
    np.testing.assert_allclose(theirs.x, z, atol=1e-3)
    assert settled and steps < theirs.nfev


def test_the_first_step_is_damped_by_the_unit():
    """min |J d + r|^2 + |D d|^2 / unit^2, D the norms of the columns; of the first two steps one looks at the start."""
    draw = np.random.default_rng(3)
    J, r, unit = draw.normal(size=(30, 3)) * np.array([1.0, 20.0, 300.0]), draw.normal(size=30), 2.0
    z, _, steps, settled = minimum(lambda z: jnp.asarray(J) @ z + jnp.asarray(r), np.zeros(3), unit=unit, most=2)
    assert steps == 2 and not settled
    normal = J.T @ J
    np.testing.assert_allclose(z, -np.linalg.solve(normal + np.diag(np.diag(normal)) / unit**2, J.T @ r), rtol=1e-9)


@pytest.mark.slow
def test_a_fit_ends_where_a_step_promises_less_than_enough():
    """The promised fall of chi^2 is |r|^2 = 4: enough where 5 is asked for, not where 3 is."""
    for enough, ends in ((5.0, True), (3.0, False)):
        _, _, _, settled = minimum(lambda z: z - 2.0, [0.0], unit=0.1, enough=enough, most=1)
        assert settled is ends


def test_a_step_across_a_bound_is_reflected_and_a_wild_one_ends_inside():
    between = Domain("m", -1.0, 2.0, False, False)
    moved = [float(retract([between], at(1.5), jnp.asarray([step]))[0]) for step in (0.3, 1.0, -3.0, 50.0, -50.0)]
    np.testing.assert_allclose(moved, [1.8, 1.5, -0.5, -1.0, 2.0])


def test_a_multiplicative_step_is_a_factor_and_saturates():
    stiffness = Domain("-", 0.0, np.inf, True, True)
    assert float(retract([stiffness], at(8.0), jnp.asarray([1e-4]))[0]) == pytest.approx(8.0 * np.exp(1e-4), rel=1e-9)
    assert float(retract([stiffness], at(8.0), jnp.asarray([-100.0]))[0]) == pytest.approx(8.0 * np.exp(-REACH))
    # A factor of a tyre is at most 2: a step to 1.4 exp(2) is as far below, and no reflection ends below zero.
    factor = Domain("-", -np.inf, 2.0, True, True)
    for step in (0.1, 0.5, 2.0, 2.5, -2.0, 100.0):
        value = float(retract([factor], at(1.4), jnp.asarray([step]))[0])
        whole = REACH * np.tanh(step / REACH)
        assert value == pytest.approx(np.exp(np.log(2) - abs(np.log(1.4) + whole - np.log(2))))
        assert 0 < value <= 2


def test_a_minimum_beyond_a_bound_ends_on_the_bound():
    """chi^2 = (v + 1)^2 + (2 v + 1)^2 is least at v = -0.6, and on 0 <= v at v = 0."""
    positive = Domain("N", 0.0, np.inf, False, False)

    def value(z):
        return retract([positive], at(1.0), jnp.asarray(z))

    z, r, _, _ = minimum(lambda z: jnp.concatenate([value(z) + 1, 2 * value(z) + 1]), np.zeros(1))
    np.testing.assert_allclose(value(z), [0.0], atol=1e-6)
    np.testing.assert_allclose(r, [1.0, 1.0], atol=1e-5)


def at(*values: float) -> Variables:
    """A point where every parameter is free."""
    names = tuple(f"p{k}" for k in range(len(values)))
    none = jnp.zeros((0, 6))
    return Variables(names, jnp.asarray(values), jnp.eye(len(values)), none, none)
