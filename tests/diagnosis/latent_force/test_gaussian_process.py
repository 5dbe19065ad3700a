"""The Gaussian process of the latent force, against dense formulas: kernel, posterior and evidence."""

import numpy as np
import pytest
from scipy import optimize

from snakejax.diagnosis.latent_force import gaussian_process
from snakejax.diagnosis.latent_force.gaussian_process import (
    Normal,
    Prior,
    Window,
    fitted_prior,
    observable_components,
    posterior,
)
from snakejax.diagnosis.latent_force.piecewise_force import SPACING


def matern(count: int, time: float) -> np.ndarray:
    """Matérn's correlation of smoothness 3/2, (1 + a) exp(-a) with a = sqrt(3) |t - t'| / time."""
    t = SPACING * np.arange(count)
    a = np.sqrt(3) * np.abs(t[:, None] - t) / time
    return (1 + a) * np.exp(-a)


def covariance(prior: Prior, count: int, pieces: int = 1) -> np.ndarray:
    """Of X at all knots, then Y, then N; between `pieces` of equal length there is none."""
    dense = np.zeros((3 * count, 3 * count))
    piece = np.arange(count) * pieces // count
    for c, sd in enumerate(prior.sd):
        part = slice(c * count, (c + 1) * count)
        correlation = matern(count, prior.time) + 1e-6 + 1e-8 * np.eye(count)
        dense[part, part] = sd**2 * np.where(piece[:, None] == piece, correlation, 0.0)
    return dense


PRIOR = Prior(np.array([0.8, 0.3, 1.5]), 0.4)


def test_the_kernel_is_that_of_matern():
    L = PRIOR.root(20)
    np.testing.assert_allclose(L @ L.T, matern(20, 0.4), atol=2e-6)
    F = PRIOR.factor(7)
    np.testing.assert_allclose(F @ F.T, covariance(PRIOR, 7), atol=1e-12)
    assert (np.triu(L, 1) == 0).all()


def made(counts: tuple[int, ...] = (6, 9), parameters: int = 2, seed: int = 0):
    """Random linear runs: H (n, 3 K), B (n, P), y (n,) of each; a sample depends on four knots next to each other."""
    draw = np.random.default_rng(seed)
    runs = []
    for K in counts:
        near = np.abs(np.arange(40)[:, None] * K / 40 - np.arange(K)) < 2
        H = draw.normal(size=(40, 3 * K)) * np.tile(near, 3)
        runs.append((H, draw.normal(size=(40, parameters)), draw.normal(size=40) * 3))
    return runs


@pytest.mark.parametrize("pieces", [1, 3])
def test_the_posterior_is_that_of_one_dense_gaussian(pieces: int, monkeypatch):
    """All unknowns side by side, [f_1, f_2, p]: precision = prior precision + sum of H^T H, mean by one solve.

    A long run has several pieces, between which the prior has no correlation and the data have.
    """
    monkeypatch.setattr(gaussian_process, "PIECE", 12 // pieces)
    counts = (12, 12 if pieces == 1 else 4)
    runs, pull, precision = made(counts), np.array([0.5, -1.0]), np.array([2.0, 0.1])
    normal = [Normal(H.T @ H, H.T @ y, H.T @ B, B.T @ B, B.T @ y) for H, B, y in runs]
    found = posterior(normal, PRIOR, (pull, precision), sd=True)

    sizes = [H.shape[1] for H, _, _ in runs]
    edges = np.cumsum([0, *sizes])
    total = edges[-1] + 2
    N, v = np.zeros((total, total)), np.zeros(total)
    N[edges[-1] :, edges[-1] :] = np.diag(precision + 1e-9)
    v[edges[-1] :] = precision * pull
    for k, (H, B, y) in enumerate(runs):
        whole = np.zeros((len(y), total))
        whole[:, edges[k] : edges[k + 1]], whole[:, edges[-1] :] = H, B
        N, v = N + whole.T @ whole, v + whole.T @ y
        N[edges[k] : edges[k + 1], edges[k] : edges[k + 1]] += np.linalg.inv(
            covariance(PRIOR, counts[k], pieces if counts[k] == 12 else 1)
        )
    C = np.linalg.inv(N)
    mean = C @ v
    np.testing.assert_allclose(found.step, mean[edges[-1] :], rtol=1e-6)
    np.testing.assert_allclose(found.covariance, C[edges[-1] :, edges[-1] :], rtol=1e-6)
    for k in range(len(runs)):
        part = slice(edges[k], edges[k + 1])
        np.testing.assert_allclose(found.force[k], mean[part].reshape(3, -1).T, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.variance[k], np.diag(C)[part].reshape(3, -1).T, rtol=1e-6)


def test_a_component_that_moves_nothing_is_not_observable():
    (H, B, y), *_ = made((5,))
    H = H.copy()
    H[:, 5:10] = 0.0
    normal = Normal(H.T @ H, H.T @ y, H.T @ B, B.T @ B, B.T @ y)
    assert observable_components([normal]).tolist() == [True, False, True]


def test_the_distance_of_a_force_is_that_of_its_covariance(monkeypatch):
    force = np.random.default_rng(2).normal(size=(12, 3))
    for pieces in (1, 3):
        monkeypatch.setattr(gaussian_process, "PIECE", 12 // pieces)
        stacked = force.T.reshape(-1)
        expected = stacked @ np.linalg.solve(covariance(PRIOR, 12, pieces), stacked)
        assert PRIOR.distance(force) == pytest.approx(expected, rel=1e-6)


SIDEWAYS = np.array([False, True, False])


def windows(sd: float, time: float, count: int = 15, knots: int = 8) -> list[Window]:
    """Windows with a force across the board alone, drawn from a process of this size and time."""
    draw = np.random.default_rng(1)
    L = np.linalg.cholesky(matern(knots, time) + 1e-9 * np.eye(knots))
    some = []
    for _ in range(count):
        H = np.zeros((20, knots, 3))
        H[:, :, 1] = draw.normal(size=(20, knots))
        # The parameter acts like a force that is constant, so that the two must share what the data say.
        B, force = H[:, :, 1].sum(axis=1, keepdims=True), sd * (L @ draw.normal(size=knots))
        data = H[:, :, 1] @ force + B @ np.array([6.0]) + draw.normal(size=20)
        none = np.zeros((0, 0))
        some.append(Window(data, H.reshape(20, -1), np.zeros((20, 0)), B, (none, none, none)))
    return some


def test_the_fitted_prior_has_the_largest_evidence():
    """-2 log evidence = ln|V| + y^T V^-1 y, V = 1 + H C H^T + B B^T / precision: no better prior is found by search,
    and it is the one that the force was drawn from.
    """
    seen, pull, precision = windows(2.0, 0.4), np.array([0.2]), np.array([0.25])
    found = fitted_prior(seen, SIDEWAYS, Prior(np.array([0.3, 0.3, 0.05]), 0.5), (pull, precision))

    def dense(z: np.ndarray) -> float:
        sd, time = np.exp(z)
        # One parameter for all windows, so their data are one vector.
        rows, knots = len(seen[0].data), seen[0].force.shape[1] // 3
        B = np.concatenate([window.parameters for window in seen])
        y = np.concatenate([window.data for window in seen]) - B @ pull
        V = np.eye(len(y)) + B @ B.T / precision
        C = sd**2 * matern(knots, time)
        for k, window in enumerate(seen):
            H, part = window.force.reshape(rows, knots, 3)[:, :, 1], slice(k * rows, (k + 1) * rows)
            V[part, part] += H @ C @ H.T
        factor = np.linalg.cholesky(V)
        return float(2 * np.log(np.diag(factor)).sum() + (np.linalg.solve(factor, y) ** 2).sum())

    here = np.log([found.sd[1], found.time])
    best = optimize.minimize(dense, np.log([1.0, 0.8]), method="Nelder-Mead", options={"maxfev": 50, "fatol": 0.1})
    assert dense(here) < best.fun + 1.0, "the search ends within half a unit of log evidence"
    assert found.sd[1] == pytest.approx(2.0, rel=0.5)
    assert 0.2 < found.time < 0.8


def test_two_priors_are_near_where_no_part_that_matters_differs_by_a_tenth():
    assert PRIOR.near(Prior(PRIOR.sd * 1.09, PRIOR.time / 1.09))
    assert not PRIOR.near(Prior(PRIOR.sd * 1.12, PRIOR.time))
    assert not PRIOR.near(Prior(PRIOR.sd, PRIOR.time * 1.12))
    small = Prior(np.array([0.8, 1e-5, 1.5]), 0.4)
    assert small.near(Prior(np.array([0.8, 9e-4, 1.5]), 0.4)), "both are negligible across the board"
