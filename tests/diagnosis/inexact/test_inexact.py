"""The search for effects on Gram matrices, on made-up linear problems with a known answer."""

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from snakejax.core.errors import FitError
from snakejax.core.parameter import Domain
from snakejax.diagnosis.explanation import PoseError, Remainder
from snakejax.diagnosis.inexact import confidence, evidence, explaining
from snakejax.diagnosis.inexact.assessment import Assessment, surest_first
from snakejax.diagnosis.inexact.candidate_model import CandidateModel
from snakejax.diagnosis.inexact.evidence import ModelEvidence
from snakejax.diagnosis.inexact.explaining import shares_of
from snakejax.diagnosis.inexact.left_out import LeftOut
from snakejax.diagnosis.inexact.search import FURTHEST_CONSTANT, FURTHEST_FACTOR, Linear, Search
from snakejax.diagnosis.inexact.subsets import (
    Subsets,
    addition_gains,
    best_subset,
    left_out_deviances,
    left_out_errors,
    prune,
    removal_costs,
    substitutes,
)
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.estimation.discrepancy.kalman import Discrepancy
from snakejax.estimation.discrepancy.least_squares import Optimum, Prior
from snakejax.estimation.discrepancy.strength import Scales

EFFECTS = "abcdefgh"
ALWAYS = 2


def problem(seed: int, sizes: dict[str, float], samples: int = 400, twins: float = 0.0) -> tuple[Subsets, np.ndarray]:
    """Two parameters that are always free and eight effects of one parameter; `sizes` are those that act, in standard
    errors. With `twins`, the column of h is that of a but for so much. Also the Gram matrices of four runs."""
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(samples, ALWAYS + len(EFFECTS)))
    D[:, -1] = (1 - twins) * D[:, -1] + twins * D[:, ALWAYS]
    truth = np.zeros(D.shape[1])
    truth[:ALWAYS] = 1.0
    for name, size in sizes.items():
        truth[ALWAYS + EFFECTS.index(name)] = size / np.sqrt(samples)
    y = D @ truth + rng.normal(size=samples)
    runs = np.array([part.T @ part for part in np.split(np.column_stack([y, D]), 4)])
    width = D.shape[1]
    return Subsets(
        runs.sum(axis=0),
        tuple(range(ALWAYS)),
        OrderedDict((name, (ALWAYS + k,)) for k, name in enumerate(EFFECTS)),
        Prior(np.zeros(width), np.full(width, 1e-6)),
        np.full(width, -np.inf),
        np.full(width, np.inf),
    ), runs


def test_chi2_of_a_set_is_that_of_least_squares() -> None:
    made, _ = problem(0, {"a": 20.0})
    rng = np.random.default_rng(0)
    D = rng.normal(size=(400, ALWAYS + len(EFFECTS)))
    y = D[:, :ALWAYS].sum(axis=1) + 1.0 * D[:, ALWAYS] + rng.normal(size=400)
    kept = D[:, [0, 1, ALWAYS]]
    residual = y - kept @ np.linalg.lstsq(kept, y, rcond=None)[0]
    assert made.with_effects("a").chi2 == pytest.approx(residual @ residual, rel=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_what_acts_is_found_from_any_start(seed: int) -> None:
    made, _ = problem(seed, {"a": 8.0, "c": -9.0, "f": 30.0})
    for last in ("", "bdh", EFFECTS):
        assert set(best_subset(made, last, all_at_once=True)) == {"a", "c", "f"}


@pytest.mark.slow
def test_chance_is_taken_for_an_effect_as_often_as_the_level_says() -> None:
    """Of 8 candidates at the level of 25 in 300 boards without any effect: 0.96 expected, 5 at a level of 0.003."""
    taken = sum(bool(best_subset(problem(1000 + k, {})[0], "", all_at_once=True)) for k in range(300))
    level = CRITERIA.significance_level / CRITERIA.nominal_candidates * len(EFFECTS)
    assert taken <= stats.binom.isf(0.003, 300, level)


def test_costs_of_removal_and_gains_of_addition_are_one_difference_of_chi2() -> None:
    made, _ = problem(3, {"a": 10.0})
    assert removal_costs(made, "ab")["b"] == pytest.approx(addition_gains(made, "a")["b"])
    assert removal_costs(made, "ab")["a"] > made.threshold("a") > removal_costs(made, "ab")["b"]
    assert prune(made, "ab") == ["a"]


def test_a_twin_costs_little_and_another_much() -> None:
    made, _ = problem(4, {"a": 12.0}, twins=0.97)
    costs = substitutes(made, "a", "a")
    assert costs["h"] < CRITERIA.distinct_chi2 < min(cost for name, cost in costs.items() if name != "h")


@pytest.mark.parametrize(("sizes", "twins"), [({"a": 40.0, "b": 15.0}, ("h",)), ({"a": 2.0, "b": 15.0}, ())])
def test_one_parameter_of_an_effect_may_have_a_twin(sizes: dict[str, float], twins: tuple[str, ...]) -> None:
    """The candidate "ab" has the parameters a and b. h does what a does, so that b alone shows that the effect is
    there; where a is not significant, nothing takes its place."""
    made, _ = problem(4, sizes, twins=0.97)
    pair: tuple[int, ...] = (*made.candidates["a"], *made.candidates["b"])
    rest = OrderedDict((name, columns) for name, columns in made.candidates.items() if name not in "ab")
    made = made._replace(candidates=OrderedDict({"ab": pair}) | rest)
    search: Any = SimpleNamespace(criteria=CRITERIA)
    assert confidence.twins(search, made, ["ab"], "ab") == ()
    assert confidence.twins_of_parts(search, made, ["ab"], "ab") == twins
    assert confidence.twins_of_parts(search, made, ["ab", "h"], "h") == ()


def test_a_number_that_is_none_is_no_evidence() -> None:
    made, _ = problem(5, {})
    assert made.p_value("a", float("nan")) == 1.0


def test_a_run_left_out_is_predicted_from_the_others() -> None:
    made, runs = problem(6, {"a": 15.0})
    found = left_out_errors(made, runs, runs, "a")
    for k in range(len(runs)):
        step = made.with_effects("a", runs.sum(axis=0) - runs[k]).step
        weights = np.concatenate([[1.0], -step])
        assert found[k] == pytest.approx(weights @ runs[k] @ weights)
    assert found.sum() < left_out_errors(made, runs, runs, "").sum()


def test_a_run_left_out_has_the_density_of_what_the_others_predict() -> None:
    """Against scipy's normal distribution of the samples of a run, made of its Gram matrix; in two blocks or whole."""
    made, runs = problem(8, {"a": 15.0})
    first = 0.3 * runs
    blocks = np.stack([first, runs - first], axis=1)
    logs = np.random.default_rng(1).normal(size=blocks.shape[:2])
    totals = {}
    for effects in ("", "a", "ab"):
        found = left_out_deviances(made, blocks, logs, effects)
        totals[effects] = found.sum()
        for k, gram in enumerate(runs):
            others = made.with_effects(effects, runs.sum(axis=0) - gram)
            samples = np.linalg.cholesky(gram + 1e-9 * np.eye(len(gram))).T  # columns with this Gram matrix
            residual = samples @ np.concatenate([[1.0], -others.step])
            slopes = samples[:, np.array(others.free) + 1]
            covariance = np.eye(len(samples)) + slopes @ others.covariance @ slopes.T
            log = stats.multivariate_normal(cov=covariance).logpdf(residual)
            expected = -2.0 * log - len(samples) * np.log(2 * np.pi) + logs[k].sum()
            assert found[k].sum() == pytest.approx(expected, rel=1e-6)
    assert totals["a"] < totals[""] - 100


def judged_by(subsets: Subsets, runs: np.ndarray) -> LeftOut:
    """Runs left out, judged by the Gram matrices `runs`."""
    of_blocks = (runs[:, None], np.zeros((len(runs), 1)), np.ones((len(runs), 1), bool))
    linear: Any = SimpleNamespace(subsets=subsets, gram=runs)
    return LeftOut(linear, runs, *of_blocks, 400)


def test_an_effect_predicts_where_it_acts() -> None:
    made, runs = problem(7, {"a": 15.0})

    judged = judged_by(made, runs)
    assert judged.gain("ab", "a").exceeds_standard_error
    explained_share = 1.0 - judged.error("a").sum() / judged.error([]).sum()
    assert 0 < judged.gain("ab", "a").share < explained_share + 0.05
    assert judged.gain("ab", "b").share < 0.02


@pytest.mark.parametrize("effects", ["abcde", "abcdefg"])
def test_contributions_add_up_and_rank_effects_however_they_are_listed(effects: str) -> None:
    """h is nearly a, so that without either the other takes its place: neither is credited with nothing."""
    subsets, runs = problem(4, {"a": 30.0, "b": 20.0, "c": 8.0})
    left = judged_by(subsets, runs)
    shares = left.contributions(tuple(effects))
    again = left.contributions(tuple(reversed(effects)))
    fall = np.log(left.error([]) / left.error(effects)).sum()
    assert sum(shares.values()) == pytest.approx(fall) and sorted(shares, key=lambda e: -shares[e])[:3] == [*"abc"]
    assert shares["a"] == pytest.approx(again["a"], rel=0.05 if len(effects) > 5 else 1e-9)


def test_twins_share_what_both_explain() -> None:
    subsets, runs = problem(5, {"a": 30.0, "b": 20.0}, twins=0.99)
    left = judged_by(subsets, runs)
    shares = left.contributions(("a", "b", "h"))
    either = left.contributions(("a", "b"))["a"]
    assert shares["a"] == pytest.approx(either / 2, rel=0.1) and shares["h"] == pytest.approx(either / 2, rel=0.1)


def test_effects_are_listed_the_surest_first_and_of_equals_that_which_contributes_most() -> None:
    """f and g are sure, and contribute less than 5% of all: what no candidate describes may be as large."""
    words = {"a": "ambiguous", "b": "sure", "c": "likely", "d": "stand_in", "e": "sure", "f": "sure", "g": "sure"}
    contributions = {"a": 90.0, "b": 11.0, "c": 50.0, "d": 30.0, "e": 12.0, "f": 9.0, "g": -2.0}
    assert surest_first(words, contributions) == tuple("ebcadfg")


def test_no_run_alone_decides_what_contributes() -> None:
    """Without a every run is ten times as far off; b alone explains what one run has a thousand times as much of."""
    error = {frozenset("ab"): [1, 1, 1, 1], frozenset("a"): [1, 1, 1, 900], frozenset("b"): [10, 10, 10, 10]}
    error[frozenset()] = [10, 10, 10, 9000]
    left: Any = SimpleNamespace(error=lambda effects: np.array(error[frozenset(effects)], float))
    shares = LeftOut.contributions(left, ("a", "b"))
    assert shares["a"] == pytest.approx(4 * np.log(10)) and shares["b"] == pytest.approx(np.log(900))


@pytest.mark.parametrize("misleads", [False, True])
def test_no_effect_of_a_model_that_misleads_is_sure(misleads: bool) -> None:
    assessment: Any = judged(exact=False, a="sure", b="likely", c="ambiguous")
    words = [explaining._word(assessment, effect, {"a": 0.5}, misleads) for effect in "abc"]
    assert words == (["stand_in", "stand_in", "ambiguous"] if misleads else ["sure", "likely", "ambiguous"])


def judged(exact: bool, **words: str) -> SimpleNamespace:
    sure = {effect: SimpleNamespace(word=word) for effect, word in words.items()}
    return SimpleNamespace(confidence=sure, evidence=SimpleNamespace(exact=exact), law_force=None)


@pytest.mark.parametrize(
    ("exact", "share", "word"),
    [(False, 0.06, "sure"), (False, 0.04, "likely"), (False, -0.1, "likely"), (True, 0.04, "sure")],
)
def test_what_takes_little_away_is_not_sure_where_no_model_is_exact(exact: bool, share: float, word: str) -> None:
    """Something that no candidate describes may be as large."""
    assessment: Any = judged(exact, a="sure")
    assert explaining._word(assessment, "a", {"a": share}, misleads=False) == word


@pytest.mark.parametrize(
    ("share", "rest", "floor", "leaves"),
    [(0.43, 20e-3, 5e-3, True), (0.43, 5e-3, 20e-3, False), (0.9, 20e-3, 5e-3, False), (0.1, 0.0, 5e-3, False)],
)
def test_what_leaves_most_of_the_error_above_the_floor_does_not_explain(share, rest, floor, leaves) -> None:
    """A vehicle that wanders by itself leaves much, and is explained all the same."""
    noise: Any = SimpleNamespace(position=4e-4, heading=2.5e-3)
    remainder, own = Remainder(rest, 0.0, ()), PoseError(floor, 3e-3, "cameras and a random force")
    assert explaining.leaves_most(share, remainder, own, noise) is leaves


def test_shares_of_steps_add_up() -> None:
    from helpers.made_up_explanation import story

    steps = story().steps
    share, whole = shares_of(steps)
    assert sum(share.values()) == pytest.approx(whole)


@pytest.mark.parametrize(
    ("errors", "shares"),
    [
        ((100.0, 5.0, 100.0, 5.0), (0.95, 0.0)),  # the effect does it all
        ((100.0, 5.0, 5.0, 100.0), (0.0, 0.95)),  # the constants do
        ((100.0, 5.0, 5.0, 5.0), (0.475, 0.475)),  # either does
        ((100.0, 5.0, 100.0, 100.0), (0.475, 0.475)),  # only both do
        ((100.0, 5.0, 180.0, 15.0), (0.9, 0.05)),  # constants alone lead astray
    ],
)
def test_the_first_effect_and_the_constants_divide_what_they_explain(errors, shares) -> None:
    assert explaining.divided_share(*errors) == pytest.approx(shares)


def test_an_effect_that_cannot_be_simulated_without_the_constants_takes_nothing_away_alone(monkeypatch) -> None:
    asked: list[tuple[str, ...]] = []

    def alone(assessment: Any, effects: tuple[str, ...]) -> Any:
        asked.append(effects)
        if assessment is None:
            raise FitError("the simulation is not finite")
        return SimpleNamespace(heldout=SimpleNamespace(misfit=30.0))

    monkeypatch.setattr(explaining, "beside_stated_constants", alone)
    steps: Any = [SimpleNamespace(name=n, heldout=SimpleNamespace(misfit=e)) for n, e in (("", 100.0), ("drag", 5.0))]
    of: Any = "an assessment"
    none: Any = None
    assert explaining._error_beside_stated_constants(of, steps) == 30.0 and asked == [("drag",)]
    assert explaining._error_beside_stated_constants(none, steps) == 100.0


def test_the_linear_problem_keeps_constants_and_grip_within_what_it_holds_for() -> None:
    """A vehicle without mass and grip needs no force: a step of -1 of their logarithms would explain all."""
    positive, signed = Domain("kg", 1e-9, np.inf, True, True), Domain("N", -np.inf, np.inf, False, False)
    domains = [positive, positive, signed]
    segments = SimpleNamespace(
        domains=domains,
        multiplicative=np.array([True, True, False]),
        step_between=lambda old, new: np.append(np.log(new[:2] / old[:2]), new[2:] - old[2:]),
    )
    model = CandidateModel(
        None,  # type: ignore[arg-type]
        ("tyre.D", "board.mass", "effects.drag.c"),
        np.array([5.0, 7.0, 0.0]),
        np.array([1.0, 0.03, 1.0]),
        OrderedDict(drag=(2,)),
        {},
        (0, 1),
        (0,),
        (1,),
    )
    # The residual of a drag that acts, where mass, grip and drag are one force: r = y - D d.
    D = np.array([[1.0, 0.0, 100.0], [0.0, 1.0, 100.0], [0.0, 0.0, 100.0]]) * 1e3
    y = D @ np.array([0.0, 0.0, 0.1])
    columns = np.column_stack([y, D])
    search = Search(segments, model, None)  # type: ignore[arg-type]
    found = search.subsets(np.array([5.0, 7.3, 0.0]), columns.T @ columns)
    step = found.with_effects([]).step
    assert abs(step[0]) <= np.log(FURTHEST_FACTOR) + 1e-12
    mass = 7.3 * np.exp(step[1])
    assert abs(np.log(mass / 7.0)) <= FURTHEST_CONSTANT * 0.03 + 1e-12
    assert found.with_effects(["drag"]).step[2] == pytest.approx(0.1, rel=1e-4)
    # Where the values are already further off, they may stay there.
    far = search.subsets(np.array([5.0, 9.0, 0.0]), columns.T @ columns)
    assert far.low[1] < 0.0 <= far.high[1]


@pytest.mark.parametrize(("evidence", "share"), [(8.0, 0.0), (10.0, 0.3)])
def test_a_random_force_that_the_runs_do_not_show_has_no_share(evidence: float, share: float) -> None:
    """Of short runs its estimate is anything."""
    linear = SimpleNamespace(point=SimpleNamespace(discrepancy=SimpleNamespace(force=np.array([0.1, 0.6, 0.0]))))
    parts = dict.fromkeys(Assessment._fields) | {
        "linear": linear,
        "search": SimpleNamespace(scales=SimpleNamespace(force=np.full(3, 2.0))),
        "evidence": ModelEvidence(evidence, 100.0, 0.0, CRITERIA.random_force_chi2),
    }
    assert Assessment(**parts).random_force_share == pytest.approx(share)  # type: ignore[arg-type]


@pytest.mark.parametrize("simulation_is_likelier", [True, False])
def test_a_step_that_leads_astray_is_taken_along_a_simulation_or_damped(
    monkeypatch: pytest.MonkeyPatch, simulation_is_likelier: bool
) -> None:
    """From smoothed states a step goes three times as far as the optimum at 0; from a simulation, which is `along`, it
    leads there. Where the simulation is less likely, as where a random force acts, half of the step comes nearer."""
    dampings: list[float] = []

    class Linearised(SimpleNamespace):
        optimum = property(lambda self: Optimum(0.0, -self.point.values, np.eye(1), (0,)))
        has_converged = Linear.has_converged

        def damped_step(self, damping: float) -> np.ndarray:
            dampings.append(damping)
            return -self.point.values / (1.0 + damping)

        def increased(self, damping: float) -> float:
            return 10.0 * damping or 1.0

        def adapted(self, damping: float, ratio: float) -> float:
            return damping

    def stepped(_: Search, linear: Linearised, step: np.ndarray, effects: tuple[str, ...]) -> SimpleNamespace:
        return at(linear.point.values + (step if linear.point.along else 3.0 * step))

    def at(values: np.ndarray, along: bool = False) -> SimpleNamespace:
        point = SimpleNamespace(values=values, along=along)
        point._replace = lambda **changes: at(changes["values"], point.along)
        return point

    def likelier(_: Search, trial: SimpleNamespace, linear: Linearised) -> tuple[object, float] | None:
        falls = abs(trial.values[0]) < abs(linear.point.values[0])
        return (None, 0.8) if falls or (trial.along and simulation_is_likelier) else None

    monkeypatch.setattr(Search, "linearise", lambda _, point, most=0, data=None: Linearised(point=point))
    monkeypatch.setattr(Search, "stepped", stepped)
    monkeypatch.setattr(Search, "_likelier", likelier)
    monkeypatch.setattr(Search, "along_simulation", lambda _, point: at(point.values, along=True))
    model = SimpleNamespace(candidates={}, probes={})
    search = Search(SimpleNamespace(), model, SimpleNamespace())  # type: ignore[arg-type]
    end: Any = search._refitted(at(np.array([8.0])), ()).point  # type: ignore[arg-type]
    assert abs(end.values[0]) < 0.3
    assert end.along is simulation_is_likelier
    assert dampings == [0.0, 0.0] if simulation_is_likelier else [0.0, *[1.0] * 5]


def test_damping_halves_the_step_of_which_the_recordings_say_least() -> None:
    """The residuals y - D d with two columns that are nearly one: at first the step along their difference is halved,
    that along their sum hardly changes. What a step did decides what comes next."""
    both, apart = np.array([1.0, 1.0, 0.0]) / np.sqrt(2), np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    D = 1e3 * np.column_stack([both + 0.01 * apart, both - 0.01 * apart])
    columns = np.column_stack([D @ np.array([0.4, 0.1]), D])
    prior, wide = Prior(np.zeros(2), np.full(2, 1e-12)), np.full(2, np.inf)
    subsets = Subsets(columns.T @ columns, (0, 1), OrderedDict(), prior, -wide, wide)
    linear = Linear(SimpleNamespace(effects=()), None, None, subsets)  # type: ignore[arg-type]
    assert linear.damped_step(0.0) == pytest.approx([0.4, 0.1])
    least = linear.increased(0.0)
    step = linear.damped_step(least)
    assert step[0] - step[1] == pytest.approx(0.15, rel=1e-3)
    assert step.sum() == pytest.approx(0.5, rel=1e-3)
    assert linear.increased(least) == pytest.approx(10.0 * least)
    ratios = {0.0: 2.0, 0.25: 1.125, 0.5: 1.0, 1.0: 1 / 3}
    assert [linear.adapted(least, ratio) / least for ratio in ratios] == pytest.approx(list(ratios.values()))
    assert linear.adapted(0.0, 0.25) == pytest.approx(1.125 * least)
    assert linear.adapted(0.0, 0.9) == linear.adapted(0.2 * least, 1.0) == 0.0


def test_what_the_fit_has_inside_its_bounds_has_an_error_under_a_larger_force_too() -> None:
    """Two parameters of one column each; the first is positive where noise is all, and would be negative beside a
    force. Its bound is not where the fit is."""
    prior, low, high = Prior(np.zeros(2), np.full(2, 1e-12)), np.array([-1.0, -np.inf]), np.full(2, np.inf)
    gram = np.array([[10.0, -3.0, 1.0], [-3.0, 2.0, 0.5], [1.0, 0.5, 1.0]])
    subsets = Subsets(gram, (0, 1), OrderedDict(), prior, low, high)
    assert subsets.with_effects(()).free == (1,)
    unbounded = subsets.unbounded([0]).with_effects(())
    assert unbounded.free == (0, 1)
    assert unbounded.sd == pytest.approx(np.sqrt(np.diag(np.linalg.inv(gram[1:, 1:]))))
    assert subsets.unbounded([1]).with_effects(()).free == (1,)


@pytest.mark.parametrize("entry", [np.nan, np.inf])
def test_a_fit_that_is_no_longer_finite_says_so(entry: float) -> None:
    """A law may lead there, and is then none; NumPy would report that eigenvalues do not converge."""
    subsets = SimpleNamespace(
        gram=np.eye(3), with_effects=lambda _: SimpleNamespace(free=(0, 1), covariance=np.full((2, 2), entry))
    )
    linear = Linear(SimpleNamespace(effects=()), None, None, subsets)  # type: ignore[arg-type]
    with pytest.raises(FitError, match="left the range of numbers"):
        linear.increased(0.0)


@pytest.mark.parametrize("excluded", [3e-4, 4e-3, 1.0])
def test_the_largest_force_that_recordings_do_not_exclude(monkeypatch: pytest.MonkeyPatch, excluded: float) -> None:
    """Where -2 log likelihood rises by 9 (F / `excluded`)^2, it is `excluded`; never more than the criterion."""
    scales = SimpleNamespace(force=np.array([2.0, 3.0, 0.1]))
    now = Discrepancy(np.ones(3), np.ones(3), 0.2, np.zeros(3), 0.5)
    point = SimpleNamespace(effects=(), values=None, discrepancy=now)

    def likelihood(_: object, of: Discrepancy, *__: object) -> float:
        return CRITERIA.random_force_chi2 * float(of.force[0] / scales.force[0] / excluded) ** 2

    monkeypatch.setattr(evidence, "restricted_likelihood", likelihood)
    model = SimpleNamespace(free=lambda effects: np.array([0]))
    search = SimpleNamespace(criteria=CRITERIA, model=model, scales=scales, prior_at=lambda values: None)
    linear: Any = SimpleNamespace(point=point, data=None)
    share = evidence.largest_force(search, linear, 0.02)  # type: ignore[arg-type]
    most = min(excluded, 0.02)
    assert most / evidence.FORCE_STEP < share <= most


@pytest.mark.parametrize(("exact", "share"), [(True, 3e-3), (False, 0.02)])
def test_only_an_exact_model_bounds_the_unknown_force_by_what_recordings_exclude(
    monkeypatch: pytest.MonkeyPatch, exact: bool, share: float
) -> None:
    """An unknown force that acts like an effect leaves nothing that could exclude it."""
    scales = SimpleNamespace(force=np.array([2.0, 3.0, 0.1]))
    now = Discrepancy(np.ones(3), np.ones(3), 0.2, np.zeros(3), 0.1)
    monkeypatch.setattr(confidence, "largest_force", lambda *_: 3e-3)
    linear = SimpleNamespace(point=SimpleNamespace(discrepancy=now), under=lambda discrepancy: discrepancy)
    search = SimpleNamespace(criteria=CRITERIA, scales=scales)
    wide: Any = confidence.beside_unknown(search, linear, 0.02, exact)  # type: ignore[arg-type]
    np.testing.assert_allclose(wide.force, share * scales.force)
    assert wide.force_time == CRITERIA.shortest_force


@pytest.mark.parametrize(
    ("force", "wandering", "wander_time", "suggests"),
    [
        (0.0, 0.0, 0.2, False),
        (20.0, 0.0, 0.2, True),
        (900.0, 90.0, 0.2, True),
        (90.0, 900.0, 0.2, False),
        (90.0, 900.0, 1.9, True),
        (0.0, 900.0, 1.9, True),
        (0.0, 900.0, 0.2, False),
        (0.0, 0.0, 1.9, False),
    ],
)
def test_noise_that_wanders_as_that_of_cameras_does_makes_no_law_of_a_small_force(
    force: float, wandering: float, wander_time: float, suggests: bool
) -> None:
    scales = Scales(np.ones(3), np.ones(3))
    drifting = scales.drifts(scales.first_guess()._replace(wander_time=wander_time))
    of_model = ModelEvidence(force, wandering, 0.0, CRITERIA.random_force_chi2, drifting)
    assert of_model.suggests_law is suggests


def test_a_stated_time_constant_is_no_drift() -> None:
    scales = Scales(np.ones(3), np.ones(3), wander_time=1.9)
    assert not scales.drifts(scales.first_guess())
