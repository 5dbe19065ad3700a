"""Fits of recordings whose parameters are known: honest intervals, the same optimum from anywhere, clear complaints."""

import re
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA
from helpers.small_case import small
from rich.console import Console

from snakejax.core.errors import FitError, InputError
from snakejax.core.parameter import with_parameters
from snakejax.core.progress import Phase
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.dynamics.tyres import Pacejka, Rayleigh
from snakejax.effects import LongitudinalSlip
from snakejax.estimation import fitting, initialisation
from snakejax.estimation.fit_workspace import problem_of
from snakejax.estimation.fitting import fit, fit_problem, fit_result, fitted_workspace
from snakejax.estimation.initial_model import select_parameters, starting_model
from snakejax.estimation.initialisation import (
    continue_over_horizons,
    continue_to_convergence,
    has_converged,
    inconsistent_derivative,
    require_near,
)
from snakejax.estimation.linearisation import project_out_starts
from snakejax.estimation.problem import Problem, Solution, covariance_of
from snakejax.estimation.profile_likelihood import profile
from snakejax.estimation.uncertainty import estimates_of
from snakejax.present.as_text.fit import fit_report
from snakejax.recording.case import load_case
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

LEVEL = DATA / "level-board"
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

    problem: Problem

    def poses(self, **tyre: float) -> np.ndarray:
        """What the runs would be without noise, (2, n, 3), at the truth but for what `tyre` says."""
        values = {**TRUTH, **{f"tyre.{name}": value for name, value in tyre.items()}}
        return np.asarray(_poses(with_parameters(self.problem.model, values), self.problem.batch.gait))

    def recorded(self, poses: np.ndarray, seed: int) -> Problem:
        """The study of `poses` under noise; the starts are guessed from what is seen."""
        noisy = poses + np.random.default_rng(seed).normal(size=poses.shape) * np.asarray(NOISE.channels)
        return self.of(noisy)

    def of(self, poses: np.ndarray) -> Problem:
        """The study of recorded `poses`."""
        seen = jnp.asarray(poses), jnp.asarray(np.median(poses[:, :5], axis=1)), *map(jnp.asarray, poses)
        return eqx.tree_at(lambda s: (s.batch.pose, s.batch.start, *(r.pose for r in s.runs)), self.problem, seen)


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
    return Design(Problem.of(model, runs, NOISE, [*TYRE, "board.wheelset_inertia"], len(TYRE)))


def _tracked(terms) -> Tracked:
    return Tracked(Sines.of(terms), kp=100.0, kd=10.0)


def perturbed(seed: int) -> dict[str, float]:
    """The truth, each number off by a few percent."""
    factors = np.random.default_rng(seed).normal(1.0, 0.03, len(TYRE))
    return {
        name: value * f + (0.03 if value == 0 else 0.0) for (name, value), f in zip(TRUTH.items(), factors, strict=True)
    }


def deviations(problem: Problem, solution: Solution, truth=TRUTH) -> np.ndarray:
    """How many standard errors each estimate is from the truth."""
    return np.array([(e.value - truth[name]) / (e.sd or np.nan) for name, e in estimates_of(problem, solution).items()])


# --- Honest intervals ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_intervals_are_honest(design):
    """Of 200 simulated recordings, the 95% intervals hold the truth in 91 to 98%, and the misfit is 1.

    The standard error of a coverage counted over 200 is 1.5%. The 10 unknowns take their share of the residuals.
    """
    poses = design.poses()
    inside, misfits = [], []
    for seed in range(200):
        problem = design.recorded(poses, seed)
        solution = problem.fit(perturbed(seed), TYRE, RUNS)
        assert solution.converged and not solution.held
        intervals = [e.interval() for e in estimates_of(problem, solution).values()]
        inside.append([low <= truth <= high for (low, high), truth in zip(intervals, TRUTH.values(), strict=True)])
        misfits.append(solution.misfit)
    coverage = np.mean(inside, axis=0)
    assert ((coverage >= 0.91) & (coverage <= 0.98)).all(), dict(zip(TYRE, coverage, strict=True))
    samples = 3 * TIMES.size * len(RUNS)
    freedom = samples - 10
    error = np.sqrt(2 * freedom / len(misfits)) / freedom
    assert np.mean(misfits) * samples / freedom == pytest.approx(1.0, abs=3.5 * error)


@pytest.mark.slow
def test_profile_agrees_with_a_standard_error_where_all_is_determined(design):
    problem = design.recorded(design.poses(), 1)
    found = fit_result(problem, problem.fit(perturbed(1), TYRE, RUNS))
    expected = found.estimates["tyre.D"].interval()
    np.testing.assert_allclose(profile(found, "tyre.D"), expected, atol=0.1 * (expected[1] - expected[0]) / 2)


@pytest.mark.slow
def test_a_parameter_on_its_bound_is_said_to_be(design):
    """A tyre with C = 2, the end of its domain: noise drives half of the fits against it, and none beyond."""
    truth = {**TRUTH, "tyre.C": 2.0}
    poses, ended = design.poses(C=2.0), []
    for seed in range(6):
        problem = design.recorded(poses, seed)
        found = problem.fit({**perturbed(seed), "tyre.C": 1.9}, TYRE, RUNS)
        estimates = estimates_of(problem, found)
        C = estimates["tyre.C"]
        ended.append(C.at_bound)
        assert C.value <= 2.0
        if C.at_bound:
            assert C.value == 2.0 and C.sd is None and C.interval() is None and not C.determined
            assert found.loose == ("tyre.B", "tyre.D", "tyre.E") and found.covariance.shape == (3, 3)
            assert any("tyre.C ended on the bound" in said for said in fit_result(problem, found).advice)
        else:
            assert abs(C.value - 2.0) < 4 * C.sd
        others = [(estimates[n].value - truth[n]) / estimates[n].sd for n in found.loose if n != "tyre.C"]
        assert np.abs(others).max() < 4
    assert any(ended)


@pytest.mark.slow
def test_huber_resists_gross_outliers(design):
    """Samples off by 30 standard deviations, one in a hundred: least squares is thrown off, Huber's loss is not."""
    rng = np.random.default_rng(7)
    wrong = rng.random((len(RUNS), TIMES.size, 3)) < 0.01
    clean = design.poses()
    noise = rng.normal(size=clean.shape) + 30.0 * wrong
    problem = design.of(clean + noise * np.asarray(NOISE.channels))
    plain = problem.fit(perturbed(7), TYRE, RUNS)
    robust = problem.fit(perturbed(7), TYRE, RUNS, threshold=1.5)
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
def level_workspace():
    """The fit of `level-board`, whole, with its problem."""
    case = load_case(LEVEL)
    return fitted_workspace(starting_model(case), case.runs, case.noise)


@pytest.fixture(scope="module")
def level(level_workspace):
    """The fit of `level-board`, whole."""
    return level_workspace.result()


@pytest.mark.slow
def test_level_board_is_fitted_to_the_noise(level, level_workspace):
    assert level.misfit == level.train_score.misfit <= 1.03
    assert level.heldout_score.misfit <= 1.05
    assert np.abs(deviations(level_workspace.problem, level_workspace.solution, LEVEL_KEY)).max() < 3
    assert all(estimate.determined for estimate in level.estimates.values())
    assert not level.advice


def random_start(seed: int) -> dict[str, float]:
    """B, C and D within a factor 3 of the tyre of `level-board`, C within its domain; E anywhere within 1 of it."""
    rng = np.random.default_rng(seed)
    factors = 3.0 ** rng.uniform(-1, 1, 3)
    start = {name: LEVEL_KEY[name] * f for name, f in zip(TYRE[:3], factors, strict=True)}
    return {**start, "tyre.C": min(start["tyre.C"], 1.95), "tyre.E": LEVEL_KEY["tyre.E"] + rng.uniform(-1, 1)}


@pytest.mark.slow
def test_random_starts_reach_the_same_optimum(level, level_workspace):
    for seed in range(6):
        found = fit_problem(level_workspace.problem, TYRE, random_start(seed))
        assert found.solution.misfit == pytest.approx(level_workspace.solution.misfit, abs=1e-4)
        for name, estimate in found.result().estimates.items():
            assert abs(estimate.value - level.estimates[name].value) < 0.1 * level.estimates[name].sd, (seed, name)


@pytest.mark.long
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
    assert select_parameters(model, patterns) == names


@pytest.mark.parametrize("pattern", ["F", "tyre.b", "effects.*", "board.*_length_m"])
def test_a_name_that_fits_nothing(pattern):
    with pytest.raises(InputError, match="No parameter is called") as raised:
        select_parameters(Model(BOARD, Rayleigh(1.0)), [pattern])
    assert pattern in str(raised.value)


def test_a_parameter_that_moves_nothing_is_named(design):
    """Under I = m L^2 the wheelsets' own inertia moves nothing; nor does a tyre that has no force to give."""
    problem = design.recorded(design.poses(), 0)
    with pytest.raises(FitError, match=r"`board\.wheelset_inertia` moves nothing") as raised:
        fit_problem(problem, ["tyre.D", "board.wheelset_inertia"])
    assert "\n" not in str(raised.value)
    idle = eqx.tree_at(lambda s: s.model.tyre, problem, with_parameters(problem.model, {"tyre.D": 0.0}).tyre)
    with pytest.raises(FitError, match=r"`B` moves nothing"):
        fit_problem(idle, ["tyre.B"])
    with pytest.raises(FitError, match=r"None of tyre\.B, tyre\.C moves anything in these runs"):
        fit_problem(idle, ["tyre.B", "tyre.C"])


@pytest.mark.slow
def test_an_ideal_board_has_no_tyre_to_fit(design):
    ideal = Model(BOARD, no_traction(), "ideal")
    with pytest.raises(FitError, match=r"`D` moves nothing"):
        fit(ideal, design.recorded(design.poses(), 0).runs, NOISE, ["D"])


def test_no_train_run(design):
    heldout = [Run(run.name, "heldout", run.times, run.pose, run.gait) for run in design.problem.runs]
    with pytest.raises(InputError, match="no train run"):
        fit(design.problem.model, heldout, NOISE)


def test_more_free_than_the_study_holds(design):
    with pytest.raises(ValueError, match="At most 4 parameters"):
        design.problem.fit(TRUTH, [*TYRE, "board.wheelset_inertia"], RUNS)


def test_derivatives_that_are_not_those_of_the_simulation_are_noticed() -> None:
    """Against the simulation itself: they hold where the fit ended, and not when they are larger."""
    problem, solution = problem_of(small()[2])
    train = problem.run_indices("train")
    assert inconsistent_derivative(problem, solution, train) == []
    J = solution.linearised.jacobian
    for wrong in (1e12 * J, 1e4 * J, -1e4 * J):
        other = solution._replace(linearised=solution.linearised._replace(jacobian=wrong))
        assert inconsistent_derivative(problem, other, train) == ["tyre.D"]


def test_the_derivative_that_is_not_that_of_the_simulation_is_named_among_several(design) -> None:
    """All are checked at once; where they do not agree together, each of them alone."""
    study = design.recorded(design.poses(), 3)
    solution = study.fit(TRUTH, TYRE, RUNS)
    assert inconsistent_derivative(study, solution, RUNS) == []
    for k, name in enumerate(TYRE):
        J = solution.linearised.jacobian.copy()
        J[..., k] *= 3.0
        wrong = solution._replace(linearised=solution.linearised._replace(jacobian=J))
        assert inconsistent_derivative(study, wrong, RUNS) == [name]


def test_a_fit_whose_derivatives_never_hold_has_values_and_no_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """The values are those at which it ended; what keeps them from having errors is said."""
    problem, solution = problem_of(small()[2])
    for module in (fitting, initialisation):
        monkeypatch.setattr(module, "inconsistent_derivative", lambda *_: ["tyre.D"])
    answer = fit_problem(problem, solution.free).result()
    estimate = answer.estimates["tyre.D"]
    assert answer.rough == ("tyre.D",) and estimate.sd is None
    assert estimate.value == pytest.approx(solution.values["tyre.D"], rel=1e-3)
    assert any("Hold one of them, as with --set D=VALUE" in advice for advice in answer.advice)


def with_jacobian(solution: Solution, factor: float) -> Solution:
    """`solution` as one whose derivatives are `factor` times as large, and the errors that follow from them."""
    linearised = solution.linearised._replace(jacobian=factor * solution.linearised.jacobian)
    return solution._replace(linearised=linearised, covariance=solution.covariance / factor**2, rough=None)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("misfit", "factor"), [(1.0, 1e133), (1e6, 1e133), (1e4, 1e3)])
def test_derivatives_that_do_not_hold_give_no_errors(misfit, factor) -> None:
    """However far the model is from the recordings, and with nothing of 130 digits anywhere."""
    case, noise, found = small()
    problem, solution = problem_of(found)
    told = fit_result(problem, with_jacobian(solution, factor)._replace(misfit=misfit))
    estimate = told.estimates["tyre.D"]
    assert estimate.sd is None and estimate.interval() is None and not estimate.determined
    assert told.rough == ("tyre.D",) and np.isnan(told.correlation).all()
    assert all(one.sd is None and not one.determined for one in told.combinations.values())
    (said,) = [said for said in told.advice if "smoothly" in said]
    assert "change smoothly with D where" in said
    assert "cannot determine D one by one" not in " ".join(told.advice)
    console = Console(width=200)
    with console.capture() as shown:
        console.print(fit_report(case, noise, told))
    assert "cannot be determined" in shown.get() and max(map(len, re.findall(r"[0-9.e+-]+", shown.get()))) < 15


@pytest.mark.filterwarnings("error")
def test_derivatives_that_hold_give_errors_far_from_the_recordings_too() -> None:
    problem, solution = problem_of(small()[2])
    told = fit_result(problem, solution._replace(misfit=300.0, rough=None))
    assert told.rough == () and told.estimates["tyre.D"].determined


@pytest.mark.filterwarnings("error")
def test_a_parameter_that_moves_nothing_where_the_fit_ended_has_no_error(design) -> None:
    problem = design.recorded(design.poses(), 0)
    found = problem.fit(TRUTH, TYRE, RUNS)
    jacobian = found.linearised.jacobian.copy()
    jacobian[..., 0] = 0.0
    normal = sum(
        J.T @ J
        for J in (
            project_out_starts(
                found.linearised._replace(jacobian=jacobian), k, 4, np.asarray(problem.batch.free_start)
            )[1]
            for k in RUNS
        )
    )
    told = fit_result(problem, found._replace(covariance=covariance_of(normal), rough=()))
    B, D = told.estimates["tyre.B"], told.estimates["tyre.D"]
    assert B.sd is None and not B.determined and D.determined
    assert np.isnan(told.correlation[0]).all() and np.isfinite(told.correlation[1:, 1:]).all()
    assert told.combinations["BCD"].sd is None and not told.combinations["BCD"].determined
    wide = found.covariance.copy()
    wide[0] = wide[:, 0] = 0.0
    wide[0, 0] = 1e12
    assert estimates_of(problem, found._replace(covariance=wide))["tyre.B"].sd is None


def heavier(problem: Problem, factor: float) -> Problem:
    """`problem` with a board of so many times the mass."""
    return eqx.tree_at(lambda s: s.model.board.mass, problem, factor * problem.model.board.mass)


def test_a_model_that_cannot_move_as_the_board_did_is_refused_at_once(design) -> None:
    """A mass in grams: the rotor hardly turns such a board, whatever its tyres."""
    steps = []
    with pytest.raises(
        FitError, match=r"than a board that stands still: check the mass, .*; `snakejax check`"
    ) as raised:
        fit_problem(heavier(design.recorded(design.poses(), 0), 1e3), TYRE, progress=steps.append)
    assert "\n" not in str(raised.value) and steps
    assert Phase.WHOLE_RUNS not in {event.phase for event in steps}


def test_a_model_that_is_wrong_but_moves_is_not_refused(design) -> None:
    """Nor one that is right, beside samples metres off."""
    wrong = heavier(design.recorded(design.poses(), 0), 2.0)
    require_near(wrong, continue_over_horizons(wrong, wrong.values(), TYRE, RUNS), RUNS)
    poses = design.poses().copy()
    poses[:, ::10, :2] += 7.0
    wild = design.recorded(poses, 0)
    found = wild.fit(TRUTH, TYRE, RUNS, until=4.0, threshold=3.0)
    assert found.misfit > 1e5
    require_near(wild, found, RUNS)


def test_a_fit_that_stops_on_its_way_is_followed(design) -> None:
    """A valley that bends: neither three steps nor sixty get through it; followed, the fit ends no higher."""
    problem = design.recorded(design.poses(), 0)
    away = problem.values() | {"tyre.D": 0.5 * TRUTH["tyre.D"]}
    short, whole = (problem.fit(away, TYRE, RUNS, most=most) for most in (3, 60))
    assert not short.converged and short.samples * (short.misfit - whole.misfit) > 10
    found = continue_to_convergence(problem, short, RUNS)
    assert found.converged and found.samples * (found.misfit - whole.misfit) < 0.1
    # A goal that eight such restarts do not reach ends it after the first of them.
    calls = []
    with pytest.MonkeyPatch.context() as patch:
        fit = problem.fit
        patch.setattr(type(problem), "fit", lambda self, *args, **how: calls.append(args) or fit(*args, most=1, **how))
        continue_to_convergence(problem, short, RUNS, goal=whole.misfit - 100)
    assert len(calls) == 1
    stopped = found._replace(converged=False)
    assert has_converged(problem, stopped, RUNS) and not has_converged(problem, short, RUNS)


ROLLING = (
    ([[0.82, 3.304, 0.492], [0.038, 5.616, 5.599]], [[0.858, 3.304, 0.086], [0.132, 2.313, 1.96]]),
    ([[0.84, 1.724, 0.009], [0.081, 2.93, 3.752]], [[1.502, 3.447, 0.135], [0.241, 1.206, 3.78]]),
    ([[0.81, 2.253, 0.303], [0.057, 3.831, 4.938]], [[1.269, 2.253, 0.142], [0.16, 1.577, 1.527]]),
)
"""Gaits whose first seconds say nothing of a tyre that slides late: a fit of whole runs from there ends at E = 1."""


@pytest.mark.long
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
    problem, solution = problem_of(found)
    best = problem.fit(truth, TYRE, [0, 1, 2], solution.start)
    assert found.converged
    assert solution.samples * (solution.misfit - best.misfit) < 0.1
