"""What recordings ask of the tyre, against tyres that are known."""

import dataclasses
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, Model, Noise, Pacejka, Run, Sines, simulate
from snakejax.core.local_polynomials import even_local_cubics
from snakejax.core.parameter import parameters
from snakejax.diagnosis.residuals.reconstruction import HALF_SPAN, curve, reconstruct_forces, tyre_forces
from snakejax.diagnosis.residuals.replays import replay_fit, replay_runs
from snakejax.estimation import fit
from snakejax.estimation.fitted_model import FittedModel, fitted_model
from snakejax.estimation.problem import Problem

TRUE = Pacejka(B=8.0, C=1.3, D=9.0, E=0.2)
WRONG = Pacejka(B=5.0, C=1.3, D=5.0, E=0.0)
SLIPPERY = Pacejka(B=8.0, C=1.3, D=0.9, E=0.2)
"""It slips past its peak in these runs, so that they determine all four numbers."""
GAITS = (
    Gait(Sines.of([[0.35, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]])),
    Gait(Sines.of([[0.25, 2.1, 0.0]]), Sines.of([[1.5, 4.2, 0.0]])),
)

NOISE = 4e-4


def recorded(constraint: str, noise: float = 1e-7, tyre: Pacejka = TRUE) -> tuple[Run, ...]:
    """Two runs of a board with `tyre`, x, y and heading with errors of standard deviation `noise`."""
    model, times = Model(Board(**TABLE_II), tyre, constraint), jnp.arange(800.0) * 0.01
    errors = noise * np.random.default_rng(0).normal(size=(len(GAITS), 800, 3))
    return tuple(
        Run(f"run{k}", "train", times, simulate(model, gait, times).pose + errors[k], gait)
        for k, gait in enumerate(GAITS)
    )


@cache
def fitted():
    """A fit of the right tyre to recordings as noisy as real ones."""
    noise = Noise(jnp.asarray(NOISE), jnp.asarray(NOISE), source="made")
    free = ["tyre.B", "tyre.C", "tyre.D", "tyre.E"]
    return fit(Model(Board(**TABLE_II), SLIPPERY, "free"), recorded("free", NOISE, SLIPPERY), noise, free)


@cache
def missed(constraint: str) -> FittedModel:
    """A board with the wrong tyre beside recordings almost without noise; nothing but its starts is estimated."""
    noise = Noise(jnp.asarray(NOISE), jnp.asarray(NOISE), source="made")
    problem = Problem.of(Model(Board(**TABLE_II), WRONG, constraint), recorded(constraint), noise, (), 1)
    return fitted_model(problem.model, problem, problem.fit({}, (), range(len(GAITS))), None)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["free", pytest.param("coupled", marks=pytest.mark.long)])
def test_a_recording_asks_for_the_tyre_it_was_made_with_whatever_the_model_says(constraint: str) -> None:
    played = missed(constraint)
    errors, sizes = [], []
    for scene in replay_runs(played):
        told = reconstruct_forces(played, scene)
        assert told is not None
        seen = np.isfinite(told.force)
        assert seen.mean() > 0.5
        true = np.asarray(TRUE.force(told.slip[seen], jnp.zeros(seen.sum())))
        # The wrong model is far from it at the same slip.
        sizes.append(np.asarray(WRONG.force(told.slip[seen], jnp.zeros(seen.sum()))) - true)
        errors.append(told.force[seen] - true)
    error, size = np.concatenate(errors), np.concatenate(sizes)
    # What is left is the smoothing of the residual over 0.4 s.
    assert np.sqrt(np.mean(error**2)) < 0.15 * np.sqrt(np.mean(size**2))


@pytest.mark.slow
def test_the_means_lie_on_the_true_curve_within_their_errors() -> None:
    found = fitted()
    told = tyre_forces(found.fitted, replay_fit(found))
    means = told.demand
    assert means is not None and not told.viscous
    true = np.interp(means.slip, told.curve.slip, SLIPPERY.force(told.curve.slip, jnp.zeros(told.curve.slip.size)))
    slope = np.interp(means.slip, told.curve.slip, np.gradient(told.curve.force, told.curve.slip))
    z = (means.force - true) / np.hypot(means.sd, slope * means.slip_sd)
    assert np.mean(z**2) < 2.5
    assert np.abs(means.force).max() > 10 * np.median(means.sd)


@pytest.mark.slow
def test_the_band_of_the_curve_is_that_of_draws_from_the_fit() -> None:
    found = fitted()
    slip = np.linspace(-0.2, 0.2, 21)
    names = found.fitted.loose
    multiplicative = np.array([parameters(found.model)[name].domain.multiplicative for name in names])
    steps = np.random.default_rng(1).multivariate_normal(np.zeros(len(names)), found.fitted.covariance, 2000)
    at = np.array([found.estimates[name].value for name in names])
    drawn = np.where(multiplicative, at * np.exp(steps), at + steps)
    B, C, D, E = (drawn[:, [names.index(f"tyre.{name}")]] for name in "BCDE")
    forces = D * np.sin(C * np.arctan(B * ((1 - E) * slip + E / B * np.arctan(B * slip))))
    band = curve(found.fitted, slip).sd
    outer = np.abs(slip) > 0.01
    assert np.allclose(forces.std(axis=0)[outer], band[outer], rtol=0.2)


def test_smoothing_is_a_cubic_through_what_is_near() -> None:
    times = np.arange(120) * 0.01
    values = np.stack([np.sin(3 * times), np.cos(2 * times)], axis=1)
    values[30:34] = np.nan
    found, error = even_local_cubics(times, values, np.array([0.1, 0.2]), HALF_SPAN)
    for k in (25, 60):
        near = (np.abs(times - times[k]) <= HALF_SPAN + 1e-9) & np.isfinite(values[:, 0])
        for c in (0, 1):
            fitted_, covariance = np.polyfit(times[near] - times[k], values[near, c], 3, cov="unscaled")
            assert np.allclose(found[k, :, c], fitted_[::-1][:3] * [1, 1, 2], rtol=1e-8)
            assert np.isclose(error[k, c], 2 * np.sqrt(covariance[1, 1]) * (0.1, 0.2)[c])


@pytest.mark.slow
def test_nothing_is_asked_where_wheels_cannot_slip_or_the_report_is_changed() -> None:
    from snakejax.effects import MarkerOffset

    played = missed("free")
    scene = replay_runs(played)[0]
    offset = dataclasses.replace(played, model=played.model.add(offset=MarkerOffset(0.01, 0.0)))
    assert reconstruct_forces(offset, scene) is None
    ideal = dataclasses.replace(played, model=Model(Board(**TABLE_II), TRUE, "ideal"))
    assert reconstruct_forces(ideal, scene) is None
