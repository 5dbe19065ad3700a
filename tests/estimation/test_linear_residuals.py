"""The few rows that stand for the residuals of all runs, against all of them."""

import numpy as np

from snakejax.estimation.linear_residuals import LinearResiduals


def drawn(seed=0, runs=3, samples=20, width=2, own=3):
    draw = np.random.default_rng(seed)
    r, J = draw.normal(size=(runs, samples)), draw.normal(size=(runs, samples, width + own))
    return LinearResiduals(r, J, draw.normal(size=width), np.array([0.5, 2.0]))


def whole(residuals):
    """All residuals and their Jacobian by the parameters and the starts of all runs."""
    width = len(residuals.strength)
    runs, samples, columns = residuals.jacobian.shape
    own = columns - width
    J = np.zeros((runs, samples, width + runs * own))
    J[..., :width] = residuals.jacobian[..., :width]
    for k in range(runs):
        J[k, :, width + k * own : width + (k + 1) * own] = residuals.jacobian[k, :, width:]
    below = np.eye(width, J.shape[-1]) * residuals.strength[:, None]
    return np.concatenate([residuals.residual.ravel(), residuals.prior_residual]), np.concatenate(
        [J.reshape(runs * samples, -1), below]
    )


def test_the_rows_have_the_norm_gradient_and_curvature_of_all_residuals():
    residuals = drawn()
    (r, J), (every_r, every_J) = residuals.rows, whole(residuals)
    assert len(r) < len(every_r) / 2
    np.testing.assert_allclose(r @ r, every_r @ every_r)
    np.testing.assert_allclose(J.T @ r, every_J.T @ every_r)
    np.testing.assert_allclose(J.T @ J, every_J.T @ every_J)


def test_a_vector_of_all_residuals_has_the_same_product_with_the_jacobian_in_rows():
    residuals, vector = drawn(), np.random.default_rng(1).normal(size=(3, 20))
    every = np.concatenate([vector.ravel(), np.zeros(2)])
    np.testing.assert_allclose(residuals.rows[1].T @ residuals.in_rows(vector), whole(residuals)[1].T @ every)


def test_what_is_beyond_a_linear_model_is_what_a_step_has_that_is_not_linear():
    here, step = drawn(), np.random.default_rng(2).normal(size=2 + 3 * 3)
    every_r, every_J = whole(here)
    bend = np.random.default_rng(3).normal(size=(3, 20))
    moved = (every_r + every_J @ step)[:-2].reshape(3, 20) + bend / 2
    np.testing.assert_allclose(here.beyond(step, LinearResiduals(moved, here.jacobian, *[np.zeros(2)] * 2)), bend)


def test_a_residual_that_is_not_finite_makes_all_rows_infinite():
    residuals = drawn()
    residuals.residual[1, 4] = np.nan
    r, J = residuals.rows
    assert np.isinf(r[:-2]).all() and not J[:-2].any() and not residuals.is_finite
