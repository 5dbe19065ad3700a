"""A gait tuned over draws from an uncertain fit, against single simulations."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.payload_case import GAINS
from helpers.uncertain_fit import uncertain

from snakejax import Controller, Distance, Gait, Limits, SumsOfSines, posterior_samples, simulate
from snakejax.design import gait_problem as task
from snakejax.design import tune
from snakejax.design.rollouts import RolloutSpec
from snakejax.design.tuning import TERMS, band

LIMITS = Limits.of({"phi": 0.9, "psi": 1.6, "phi_rate": 4.0, "psi_rate": 6.5})


@pytest.mark.long
def test_the_worst_is_the_worst_of_the_draws_simulated_one_by_one(monkeypatch) -> None:
    monkeypatch.setattr(task, "GUESSES", 12)
    found = uncertain(8.0, 0.0)
    models = [found.model, *posterior_samples(found, 3, seed=0)]
    times = jnp.linspace(0.0, 1.0, 101)
    how = dict(driver=Controller(**GAINS), starts=1, most=3)

    def each(gait):
        done = [np.asarray(simulate(model, gait, times).pose) for model in models[1:]]
        return np.array([np.hypot(*(pose[-1, :2] - pose[0, :2])) for pose in done])

    first = tune(models[0], Distance(), LIMITS, 1.0, others=models[1:], **how).after.gait
    worst = tune(models, Distance(), LIMITS, 1.0, over="worst", given=[first], **how)
    there = each(worst.after.gait)
    np.testing.assert_allclose(worst.spread, there, atol=1e-6)
    assert np.ptp(there) > 0.01 * there.min() and there.min() >= each(first).min() - 1e-9

    shape = SumsOfSines((0.9, 1.6), band(LIMITS, 1.0), TERMS)
    spec = RolloutSpec(shape, Controller(**GAINS), jnp.asarray(Distance().times(1.0)), jnp.zeros(3), False)
    whole = task.GaitProblem(models[0], tuple(models[1:]), spec, Distance(), LIMITS, 1.0, "worst")
    z = shape.like(Gait(worst.after.gait.phi.command, worst.after.gait.psi.command))
    assert whole.worst(z) == pytest.approx(-there.min(), abs=1e-6)
    point = whole.worst_point(np.append(z, 0.5))
    np.testing.assert_allclose(point.slack[-len(there) :], 0.5 + there, atol=1e-6)
