"""Draws from an uncertain fit against their distribution, and a gait tuned over them against single simulations."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from heavy import BOARD, GAINS, TYRE
from scipy import stats

from snakejax import (
    Distance,
    Driver,
    Force,
    Gait,
    Limits,
    Model,
    Noise,
    Pacejka,
    Run,
    Sines,
    Sums,
    Tracked,
    draws,
    fit,
    param,
    simulate,
    tune,
)
from snakejax import _task as task
from snakejax._draws import LIKELY
from snakejax._least_squares import domains_of
from snakejax._ran import Ask
from snakejax._tune import TERMS, band
from snakejax._units import parameters

SLIDING = 0.8
"""A grip [N] at which the board slides: its B and D are two numbers, not one stiffness."""
LIMITS = Limits.of({"phi": 0.9, "psi": 1.6, "phi_rate": 4.0, "psi_rate": 6.5})


class Drag(Force):
    """Against the motion along the board: never below zero."""

    c: jnp.ndarray = param("N s/m", low=0.0, default=0.0)

    def wrench(self, motion):
        return -self.c * motion.u, jnp.zeros_like(motion.u), jnp.zeros_like(motion.u)


@cache
def uncertain(noisier: float, drag: float):
    """A fit of B and D (their logarithms) and a drag to one run of 2 s of so many times the usual noise."""
    noise = Noise(jnp.asarray(4e-4 * noisier), jnp.asarray(2.5e-3 * noisier), source="test")
    gait = Gait(*(Tracked(Sines.of(rows), **GAINS) for rows in ([[0.7, 4.0, 0.0]], [[1.4, 4.0, 0.3]])))
    times = jnp.arange(101) / 50
    truth = Model(BOARD, Pacejka(**TYRE | {"D": SLIDING}), "free", {"drag": Drag(drag)})
    errors = np.random.default_rng(3).normal(size=(101, 3)) * np.asarray(noise.channels)
    run = Run("one", "train", times, simulate(truth, gait, times).pose + jnp.asarray(errors), gait)
    return fit(truth, [run], noise, ["tyre.B", "tyre.D", "effects.drag.c"])


def steps_of(found, models):
    """How far each draw is from the fit, in what a fit moves: the logarithm of what is multiplicative."""
    names, rows = found.optimum.loose, []
    for model in models:
        pairs = [(float(parameters(model)[n].value), found.optimum.values[n]) for n in names]
        domains = domains_of(found.study.model, names)
        rows.append([np.log(a / b) if d.multiplicative else a - b for (a, b), d in zip(pairs, domains, strict=True)])
    return np.array(rows)


def test_draws_have_the_covariance_of_the_fit() -> None:
    """Whitened by it they are independent standard normal numbers, their squared length chi^2 up to the 99 % region."""
    found = uncertain(0.3, 1.0)
    steps = steps_of(found, draws(found, 200, seed=1))
    assert set(found.optimum.loose) == {"tyre.B", "tyre.D", "effects.drag.c"}
    white = np.linalg.solve(np.linalg.cholesky(found.optimum.covariance), steps.T)
    count = white.shape[1]
    covariance = white @ white.T / count
    assert np.abs(np.diag(covariance) - 1).max() < 4 * np.sqrt(2 / count)
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 4 / np.sqrt(count)
    assert np.abs(white.mean(axis=1)).max() < 4 / np.sqrt(count)
    squared = (white**2).sum(axis=0)
    assert stats.kstest(squared, stats.chi2(3).cdf).pvalue > 1e-3
    assert squared.max() < stats.chi2.ppf(LIKELY, 3) * 1.2


def test_no_draw_leaves_its_domain_or_contradicts_the_recording() -> None:
    """A drag of zero cannot be told from a small one, and B is known to some tenth."""
    found = uncertain(8.0, 0.0)
    models = draws(found, 30, seed=2)
    drags = np.array([float(model.effects["drag"].c) for model in models])
    assert (drags >= 0).all() and (drags > 0).any() and (drags == 0).any()
    assert all(float(model.tyre.B) > 0 and float(model.tyre.D) > 0 for model in models)
    assert np.ptp([np.log(float(model.tyre.B)) for model in models]) > 0.1
    study, best = found.study, found.optimum
    limit = stats.chi2.ppf(LIKELY, len(best.free))
    for model in models[:10]:
        values = {name: float(parameters(model)[name].value) for name in best.free}
        again = study.fit({**best.values, **values}, (), [0], best.start)
        assert (again.misfit - best.misfit) * best.samples < 1.2 * limit


@pytest.mark.long
def test_the_worst_is_the_worst_of_the_draws_simulated_one_by_one(monkeypatch) -> None:
    monkeypatch.setattr(task, "GUESSES", 12)
    found = uncertain(8.0, 0.0)
    models = [found.model, *draws(found, 3, seed=0)]
    times = jnp.linspace(0.0, 1.0, 101)
    how = dict(driver=Driver(**GAINS), starts=1, most=3)

    def each(gait):
        done = [np.asarray(simulate(model, gait, times).pose) for model in models[1:]]
        return np.array([np.hypot(*(pose[-1, :2] - pose[0, :2])) for pose in done])

    first = tune(models[0], Distance(), LIMITS, 1.0, others=models[1:], **how).after.gait
    worst = tune(models, Distance(), LIMITS, 1.0, over="worst", given=[first], **how)
    there = each(worst.after.gait)
    np.testing.assert_allclose(worst.spread, there, atol=1e-6)
    assert np.ptp(there) > 0.01 * there.min() and there.min() >= each(first).min() - 1e-9

    shape = Sums((0.9, 1.6), band(LIMITS, 1.0), TERMS)
    ask = Ask(shape, Driver(**GAINS), jnp.asarray(Distance().times(1.0)), jnp.zeros(3), False)
    whole = task.Task(models[0], tuple(models[1:]), ask, Distance(), LIMITS, 1.0, "worst")
    z = shape.like(Gait(worst.after.gait.phi.command, worst.after.gait.psi.command))
    assert whole.worst(z) == pytest.approx(-there.min(), abs=1e-6)
    point = whole.worst_point(np.append(z, 0.5))
    np.testing.assert_allclose(point.room[-len(there) :], 0.5 + there, atol=1e-6)
