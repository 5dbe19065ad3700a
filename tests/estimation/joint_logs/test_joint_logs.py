"""Joint logs on a clock of their own: what the fit says of the clock, and noise in the log."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.logged_case import CLOCKS, LEVEL, TILTED, logged_case

from snakejax import fit_logged, load_case, noise_of, starting_model
from snakejax.core.parameter import with_parameters
from snakejax.diagnosis import explain
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import Logged
from snakejax.effects import LIBRARY
from snakejax.estimation.joint_logs.log_noise import is_noisy, log_noise_root, redrawn_log
from snakejax.estimation.replay import replay
from snakejax.estimation.whitening import coloured, whitened, whitening
from snakejax.recording.quality import smoothed
from snakejax.recording.run import Run


@pytest.mark.long
def test_noise_that_is_drawn_anew_is_as_what_smoothing_leaves():
    """Against the truth, in angle, rate and acceleration: no smaller, and at most a third larger."""
    t = np.arange(0, 12, 0.01)
    true = 0.9 * np.sin(4 * t) + 0.2 * np.cos(7 * t)
    rng = np.random.default_rng(0)
    left, drawn = [], []
    for _ in range(30):
        log = Logged.of(t, *smoothed(t, true + 5e-4 * rng.normal(size=t.size)))
        assert 4e-4 < float(log.noise) < 6e-4
        again = redrawn_log(Gait(log, log), rng).phi
        at = [np.stack(jax.vmap(signal.at)(jnp.asarray(t))) for signal in (log, again, Logged.of(t, true))]
        left.append((at[0] - at[2])[:, 50:-50])
        drawn.append((at[1] - at[0])[:, 50:-50])
    sizes = np.std(np.array(drawn), axis=(0, 2)) / np.std(np.array(left), axis=(0, 2))
    assert (sizes > 0.9).all() and (sizes < 1.33).all()
    clean = Gait(Logged.of(t, true), Logged.of(t, true))
    assert not is_noisy(clean) and redrawn_log(clean, rng).phi is clean.phi


def test_whitened_residuals_are_independent():
    """Of covariance 1 + D D^T they have the covariance 1, and `coloured` goes back."""
    rng = np.random.default_rng(0)
    weight = np.full((2, 40, 3), 50.0)
    wander = rng.normal(size=(40, 3, 5)) * np.array([1.0, 0.3, 0.1, 0.05, 0.02]) / 10
    K = whitening([jnp.asarray(wander), None], weight)
    assert whitening([None, None], weight) is None and not np.asarray(K[1]).any()
    D = 50 * wander.reshape(120, 5)
    W = np.asarray(jax.vmap(lambda r: whitened(r, K[0]))(jnp.eye(120).reshape(120, 40, 3))).reshape(120, 120)
    np.testing.assert_allclose(W @ (np.eye(120) + D @ D.T) @ W.T, np.eye(120), atol=1e-12)
    r = rng.normal(size=(40, 3))
    np.testing.assert_allclose(coloured(np.asarray(whitened(jnp.asarray(r), K[0])), K[0]), r, atol=1e-12)
    assert whitened(r, None) is r and coloured(r, None) is r


@pytest.mark.long
def test_what_a_noisy_log_does_to_a_run_is_taken_from_its_residuals():
    """Runs under logs of 2 mrad: misfits far from 1 as they are, and 1 within 4 sigma, all draws together, whitened."""
    case, rng, noise = load_case(LEVEL), np.random.default_rng(1), 2e-3
    (run,) = [one for one in case.runs if one.name == "train-arc-1"]
    tyre = {"tyre.B": 7.589, "tyre.C": 1.515, "tyre.D": 8.543, "tyre.E": -0.122}
    model = with_parameters(starting_model(case), tyre)
    t, start = np.arange(-1, 13, 0.01), np.zeros((1, 3))
    weight = np.tile(1 / np.asarray(noise_of(case).channels), (run.times.size, 1))

    def logged() -> Run:
        joints = [np.where(t < 0, 0.0, jax.vmap(s.at)(jnp.asarray(t)).angle) for s in (run.gait.phi, run.gait.psi)]
        seen = [joint + noise * rng.normal(size=t.size) for joint in joints]
        return dataclasses.replace(run, gait=Gait(*(Logged.of(t, *smoothed(t, one, starts=True)) for one in seen)))

    (true,) = replay(model, [run], start)
    (mine,) = log_noise_root(model, [logged()], start)
    K = whitening([mine.wander], weight[None])[0]
    left = [(true - replay(model, [logged()], start)[0]) * weight + rng.normal(size=weight.shape) for _ in range(20)]
    white = [np.mean(np.asarray(whitened(jnp.asarray(r), K)) ** 2) for r in left]
    assert np.mean(np.square(left)) > 1.3
    assert abs(np.mean(white) - 1) < 4 * np.sqrt(2 / (len(left) * weight.size))


@pytest.mark.long
def test_the_fit_tells_the_clocks_of_noisy_logs(tmp_path):
    """Offsets, the one drift and the tyre within 3 standard errors, which noise in the logs makes larger.

    Only a run along the axis slides past the peak of the tyre force: without one the tyre is not determined.
    """
    runs = ("train-forward-1", "train-arc-1", "heldout-sweep-1")
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"', runs, noise=5e-4)
    text = (folder / "case.toml").read_text(encoding="utf-8")
    arc = 'file = "train-arc-1-joints.csv", kind = "measured", offset_s = "estimate"'
    (folder / "case.toml").write_text(text.replace(arc, f'{arc}, drift = "estimate"'), encoding="utf-8")
    case = load_case(folder)
    found = fit_logged(starting_model(case), case.runs, case.noise)
    assert found.train_score.misfit < 1.05 and found.heldout_score.misfit < 1.06
    for run in found.fitted.recordings:
        offset, drift = CLOCKS[run.name]
        assert run.log.source == "the fit"
        assert abs(run.log.offset - offset) < 3 * run.log.offset_sd and run.log.offset_sd < 3e-3
        if drift:
            assert abs(run.log.drift - drift) < 3 * run.log.drift_sd and run.log.drift_sd < 3e-4
    # As it was made: see data/README.md.
    for name, true in {"tyre.B": 7.589, "tyre.C": 1.515, "tyre.D": 8.543, "tyre.E": -0.122}.items():
        estimate = found.estimates[name]
        assert abs(estimate.value - true) < 3 * estimate.sd


@pytest.mark.long
def test_what_is_missing_is_found_although_the_clocks_are_not_known(tmp_path):
    """The floor is tilted: under a model without a slope whole runs cannot tell a clock, short windows can."""
    names = ("train-forward-1", "train-rotate-1", "train-wander-1")
    case = load_case(logged_case(tmp_path / "case", 'offset_s = "estimate"', names, data=TILTED))
    few = {name: LIBRARY[name]() for name in ("ground_slope", "yaw_bias", "clock_offset")}
    found = explain(case, noise_of(case), few)
    assert (found.verdict, found.effects) == ("explained", ("ground_slope",))
    assert "joint logs" in found.left_out["clock_offset"]
    for run in found.case.runs:
        assert abs(run.log.offset - CLOCKS[run.name][0]) < 3 * run.log.offset_sd < 3e-3
    for name, value in (("sx", 0.003), ("sy", -0.002)):
        slope = found.final.estimates[f"effects.ground_slope.{name}"]
        assert abs(slope.value - value) < 3 * slope.sd < 1e-5
