"""A candidate beside the base: what to expect of it is its own affair, and its refit ends no worse than the base."""

from functools import cache
from io import StringIO
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from snakejax import TABLE_II, Board, Case, Force, Gait, Model, Noise, Pacejka, Run, Sines, param, simulate
from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.diagnosis.selection.ranking import rank
from snakejax.diagnosis.selection.refit import base_fit, is_worse, no_worse, refit
from snakejax.diagnosis.selection.score_test import ProjectedResiduals, score
from snakejax.diagnosis.selection.screening import ScreenedCandidate, screen_candidates
from snakejax.diagnosis.selection.working_step import candidate_score, selection_step
from snakejax.dynamics.law import LawParameter, law_class
from snakejax.effects import LIBRARY, ComOffset, GroundSlope, QuadraticDrag, TyreRelaxation, YawBias
from snakejax.estimation.goodness_of_fit import consistent_with_noise
from snakejax.estimation.initial_model import starting_model
from snakejax.estimation.uncertainty import contradicted, estimates_of, spread
from snakejax.present.as_json.explanation import ranked_json
from snakejax.present.as_text.explanation import candidate_table

GAITS = (([[0.5, 3.0, 0.0]], [[1.2, 3.0, 0.4]]), ([[0.4, 4.0, 0.3]], [[1.0, 4.0, 0.0]]))
SPRINGS = ("spring", "cable", "tether", "leash")


class Spring(Force):
    """A cable that pulls at the board along x, towards x = 0."""

    k: jnp.ndarray = param("N/m", low=0.0, default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(-self.k * motion.x, jnp.zeros_like(motion.x))
        return X, Y, jnp.zeros_like(X)


FEW = {"com_offset": ComOffset(), "quadratic_drag": QuadraticDrag(), "yaw_bias": YawBias()}
# The springs promise most, and so many that they would take every place among the best; a relaxation has a state.
MORE = {**{name: Spring() for name in SPRINGS}, **FEW, "tyre_relaxation": TyreRelaxation()}


@cache
def case() -> Case:
    """Two runs of a board that a spring pulls at."""
    noise = Noise(jnp.asarray(4e-4), jnp.asarray(2.5e-3), "given")
    board, times, draw = Board(**TABLE_II, creep_speed=0.01), jnp.arange(225) / 50, np.random.default_rng(0)
    truth = Model(board, Pacejka(B=8.0, C=1.4, D=3.0, E=0.0), "free").add(spring=Spring(k=1.0))
    runs = []
    for name, gait in zip("ab", GAITS, strict=True):
        moves = Gait(*(Sines.of(rows) for rows in gait))
        pose = np.asarray(simulate(truth, moves, times).pose)
        seen = pose + draw.normal(size=pose.shape) * np.asarray(noise.channels)
        runs.append(Run(name, "train", times, jnp.asarray(seen), moves))
    return Case("made", "a board on a spring", "free", board, tuple(runs), noise)


@cache
def bench(few: bool) -> CandidateSet:
    noise = case().noise
    assert noise is not None
    return CandidateSet.of(starting_model(case()), case(), noise, FEW if few else MORE)


@cache
def base(few: bool) -> CandidateFit:
    return base_fit(bench(few))


@cache
def promised(few: bool) -> dict[str, ScreenedCandidate]:
    return {one.score.effect: one for one in screen_candidates(bench(few), base(few))}


@pytest.mark.parametrize(("finite", "ends"), [({0.0, 2.0, 8.0}, 8.0), ({0.0, 2.0}, 2.0), ({0.0}, 0.0), (set(), 8.0)])
def test_where_the_first_seconds_lead_astray_a_fit_to_whole_runs_begins_elsewhere(finite: set, ends: float):
    """Windows end at 2, the first seconds at 8, the neutral value is 0. From some of them whole runs are finite."""
    begun: list[float] = []

    def fit(values, free, train, start=None, until=None, **_: object):
        begun.append(values["tyre.B"])
        if until is not None:
            return SimpleNamespace(values={"tyre.B": 8.0}, start=None, misfit=1e3)
        return SimpleNamespace(values=values, misfit=1e4 if values["tyre.B"] in finite else np.inf)

    problem = SimpleNamespace(fit=fit, values=lambda: {"tyre.B": 0.0}, names=("tyre.B",))
    known = SimpleNamespace(
        free=lambda _: ["tyre.B"], train=(0,), problem=problem, criteria=CRITERIA, off_zero=lambda _, value: value
    )
    end = refit(known, (), {"tyre.B": 2.0}, near=False)  # type: ignore[arg-type]
    assert np.isfinite(end.misfit) == bool(finite) and begun[0] == 2.0
    assert not finite or end.values["tyre.B"] == ends


@pytest.mark.slow
def test_the_base_does_not_know_the_candidates():
    """It is far off, so that windows are scored; a state that an effect adds changes nothing of it."""
    few, more = base(True).solution, base(False).solution
    assert few.misfit > 5 * CRITERIA.linear_misfit
    assert few.misfit == pytest.approx(more.misfit, rel=1e-6)
    for name in few.free:
        assert few.values[name] == pytest.approx(more.values[name], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("effect", FEW)
def test_what_to_expect_of_a_candidate_does_not_depend_on_the_others(effect):
    few, more = promised(True)[effect], promised(False)[effect]
    assert few.misfit == pytest.approx(more.misfit, rel=1e-6)
    for name, value in few.score.values.items():
        sd = few.score.sd[name]
        assert more.score.values[name] == pytest.approx(value, abs=1e-5 * sd)
        assert more.score.sd[name] == pytest.approx(sd, rel=1e-5)
        assert more.values[name] == pytest.approx(few.values[name], abs=1e-5 * sd), "where its refit starts"


@pytest.mark.slow
def test_a_refit_does_not_change_what_was_expected():
    """The quadratic drag is refitted where it stands beside few, and has no place among the best beside the springs."""
    few, more = (rank(bench(some), base(some), refitted=1) for some in (True, False))
    shown = [{one.effect: one for one in ranking}["quadratic_drag"] for ranking in (few, more)]
    assert shown[0].refit is not None and shown[1].refit is None
    told = [candidate_score(bench(True), one).estimate["c"].value for one in shown]
    assert told[0] == pytest.approx(told[1], rel=1e-5)
    refitted = ranked_json(candidate_score(bench(True), shown[0]))["refit_estimate"]["c"]
    assert refitted["value"] == shown[0].refit.values["effects.quadratic_drag.c"]


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["quadratic_drag", "tyre_relaxation"])
def test_a_refit_that_goes_astray_is_taken_up_from_the_base(effect):
    """Stopped at once, from an absurd value, it ends far above the base that its model contains."""
    (name,) = bench(False).candidates[effect]
    before = base(False)
    absurd = {**before.solution.values, name: 1e3}
    astray = bench(False).problem.fit(absurd, bench(False).free([effect]), bench(False).train, most=1)
    assert is_worse(astray, before.solution)
    assert not is_worse(no_worse(bench(False), before, [effect], astray), before.solution)


@pytest.mark.slow
def test_a_refit_that_stays_worse_than_the_base_is_no_number():
    solution = base(True).solution
    tolerable = 0.04 / solution.samples
    assert not is_worse(solution._replace(misfit=solution.misfit + tolerable), solution)
    assert is_worse(solution._replace(misfit=solution.misfit * 1.001), solution)
    assert is_worse(solution._replace(misfit=np.nan), solution)


@pytest.mark.slow
def test_a_failed_refit_is_said_in_words(monkeypatch):
    worse = base(True).solution._replace(misfit=1e9)
    monkeypatch.setattr("snakejax.diagnosis.selection.ranking.no_worse", lambda *_: worse)
    ranking = {one.effect: one for one in rank(bench(True), base(True))}
    drag = ranking["quadratic_drag"]
    assert drag.failed and drag.refit is None
    at = selection_step(bench(True), "base", "", base(True), tuple(ranking.values())).record
    told = ranked_json(candidate_score(bench(True), drag))
    assert told["refit_misfit"] is None and told["refit_estimate"] is None and told["refit_failed"]
    seen = StringIO()
    Console(width=100, file=seen).print(candidate_table(at))
    row = next(line for line in seen.getvalue().splitlines() if "quadratic_drag" in line)
    assert "failed" in row


@pytest.mark.slow
def test_an_effect_that_stands_in_for_another_is_as_unsure_as_the_runs_disagree():
    """A spring explains all, and its error is that of noise; a drag in its place has another value in each run.

    The tyre is not free beside the drag: both would become absurd together, with derivatives of 1e21.
    """
    found = bench(False)
    for effect, wider in (("spring", False), ("quadratic_drag", True)):
        (name,) = found.candidates[effect]
        values = {**base(False).solution.values, name: 0.5}
        free = [name] if wider else found.free([effect])
        solution = found.problem.fit(values, free, found.train)
        assert consistent_with_noise(solution) is not wider
        row = solution.loose.index(name)
        noise = spread(solution) * np.sqrt(solution.covariance[row, row])
        sd = estimates_of(found.problem, solution)[name].sd
        assert sd is not None and (sd > noise if wider else sd == pytest.approx(noise))
    alone = found.problem.fit(values, free, found.train[:1])
    assert contradicted(found.problem, alone)[name] > 0, "stretches of the one run"


def test_a_standard_error_knows_that_runs_contradict_each_other(model_of_a_slope):
    """A candidate that pushes one run up and the other down by much has a value of which nothing is sure."""
    run, block = np.repeat([0, 1], 600), np.arange(1200) // 100
    draw = np.random.default_rng(0)
    columns = np.stack([np.ones(1200), np.sin(np.arange(1200) / 10), np.cos(np.arange(1200) / 7)], axis=1)
    sign = np.where(run == 0, 3.0, -2.0)
    model, names = model_of_a_slope
    values = dict.fromkeys(names, 0.0)
    for noise_only in (False, True):
        residual = draw.normal(size=1200) - (0.0 if noise_only else sign) * columns[:, 1]
        wide, narrow = (
            score(
                model,
                names,
                ProjectedResiduals(residual, columns, block, 0, told),
                names[:1],
                {"slope": names[1:]},
                values,
            )[0].sd
            for told in (run, None)
        )
        if noise_only:
            assert wide == narrow
        else:
            assert 1.5 < wide[names[1]] < 4, "half the difference of the two runs"
            assert wide[names[1]] > 2 * narrow[names[1]]


@pytest.fixture
def model_of_a_slope():
    model = Model(Board(**TABLE_II), Pacejka(B=8.0, C=1.4, D=7.0, E=0.0), "free").add(slope=GroundSlope())
    return model, ["tyre.D", "effects.slope.sx", "effects.slope.sy"]


def test_a_selection_beside_a_large_law_has_room_for_all_effects_that_it_may_add() -> None:
    """Where it has not, the fit of the last one that is tried ends the explanation."""
    names = [f"c{k}" for k in range(14)]
    smooth = law_class(f"X = spline(u, 0, 1, {', '.join(names)})", tuple(LawParameter(name, "N") for name in names))
    library = {name: kind() for name, kind in LIBRARY.items()} | {"law_1": smooth()}
    noise = case().noise
    assert noise is not None
    candidate_set = CandidateSet.of(starting_model(case()), case(), noise, library)
    largest = sorted(candidate_set.candidates, key=lambda name: -len(candidate_set.candidates[name]))
    assert largest[0] == "law_1"
    chosen = largest[: candidate_set.criteria.most_effects + 1]
    assert len(candidate_set.free(chosen)) <= candidate_set.problem.width
