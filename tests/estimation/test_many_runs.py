"""Start states eliminated run by run: the same steps as of all variables at once."""

import numpy as np

from snakejax.estimation.many_runs import Ending, eliminated_step, solve_many

R, N, K, S = 5, 12, 2, 3


def test_a_step_is_that_of_all_variables_at_once() -> None:
    rng = np.random.default_rng(2)
    residual, jacobian = rng.normal(size=(R, N)), rng.normal(size=(R, N, K + S))
    free = np.ones((R, S))
    free[1, 2] = 0
    step, moves, promise = eliminated_step((residual, jacobian), K, free, 0.0, (np.zeros(K), np.zeros(K)))
    whole = np.zeros((R * N, K + R * S))
    for k in range(R):
        whole[k * N : (k + 1) * N, :K] = jacobian[k, :, :K]
        whole[k * N : (k + 1) * N, K + k * S : K + (k + 1) * S] = jacobian[k, :, K:] * free[k]
    best = np.linalg.lstsq(whole, -residual.ravel(), rcond=None)[0]
    np.testing.assert_allclose(step, best[:K], atol=1e-10)
    np.testing.assert_allclose(moves.ravel(), best[K:], atol=1e-10)
    fall = (residual**2).sum() - ((residual.ravel() + whole @ best) ** 2).sum()
    assert np.isclose(promise, fall)


def test_a_derivative_that_is_not_finite_moves_nothing_and_promises_nothing() -> None:
    residual, jacobian = np.ones((R, N)), np.ones((R, N, K + S))
    jacobian[2, 3, 0] = np.inf
    with np.errstate(invalid="ignore"):
        step, moves, promise = eliminated_step(
            (residual, jacobian), K, np.ones((R, S)), 1e-3, (np.zeros(K), np.zeros(K))
        )
    assert not step.any() and not moves.any() and np.isnan(promise)


def test_a_decay_is_found_beside_the_starts_of_all_runs() -> None:
    """y = s_k exp(-z t): scipy finds the same by all variables."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(3)
    t = np.linspace(0, 2, N)
    measured = np.array([[2.0 + k] for k in range(R)]) * np.exp(-0.7 * t) + 0.01 * rng.normal(size=(R, N))

    def linearise(z: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay = np.exp(-z[0] * t)
        model = starts * decay
        slopes = np.stack([t * model, -np.broadcast_to(decay, model.shape)], axis=-1)
        return (measured - model)[..., None], slopes[:, :, None, :]

    prior = np.zeros(1), np.zeros(1)
    found = solve_many(linearise, lambda parts: parts, np.ones((R, 1)), prior, Ending(1e-12, 0.0, R * N, 60))
    whole = least_squares(lambda v: (measured - v[1:, None] * np.exp(-v[0] * t)).ravel(), np.zeros(1 + R), xtol=1e-12)
    assert found.settled
    np.testing.assert_allclose(found.z, whole.x[:1], atol=1e-5)
    np.testing.assert_allclose(found.starts[:, 0], whole.x[1:], atol=1e-5)
