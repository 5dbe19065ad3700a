"""Fits of recordings whose parameters are known: honest intervals, the same optimum from anywhere, clear complaints."""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import small

from snakejax._approach import arrived, followed, unsound
from snakejax._board import TABLE_II, Board
from snakejax._case import load_case
from snakejax._errors import FitError, InputError
from snakejax._estimates import estimated
from snakejax._fit import described, fit, fit_study
from snakejax._gait import Gait, Sines, Tracked
from snakejax._model import Model, no_traction
from snakejax._profile import profile
from snakejax._recording import Noise, Run
from snakejax._simulate import Accuracy, simulate
from snakejax._starting import chosen, starting_model
from snakejax._study import Optimum, Study
from snakejax._tyre import Pacejka, Rayleigh
from snakejax._units import with_parameters
from snakejax.effects import LongitudinalSlip

LEVEL = Path(__file__).resolve().parents[1] / "data" / "level-board"
LEVEL_KEY = {"tyre.B": 7.588656, "tyre.C": 1.514612, "tyre.D": 8.543446, "tyre.E": -0.122225}
"""The tyre with which the recordings of `level-board` were made."""

BOARD = Board(**TABLE_II, creep_speed=0.01)
NOISE = Noise(4e-4, 2.5e-3, "given")
TYRE = ["tyre.B", "tyre.C", "tyre.D", "tyre.E"]
TRUTH = {"tyre.B": 6.0, "tyre.C": 1.4, "tyre.D": 2.0, "tyre.E": 0.0}
GAITS = {
    "forward": ([[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "wander": ([[0.5, 2.1, 0.0], [0.3, 3.7, 0.4]], [[1.2, 2.1, 0.2], [0.9, 4.3, 0.0]]),
}
TIMES = np.arange(250) / 50
RUNS = [0, 1]


class Design(NamedTuple):
    """Two runs of 5 s that determine all of B, C, D and E: one compiled study, and a simulator of its poses."""

    study: Study

    def poses(self, **tyre: float) -> np.ndarray:
        """What the runs would be without noise, (2, n, 3), at the truth but for what `tyre` says."""
        values = {**TRUTH, **{f"tyre.{name}": value for name, value in tyre.items()}}
        return np.asarray(_poses(with_parameters(self.study.model, values), self.study.batch.gait))

    def recorded(self, poses: np.ndarray, seed: int) -> Study:
        """The study of `poses` under noise; the starts are guessed from what is seen."""
        noisy = poses + np.random.default_rng(seed).normal(size=poses.shape) * np.asarray(NOISE.channels)
        return self.of(noisy)

    def of(self, poses: np.ndarray) -> Study:
        """The study of recorded `poses`."""
        seen = jnp.asarray(poses), jnp.asarray(np.median(poses[:, :5], axis=1))
        return eqx.tree_at(lambda s: (s.batch.pose, s.batch.start), self.study, seen)


@eqx.filter_jit
def _poses(model, gaits):
    accuracy = Accuracy(rtol=1e-9, atol=1e-10)
    return jax.vmap(lambda gait: simulate(model, gait, jnp.asarray(TIMES), accuracy=accuracy).pose)(gaits)


@pytest.fixture(scope="module")
def design() -> Design:
    """Built once, so that every fit below runs the same compiled program."""
    model = with_parameters(Model(BOARD, Pacejka(1.0, 1.0, 1.0, 0.0), "coupled"), TRUTH)
    runs = [
        Run(name, "train", jnp.asarray(TIMES), jnp.zeros((TIMES.size, 3)), Gait(*(_tracked(terms) for terms in gait)))
        for name, gait in GAITS.items()
    ]
    return Design(Study.of(model, runs, NOISE, [*TYRE, "board.wheelset_inertia"], len(TYRE)))


def _tracked(terms) -> Tracked:
    return Tracked(Sines.of(terms), kp=100.0, kd=10.0)


def perturbed(seed: int) -> dict[str, float]:
    """The truth, each number off by a few percent."""
    factors = np.random.default_rng(seed).normal(1.0, 0.03, len(TYRE))
    return {
        name: value * f + (0.03 if value == 0 else 0.0) for (name, value), f in zip(TRUTH.items(), factors, strict=True)
    }


def deviations(study: Study, optimum: Optimum, truth=TRUTH) -> np.ndarray:
    """How many standard errors each estimate is from the truth."""
    return np.array([(e.value - truth[name]) / (e.sd or np.nan) for name, e in estimated(study, optimum).items()])


# --- Honest intervals ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_intervals_are_honest(design):
    """Of 200 simulated recordings, the 95% intervals hold the truth in 91 to 98%, and the misfit is 1.

    The standard error of a coverage counted over 200 is 1.5%. The 10 unknowns take their share of the residuals.
    """
    poses = design.poses()
    inside, misfits = [], []
    for seed in range(200):
        study = design.recorded(poses, seed)
        optimum = study.fit(perturbed(seed), TYRE, RUNS)
        assert optimum.converged and not optimum.held
        intervals = [e.interval() for e in estimated(study, optimum).values()]
        inside.append([low <= truth <= high for (low, high), truth in zip(intervals, TRUTH.values(), strict=True)])
        misfits.append(optimum.misfit)
    coverage = np.mean(inside, axis=0)
    assert ((coverage >= 0.91) & (coverage <= 0.98)).all(), dict(zip(TYRE, coverage, strict=True))
    samples = 3 * TIMES.size * len(RUNS)
    freedom = samples - 10
    error = np.sqrt(2 * freedom / len(misfits)) / freedom
    assert np.mean(misfits) * samples / freedom == pytest.approx(1.0, abs=3.5 * error)


def test_profile_agrees_with_a_standard_error_where_all_is_determined(design):
    study = design.recorded(design.poses(), 1)
    found = described(study, study.fit(perturbed(1), TYRE, RUNS))
    expected = found.estimates["tyre.D"].interval()
    np.testing.assert_allclose(profile(found, "tyre.D"), expected, atol=0.1 * (expected[1] - expected[0]) / 2)


def test_a_parameter_on_its_bound_is_said_to_be(design):
    """A tyre with C = 2, the end of its domain: noise drives half of the fits against it, and none beyond."""
    truth = {**TRUTH, "tyre.C": 2.0}
    poses, ended = design.poses(C=2.0), []
    for seed in range(6):
        study = design.recorded(poses, seed)
        found = study.fit({**perturbed(seed), "tyre.C": 1.9}, TYRE, RUNS)
        estimates = estimated(study, found)
        C = estimates["tyre.C"]
        ended.append(C.at_bound)
        assert C.value <= 2.0
        if C.at_bound:
            assert C.value == 2.0 and C.sd is None and C.interval() is None and not C.determined
            assert found.loose == ("tyre.B", "tyre.D", "tyre.E") and found.covariance.shape == (3, 3)
            assert any("tyre.C ended on the bound" in said for said in described(study, found).advice)
        else:
            assert abs(C.value - 2.0) < 4 * C.sd
        others = [(estimates[n].value - truth[n]) / estimates[n].sd for n in found.loose if n != "tyre.C"]
        assert np.abs(others).max() < 4
    assert any(ended)


def test_huber_resists_gross_outliers(design):
    """Samples off by 30 standard deviations, one in a hundred: least squares is thrown off, Huber's loss is not."""
    rng = np.random.default_rng(7)
    wrong = rng.random((len(RUNS), TIMES.size, 3)) < 0.01
    clean = design.poses()
    noise = rng.normal(size=clean.shape) + 30.0 * wrong
    study = design.of(clean + noise * np.asarray(NOISE.channels))
    plain = study.fit(perturbed(7), TYRE, RUNS)
    robust = study.fit(perturbed(7), TYRE, RUNS, threshold=1.5)
    assert plain.misfit > 5
    unit = np.sqrt(np.diag(plain.covariance))
    far = {
        kind: np.abs([np.log(o.values[n] / TRUTH[n]) if TRUTH[n] else o.values[n] for n in TYRE]) / unit
        for kind, o in {"plain": plain, "robust": robust}.items()
    }
    assert far["robust"].max() < 4, far
    assert far["plain"].max() > 2 * far["robust"].max(), far


# --- Recordings ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def level():
    """The fit of `level-board`, whole."""
    case = load_case(LEVEL)
    return fit(starting_model(case), case.runs, case.noise)


@pytest.mark.slow
def test_level_board_is_fitted_to_the_noise(level):
    assert level.train_score.misfit <= 1.03
    assert level.heldout_score.misfit <= 1.05
    assert np.abs(deviations(level.study, level.optimum, LEVEL_KEY)).max() < 3
    assert all(estimate.determined for estimate in level.estimates.values())
    assert not level.advice


def random_start(seed: int) -> dict[str, float]:
    """B, C and D within a factor 3 of the tyre of `level-board`, C within its domain; E anywhere within 1 of it."""
    rng = np.random.default_rng(seed)
    factors = 3.0 ** rng.uniform(-1, 1, 3)
    start = {name: LEVEL_KEY[name] * f for name, f in zip(TYRE[:3], factors, strict=True)}
    return {**start, "tyre.C": min(start["tyre.C"], 1.95), "tyre.E": LEVEL_KEY["tyre.E"] + rng.uniform(-1, 1)}


@pytest.mark.slow
def test_random_starts_reach_the_same_optimum(level):
    for seed in range(6):
        found = fit_study(level.study, TYRE, random_start(seed))
        assert found.optimum.misfit == pytest.approx(level.optimum.misfit, abs=1e-4)
        for name, estimate in found.estimates.items():
            assert abs(estimate.value - level.estimates[name].value) < 0.1 * level.estimates[name].sd, (seed, name)


@pytest.mark.slow
def test_a_recording_without_slip_cannot_tell_B_C_and_E_apart(recordings):
    """`board-g` slips so little that the slope of the tyre force at the origin is all there is to see."""
    case = load_case(recordings / "board-g")
    model = starting_model(case).add(longitudinal_slip=LongitudinalSlip())
    found = fit(model, case.runs, case.noise)
    assert found.train_score.misfit <= 1.03 and found.heldout_score.misfit <= 1.1
    for name in ("tyre.B", "tyre.C", "tyre.E"):
        assert not found.estimates[name].determined, name
    slip = found.estimates["effects.longitudinal_slip.k"]
    assert slip.determined and abs(slip.value - 0.6) < 4 * slip.sd
    said = " ".join(found.advice)
    assert "cannot determine B, C" in said and "BCD" in said
    BCD = found.combinations["BCD"]
    assert BCD.determined and abs(BCD.value - 6.717559 * 1.268408 * 8.098706) < 4 * BCD.sd
    assert len(found.combinations) > 1


# --- Names and complaints --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("patterns", "names"),
    [
        (["B"], ["tyre.B"]),
        (["tyre.*"], [*TYRE, "tyre.dSh", "tyre.dSv"]),
        (["C", "tyre.C", "B"], ["tyre.C", "tyre.B"]),
        (["mass"], ["board.mass"]),
        (["effects.*"], ["effects.longitudinal_slip.k"]),
        (["longitudinal_slip.k"], ["effects.longitudinal_slip.k"]),
        (["tyre.[BD]", "k"], ["tyre.B", "tyre.D", "effects.longitudinal_slip.k"]),
    ],
)
def test_names_and_wildcards(patterns, names):
    model = Model(BOARD, Pacejka(1.0, 1.0, 1.0, 0.0)).add(longitudinal_slip=LongitudinalSlip())
    assert chosen(model, patterns) == names


@pytest.mark.parametrize("pattern", ["F", "tyre.b", "effects.*", "board.*_length_m"])
def test_a_name_that_fits_nothing(pattern):
    with pytest.raises(InputError, match="No parameter is called") as raised:
        chosen(Model(BOARD, Rayleigh(1.0)), [pattern])
    assert pattern in str(raised.value)


def test_a_parameter_that_moves_nothing_is_named(design):
    """Under I = m L^2 the wheelsets' own inertia moves nothing; nor does a tyre that has no force to give."""
    study = design.recorded(design.poses(), 0)
    with pytest.raises(FitError, match=r"`board\.wheelset_inertia` moves nothing") as raised:
        fit_study(study, ["tyre.D", "board.wheelset_inertia"])
    assert "\n" not in str(raised.value)
    idle = eqx.tree_at(lambda s: s.model.tyre, study, with_parameters(study.model, {"tyre.D": 0.0}).tyre)
    with pytest.raises(FitError, match=r"`tyre\.B` moves nothing"):
        fit_study(idle, ["tyre.B"])


def test_an_ideal_board_has_no_tyre_to_fit(design):
    ideal = Model(BOARD, no_traction(), "ideal")
    with pytest.raises(FitError, match=r"`tyre\.D` moves nothing"):
        fit(ideal, design.recorded(design.poses(), 0).runs, NOISE, ["D"])


def test_no_train_run(design):
    heldout = [Run(run.name, "heldout", run.times, run.pose, run.gait) for run in design.study.runs]
    with pytest.raises(InputError, match="no train run"):
        fit(design.study.model, heldout, NOISE)


def test_more_free_than_the_study_holds(design):
    with pytest.raises(ValueError, match="At most 4 parameters"):
        design.study.fit(TRUTH, [*TYRE, "board.wheelset_inertia"], RUNS)


def test_derivatives_that_are_not_those_of_the_simulation_are_noticed() -> None:
    """Against the simulation itself: they hold where the fit ended, and not when they are larger."""
    found = small()[2]
    optimum, train = found.optimum, found.study.numbered("train")
    assert unsound(found.study, optimum, train) is None
    J = optimum.linearised.jacobian
    for wrong in (1e12 * J, 1e4 * J, -1e4 * J):
        other = optimum._replace(linearised=optimum.linearised._replace(jacobian=wrong))
        assert unsound(found.study, other, train) == "tyre.D"


def test_a_fit_that_stops_on_its_way_is_followed(design) -> None:
    """A valley that bends: neither three steps nor sixty get through it; followed, the fit ends no higher."""
    study = design.recorded(design.poses(), 0)
    away = study.values() | {"tyre.D": 0.5 * TRUTH["tyre.D"]}
    short, whole = (study.fit(away, TYRE, RUNS, most=most) for most in (3, 60))
    assert not short.converged and short.samples * (short.misfit - whole.misfit) > 10
    found = followed(study, short, RUNS)
    assert found.converged and found.samples * (found.misfit - whole.misfit) < 0.1
    stopped = found._replace(converged=False)
    assert arrived(study, stopped, RUNS) and not arrived(study, short, RUNS)


ROLLING = (
    ([[0.82, 3.304, 0.492], [0.038, 5.616, 5.599]], [[0.858, 3.304, 0.086], [0.132, 2.313, 1.96]]),
    ([[0.84, 1.724, 0.009], [0.081, 2.93, 3.752]], [[1.502, 3.447, 0.135], [0.241, 1.206, 3.78]]),
    ([[0.81, 2.253, 0.303], [0.057, 3.831, 4.938]], [[1.269, 2.253, 0.142], [0.16, 1.577, 1.527]]),
)
"""Gaits whose first seconds say nothing of a tyre that slides late: a fit of whole runs from there ends at E = 1."""


def test_a_fit_that_gets_stuck_is_tried_from_windows() -> None:
    """It ends no worse than one that starts at the truth; by 437 in chi^2 where it is left stuck."""
    truth = {"tyre.B": 10.077, "tyre.C": 1.539, "tyre.D": 2.433, "tyre.E": -0.411}
    model = with_parameters(Model(BOARD, Pacejka(8.0, 1.4, 6.867, 0.0), "free"), truth)
    times, rng = jnp.arange(600) / 100, np.random.default_rng(0)
    gaits = [Gait(*(_tracked(terms) for terms in gait)) for gait in ROLLING]
    poses = [np.asarray(simulate(model, gait, times, accuracy=Accuracy(rtol=1e-9, atol=1e-10)).pose) for gait in gaits]
    noisy = [pose + rng.normal(size=pose.shape) * np.asarray(NOISE.channels) for pose in poses]
    runs = [Run(f"run-{k}", "train", times, jnp.asarray(pose), gaits[k]) for k, pose in enumerate(noisy)]
    found = fit(with_parameters(model, {"tyre.B": 8.0, "tyre.C": 1.4, "tyre.D": 6.867, "tyre.E": 0.0}), runs, NOISE)
    best = found.study.fit(truth, TYRE, [0, 1, 2], found.optimum.start)
    assert found.optimum.converged
    assert found.optimum.samples * (found.optimum.misfit - best.misfit) < 0.1
