"""Draws from an uncertain fit against their distribution."""

import numpy as np
import pytest
from helpers.uncertain_fit import uncertain
from scipy import stats

from snakejax import (
    posterior_samples,
)
from snakejax.core.parameter import parameters
from snakejax.estimation.fit_workspace import problem_of
from snakejax.estimation.linearisation import domains_of
from snakejax.estimation.posterior import LIKELY


def steps_of(found, models):
    """How far each draw is from the fit, in what a fit moves: the logarithm of what is multiplicative."""
    names, rows = found.fitted.loose, []
    for model in models:
        pairs = [(float(parameters(model)[n].value), found.estimates[n].value) for n in names]
        domains = domains_of(found.model, names)
        rows.append([np.log(a / b) if d.multiplicative else a - b for (a, b), d in zip(pairs, domains, strict=True)])
    return np.array(rows)


@pytest.mark.slow
def test_draws_have_the_covariance_of_the_fit() -> None:
    """Whitened by it they are independent standard normal numbers, their squared length chi^2 up to the 99 % region."""
    found = uncertain(0.3, 1.0)
    steps = steps_of(found, posterior_samples(found, 200, seed=1))
    assert set(found.fitted.loose) == {"tyre.B", "tyre.D", "effects.drag.c"}
    white = np.linalg.solve(np.linalg.cholesky(found.fitted.covariance), steps.T)
    count = white.shape[1]
    covariance = white @ white.T / count
    assert np.abs(np.diag(covariance) - 1).max() < 4 * np.sqrt(2 / count)
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 4 / np.sqrt(count)
    assert np.abs(white.mean(axis=1)).max() < 4 / np.sqrt(count)
    squared = (white**2).sum(axis=0)
    assert stats.kstest(squared, stats.chi2(3).cdf).pvalue > 1e-3
    assert squared.max() < stats.chi2.ppf(LIKELY, 3) * 1.2


@pytest.mark.slow
def test_no_draw_leaves_its_domain_or_contradicts_the_recording() -> None:
    """A drag of zero cannot be told from a small one, and B is known to some tenth."""
    found = uncertain(8.0, 0.0)
    models = posterior_samples(found, 30, seed=2)
    drags = np.array([float(model.effects["drag"].c) for model in models])
    assert (drags >= 0).all() and (drags > 0).any() and (drags == 0).any()
    assert all(float(model.tyre.B) > 0 and float(model.tyre.D) > 0 for model in models)
    assert np.ptp([np.log(float(model.tyre.B)) for model in models]) > 0.1
    problem, best = problem_of(found)
    limit = stats.chi2.ppf(LIKELY, len(best.free))
    for model in models[:10]:
        values = {name: float(parameters(model)[name].value) for name in best.free}
        again = problem.fit({**best.values, **values}, (), [0], best.start)
        assert (again.misfit - best.misfit) * best.samples < 1.2 * limit
