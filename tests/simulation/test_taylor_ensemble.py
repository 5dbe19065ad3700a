"""Ensembles by Taylor series against scipy's DOP853, and what has no series."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import scipy_runs

from snakejax import (
    TABLE_II,
    Board,
    Force,
    Gait,
    LateralForce,
    Model,
    Pacejka,
    Rayleigh,
    Scalar,
    Sines,
    Tracked,
    param,
    preset,
    simulate_many,
    stacked,
    sweep,
)
from snakejax.core.parameter import own_parameters, with_parameters
from snakejax.dynamics.law import law
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.signals import Logged
from snakejax.effects import LIBRARY, SteeringBacklash
from snakejax.simulation import ensemble as ensembles
from snakejax.simulation.ensemble import ACCURACY, engine_sentence, integrated
from snakejax.simulation.taylor_ensemble import Ensemble, by_taylor_series

pytest.importorskip("heyoka", reason="needs heyoka, of the extra `taylor`")

ROTATE, FORWARD = preset("paper-rotate"), preset("paper-forward")


def reference(model: Model, gait, seconds: float) -> np.ndarray:
    """The pose at the end by scipy's method of order 8."""
    return np.asarray(scipy_runs.integrated(model, gait, [seconds]).pose[-1])


def ensemble_of(models: list[Model], gait, times) -> Ensemble:
    starts = np.zeros((len(models), 3))
    return Ensemble.of(stacked(models), gait, starts, np.asarray(times, float), own_gaits=False, by_value=True)


def board(constraint: str, **effects) -> Model:
    return Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(8.0, 1.4, 4.0, 0.1), constraint, effects)


WITHOUT_SERIES = {
    "quadratic_drag": "`gt` at fast_math.py",
    "steering_lag": "another branch in the course of the run",
    "rotor_lag": "another branch in the course of the run",
    "tyre_relaxation": "`abs` at tyres.py",
}
"""Effects of the library whose rates have a branch on the state, or change in the course of a run."""


OF_EACH_KIND = {
    *WITHOUT_SERIES,
    "ground_slope",
    "rolling_resistance",
    "steering_gain",
    "steering_backlash",
    "grip_gradient",
    "com_offset",
    "tyre_offset",
    "marker_offset",
    "clock_offset",
}
"""Effects without a series, and one of each port."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in OF_EACH_KIND else pytest.param(name, marks=pytest.mark.long) for name in LIBRARY]
)
def test_a_model_with_an_effect_of_the_library_agrees_with_the_reference_or_is_refused(name) -> None:
    kind = LIBRARY[name]
    values = {
        key: np.clip(float(p.value) + kind.secant_step.get(key, 0.05), p.domain.low, p.domain.high)
        for key, p in own_parameters(kind())
    }
    model = board("free", **{name: kind(**values)})
    poses, refusals = by_taylor_series(ensemble_of([model], ROTATE.gait, [3.0]), ACCURACY, 1)
    if name in WITHOUT_SERIES:
        assert WITHOUT_SERIES[name] in refusals[0]
    else:
        assert refusals[0] == ""
        np.testing.assert_allclose(poses[0, -1], reference(model, ROTATE.gait, 3.0), rtol=0, atol=1e-6)


class WarmingGrip(LateralForce):
    """A grip that falls with time and speed: an effect of a user."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        return force * (1 - self.g * jnp.tanh(motion.time / 3) * jnp.exp(-(motion.u**2)))


class DryFriction(Force):
    """A branch on the state: a force against the forward velocity."""

    f: Scalar = param("N", default=0.0)

    def wrench(self, motion):
        return -self.f * jnp.sign(motion.u), jnp.zeros_like(motion.u), jnp.zeros_like(motion.u)


class Wall(Force):
    """A force that does not exist beyond a position."""

    end: Scalar = param("m", default=0.0)

    def wrench(self, motion):
        return 0.1 * jnp.sqrt(self.end - motion.x), jnp.zeros_like(motion.u), jnp.zeros_like(motion.u)


def test_an_effect_of_a_user_has_a_series() -> None:
    models = [board("coupled", warming=WarmingGrip(g)) for g in (0.1, 0.3)]
    poses = simulate_many(stacked(models), ROTATE.gait, [1.5, 3.0], engine="taylor")
    for model, pose in zip(models, poses, strict=True):
        np.testing.assert_allclose(pose[-1], reference(model, ROTATE.gait, 3.0), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "formula",
    [
        "a * abs(time + 1)",
        "-a * abs(time - 9)",
        "a * sign(time - 9) * (2 + time)",
        "a * clip(time, -1, 9)",
        "a * clip(time, -2, -1) * time",
    ],
)
def test_a_branch_on_time_that_stays_the_same_has_a_series(formula) -> None:
    model = board("free", law=law(f"X = {formula}", {"a": "N"}, {"a": 0.1}))
    pose = simulate_many(stacked([model]), ROTATE.gait, [2.0], engine="taylor")[0, -1]
    np.testing.assert_allclose(pose, reference(model, ROTATE.gait, 2.0), rtol=0, atol=1e-6)


KNOTS = np.arange(0.0, 3.0, 0.01)
REFUSED = {
    "logged joints": ("free", Gait(*(Logged.of(KNOTS, np.sin(KNOTS)) for _ in "ab")), {}, "signals.py"),
    "held commands": ("free", Gait(*(Held.of(KNOTS, np.sin(KNOTS)) for _ in "ab")), {}, "sampled_signals.py"),
    "a branch that changes": ("free", ROTATE.gait, {"law": "X = a * abs(time - 1)"}, "`abs` at formula.py"),
    "a linear system": ("printed", ROTATE.gait, {}, "paper_constraints.py"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_series_is_refused_with_the_line(case) -> None:
    constraint, gait, formulas, line = REFUSED[case]
    laws = {name: law(text, {"a": "N"}, {"a": 0.1}) for name, text in formulas.items()}
    poses, refusals = by_taylor_series(ensemble_of([board(constraint, **laws)], gait, [2.0]), ACCURACY, 1)
    assert line in refusals[0] and not np.isfinite(poses).any()


@pytest.mark.slow
def test_a_branch_on_the_state_is_given_to_tsit5_which_says_so() -> None:
    models = [board("free", friction=DryFriction(f)) for f in (0.05, 0.1)]
    ensemble = ensemble_of(models, ROTATE.gait, [1.0])
    poses, refusals = integrated(ensemble, ACCURACY, 1, "fastest")
    assert "`sign` at test_taylor_ensemble.py" in engine_sentence(refusals)
    np.testing.assert_array_equal(poses, integrated(ensemble, ACCURACY, 1, "tsit5").poses)
    with pytest.raises(ValueError, match="2 of 2 members have no Taylor series: its rates have a branch on the state"):
        integrated(ensemble, ACCURACY, 1, "taylor")


def test_a_state_that_is_not_finite_is_refused_and_harms_no_other_member() -> None:
    models = [board("free", wall=Wall(end)) for end in (9.0, 1e-2, 2e-2)]
    poses, refusals = by_taylor_series(ensemble_of(models, FORWARD.gait, [6.0]), ACCURACY, 1)
    reached = np.isfinite(poses).all(axis=(1, 2))
    assert reached.tolist() == [True, False, False]
    assert all((why == "") == end for why, end in zip(refusals, reached, strict=True))
    alone = by_taylor_series(ensemble_of([models[1], models[0]], FORWARD.gait, [6.0]), ACCURACY, 1)
    np.testing.assert_array_equal(poses[0], alone.poses[1])


@pytest.mark.parametrize("creep", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("constraint", ["free", "coupled"])
def test_steps_do_not_leap_over_the_singularities_of_a_small_creep_speed(constraint, creep) -> None:
    model = with_parameters(Model(ROTATE.model.board, ROTATE.model.tyre, constraint), {"board.creep_speed": creep})
    pose = simulate_many(stacked([model]), ROTATE.gait, [2.0], engine="taylor")[0, -1]
    np.testing.assert_allclose(pose, reference(model, ROTATE.gait, 2.0), rtol=0, atol=2e-6)


def test_members_on_both_sides_of_a_branch_on_a_parameter_have_programs_of_their_own() -> None:
    model = board("free", steering_backlash=SteeringBacklash())
    over = {"effects.steering_backlash.b": [0.0, 0.01, 0.05]}
    swept = sweep(model, ROTATE.gait, [2.0], over, engine="taylor")
    assert swept.attrs["engine"] == "Integrated by Taylor series."
    for k, b in enumerate((0.0, 0.01, 0.05)):
        true = reference(with_parameters(model, {"effects.steering_backlash.b": b}), ROTATE.gait, 2.0)
        pose = [float(swept[name].values[k, 0]) for name in ("x", "y", "heading")]
        np.testing.assert_allclose(pose, true, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("kp", "kd"), [(100.0, 10.0), (25.0, 10.0), (20.0, 10.0)], ids=["under", "critical", "over"])
def test_a_controlled_joint_has_a_series_at_any_damping(kp, kd) -> None:
    gait = Gait(*(Tracked(Sines.of([[a, 3.0, 0.2]]), kp=kp, kd=kd) for a in (0.6, 1.2)))
    model = board("free")
    pose = simulate_many(stacked([model]), gait, [2.0], engine="taylor")[0, -1]
    np.testing.assert_allclose(pose, reference(model, gait, 2.0), rtol=0, atol=1e-6)


WITHIN = 1e-6
"""Error [m, rad] to which `benchmarks/throughput.py` holds every method."""
TYRES = {"recordings": Pacejka(8.0, 1.4, 4.0, 0.1), "Table II": ROTATE.model.tyre, "viscous": Rayleigh(10.0)}


@pytest.mark.long
@pytest.mark.parametrize("tyre", TYRES)
@pytest.mark.parametrize("constraint", ["free", "coupled"])
def test_the_error_at_the_default_accuracy_is_that_of_the_benchmark(constraint, tyre) -> None:
    model = Model(ROTATE.model.board, TYRES[tyre], constraint)
    models = [with_parameters(model, {"board.mass": mass}) for mass in (6.0, 7.0, 8.0)]
    poses = simulate_many(stacked(models), ROTATE.gait, [4.0, 8.0], engine="taylor")[:, -1]
    true = np.array([reference(one, ROTATE.gait, 8.0) for one in models])
    np.testing.assert_allclose(poses, true, rtol=0, atol=WITHIN)


def test_without_the_extra_everything_works_as_before(monkeypatch) -> None:
    monkeypatch.setattr(ensembles, "heyoka_version", lambda: None)
    models = [Model(ROTATE.model.board, Rayleigh(k_s), "free") for k_s in (1.0, 10.0, 100.0)]
    ensemble = ensemble_of(models, ROTATE.gait, [4.0])
    poses, refusals = integrated(ensemble, ACCURACY, 1, "fastest")
    np.testing.assert_array_equal(poses, integrated(ensemble, ACCURACY, 1, "tsit5").poses)
    assert engine_sentence(refusals).startswith("Integrated by Tsit5: heyoka is not installed")
    with pytest.raises(ValueError, match="heyoka is not installed"):
        integrated(ensemble, ACCURACY, 1, "taylor")
