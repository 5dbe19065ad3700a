"""Laws beside a random force: how many forms were tried counts, rivals are told, and a word says how sure a law is."""

from collections import OrderedDict
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.proposed_laws import proposal
from scipy import stats

from snakejax.diagnosis.inexact import confidence as sureness
from snakejax.diagnosis.inexact import explaining, laws
from snakejax.diagnosis.inexact.candidate_model import CandidateModel
from snakejax.diagnosis.inexact.fitted_law import FittedLaw, Proposal, _with_wide_priors
from snakejax.diagnosis.inexact.subsets import Subsets, choose
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.dynamics.law import LawParameter
from snakejax.estimation.discrepancy.least_squares import Prior

FORMS = 900


def best_of_forms(seed: int, size: float = 0.0, samples: int = 300) -> Subsets:
    """A linear problem whose only candidate is the best of many columns that were tried; one acts by `size` standard
    errors."""
    rng = np.random.default_rng(seed)
    tried = rng.normal(size=(samples, FORMS))
    y = rng.normal(size=samples) + size / np.sqrt(samples) * tried[:, 0]
    best = np.argmax(np.abs(tried.T @ y) / np.linalg.norm(tried, axis=0))
    columns = np.column_stack([y, tried[:, best]])
    unbounded = np.full(1, np.inf)
    prior, trials = Prior(np.zeros(1), np.full(1, 1e-9)), {"law_1": FORMS}
    gram = columns.T @ columns
    return Subsets(gram, (), OrderedDict(law_1=(0,)), prior, -unbounded, unbounded, trials=trials)


def test_the_best_of_many_forms_is_taken_by_chance_as_often_as_the_level_says() -> None:
    """In 100 problems without a law 0.04 are expected; without counting the forms, that of the least p-value passes."""
    problems = [best_of_forms(k) for k in range(100)]
    level = CRITERIA.significance_level / CRITERIA.nominal_candidates
    assert sum(bool(choose(one, ["law_1"])) for one in problems) <= stats.binom.isf(0.001, 100, level)
    assert sum(bool(choose(one._replace(trials={}), ["law_1"])) for one in problems) > 5
    assert choose(best_of_forms(1, size=9.0), []) == ["law_1"]


ERRORS = np.full(3, 10.0)
"""Mean square errors of whole runs left out without a law."""


def fitted_law(
    one: Proposal, deviance: np.ndarray, mean_square: np.ndarray = ERRORS / 2, effects: tuple[str, ...] = ()
) -> FittedLaw:
    """The law of a proposal, called as its expression."""
    none: Any = None
    name = one.law.expression
    linear: Any = SimpleNamespace(point=SimpleNamespace(effects=(*effects, name)))
    return FittedLaw(name, one, none, none, linear, deviance, np.log(mean_square))


def chooser(
    monkeypatch, proposals: list[Proposal], fitted: Callable[..., Any], exact: tuple[str, ...] = ()
) -> Callable[..., Any]:
    """`choose_law` of so many runs where the segments give `proposals`, and without a law each run has a deviance of
    100; `fitted` stands for the fit of one of them, `exact` names those that leave only noise."""
    monkeypatch.setattr(laws, "fit_law", fitted)
    monkeypatch.setattr(FittedLaw, "exact", property(lambda law: law.name in exact))
    monkeypatch.setattr(laws, "without_idle_terms", lambda *given: given[-1])
    monkeypatch.setattr(laws, "proposals", lambda search, linear: proposals)
    plain = SimpleNamespace(deviance=lambda effects: np.full(3, 100.0), mean_square=lambda effects: ERRORS)
    monkeypatch.setattr(laws, "left_out", lambda search, linear: plain)
    search: Any = SimpleNamespace(progress=lambda event: None, criteria=CRITERIA)
    monkeypatch.setattr(laws, "may_explain", lambda search, linear, proposal: True)
    none: Any = None

    def choose_law(runs: int, effects: tuple[str, ...] = ()) -> Any:
        linear: Any = SimpleNamespace(gram=np.zeros((runs, 1, 1)), point=SimpleNamespace(effects=effects))
        return laws.choose_law(none, none, none, search, linear, ())

    return choose_law


@pytest.mark.parametrize(
    ("after", "subject", "penalised", "kept", "rivals"),
    [
        (50.0, "x", 1017.0, "second", ()),
        (50.0, "x", 1019.0, "first", ()),  # too far behind in the segments
        (90.0, "x", 1008.0, "first", ()),
        (82.0, "y", 1008.0, "first", ("second",)),  # these runs cannot tell x from y
        (150.0, "y", 1008.0, "first", ()),
    ],
)
def test_of_laws_that_do_as_well_the_one_that_predicts_runs_left_out_best_is_kept(
    after, subject, penalised, kept, rivals, monkeypatch
) -> None:
    """The best in the segments has a deviance of 80 a block left out, the second of `after`, against 100 without."""
    deviances = {"first": 80.0, "second": after, "third": None}
    found = [
        proposal("first", "X", ("x",), 1000.0),
        proposal("second", "X", (subject,), penalised),
        proposal("third", "X", ("x",), 1001.0),
    ]

    def fitted(*given: Any) -> FittedLaw | None:
        name = given[-1].law.expression
        deviance = deviances[name]
        if deviance is None:
            return None
        blocks = deviance * np.array([1.0, 1.01, 0.99])
        return fitted_law(given[-1], blocks)

    choose_law = chooser(monkeypatch, found, fitted)
    got = choose_law(3).law
    assert got is not None and got.name == kept
    assert tuple(law.expression for law in got.rivals) == rivals
    assert choose_law(1) == laws.LawChoice()


@pytest.mark.parametrize(
    ("largest", "share", "may"),
    [(0.9, 0.7, False), (0.9, 0.98, True), (0.3, 0.7, False), (0.3, 0.76, True), (0.1, 0.0, True)],
)
def test_a_law_that_leaves_a_force_too_large_for_a_random_one_is_not_fitted(largest, share, may) -> None:
    """It may be at most 5% of the forces that move the board; beside a third of it the law takes away a share."""
    force = np.array([0.01, largest, 0.0]) * 2.0
    point = SimpleNamespace(discrepancy=SimpleNamespace(force=force))
    search: Any = SimpleNamespace(scales=SimpleNamespace(force=np.full(3, 2.0)), criteria=CRITERIA)
    linear: Any = SimpleNamespace(point=point)
    one = proposal("law", "Y", ("r",), 1000.0)
    one = one._replace(law=one.law._replace(share=share))
    assert bool(laws.may_explain(search, linear, one)) is may


@pytest.mark.parametrize(("exact", "kept"), [(True, "first"), (False, "second")])
def test_after_a_law_that_leaves_only_noise_no_other_is_fitted(exact, kept, monkeypatch) -> None:
    found = [proposal("first", "X", ("x",), 1000.0), proposal("second", "X", ("y",), 1001.0)]
    tried = []

    def fitted(*given: Any) -> FittedLaw:
        tried.append(given[-1].law.expression)
        return fitted_law(given[-1], np.full(3, 80.0 if tried[-1] == "first" else 50.0))

    got = chooser(monkeypatch, found, fitted, ("first",) if exact else ())(3).law
    assert got is not None and got.name == kept and got.rivals == ()
    assert tried == (["first"] if exact else ["first", "second"])


@pytest.mark.parametrize(
    ("after", "subject", "kept", "undecided"),
    [
        ([4.0, 4.0, 4.0], "y", True, ()),
        ([2.0, 9.9, 7.0], "y", True, ()),
        ([4.0, 4.0, 21.0], "y", False, ("first", "second")),  # one run would be predicted much worse
        ([4.0, 4.0, 25.0], "x", True, ()),  # one run does not decide
        ([4.0, 4.0, 70.0], "x", False, ()),  # unless it is that much worse
        ([9.0, 9.7, 11.0], "y", False, ("first", "second")),  # hardly any better
        ([9.0, 9.7, 11.0], "x", True, ()),  # no other variable does as well
    ],
)
def test_of_laws_of_other_variables_that_do_as_well_one_is_kept_only_where_it_predicts_whole_runs(
    after, subject, kept, undecided, monkeypatch
) -> None:
    """`after`: the mean square errors of whole runs left out with the first law, 10 each without."""

    def fitted(*given: Any) -> FittedLaw:
        return fitted_law(given[-1], np.full(3, 80.0), np.array(after))

    proposals = [proposal("first", "X", ("x",), 1000.0), proposal("second", "X", (subject,), 1001.0)]
    choice = chooser(monkeypatch, proposals, fitted)(3)
    assert (choice.law is not None) == kept
    assert choice.undecided == undecided


@pytest.mark.parametrize(
    ("deviance", "effects", "kept"),
    [
        (98.0, ("drag",), True),  # beside it
        (98.0, (), False),  # in its place: these runs cannot distinguish the two
        (96.0, (), True),
    ],
)
def test_a_law_takes_the_place_of_a_known_effect_only_where_runs_distinguish_them(
    deviance, effects, kept, monkeypatch
) -> None:
    """Three blocks of 100 without a law; in all of them the law gains as much."""

    def fitted(*given: Any) -> FittedLaw:
        return fitted_law(given[-1], np.full(3, deviance), effects=effects)

    choose_law = chooser(monkeypatch, [proposal("first", "X", ("x",), 1000.0)], fitted)
    assert (choose_law(3, ("drag",)).law is not None) == kept


@pytest.mark.parametrize(
    ("simpler", "whole", "kept"),
    [
        (8.0, [5.0, 5.0, 5.0], "simple"),
        (10.0, [5.0, 5.0, 5.0], "rich"),
        (8.0, [1.0, 5.2, 4.9], "simple"),  # better in one run, no better in the others
        (8.0, [1.0, 2.0, 1.5], "rich"),
    ],
)
def test_of_laws_that_cannot_be_distinguished_the_one_with_fewer_parameters_is_kept(
    simpler, whole, kept, monkeypatch
) -> None:
    """`simpler`: by how much the deviance of the law with fewer parameters is larger; `whole`: the mean square errors
    of whole runs with the other, which the simpler one leaves at 5."""
    one, other = proposal("rich", "X", ("x", "y"), 1000.0), proposal("simple", "X", ("x",), 1001.0)
    parts = tuple(LawParameter(name, "N") for name in "abc")
    rich = one._replace(law=one.law._replace(parameters=parts))
    simple = other._replace(law=other.law._replace(parameters=parts[:1]))

    def fitted(*given: Any) -> FittedLaw:
        name = given[-1].law.expression
        if name == "rich":
            return fitted_law(given[-1], np.full(3, 80.0), np.array(whole))
        return fitted_law(given[-1], np.full(3, 80.0 + simpler / 3))

    choose_law = chooser(monkeypatch, [rich, simple], fitted)
    got = choose_law(3).law
    assert got is not None and got.name == kept


@pytest.mark.parametrize(
    ("kept", "force_after", "expected"),
    [
        ([], [], []),
        (["law_1"], [False], ["law_1"]),  # nothing is left for another law
        (["law_1"], [True], ["law_1"]),  # the force that is left has none
        (["law_1", "law_2"], [True, False], ["law_1", "law_2"]),
        (["law_1", "law_2", "law_3"], [True, True, True], ["law_1", "law_2"]),
    ],
)
def test_another_law_is_looked_for_in_the_random_force_that_the_first_one_leaves(
    kept, force_after, expected, monkeypatch
) -> None:
    """Each search is in the model with the laws before it, and begins where that was fitted."""
    asked: list[Any] = []

    def choose_law(case: Any, noise: Any, candidate_set: Any, search: Any, linear: Any, base: Any) -> laws.LawChoice:
        asked.append((candidate_set, search, linear))
        number = len(asked)
        if number > len(kept):
            return laws.LawChoice(undecided=("X = a * x", "X = a * y"))
        model = (f"candidates {number}", f"search {number}", number - 1)
        return laws.LawChoice(FittedLaw(kept[number - 1], proposal("", "X", ("x",), 0.0), *model, ERRORS, ERRORS))

    monkeypatch.setattr(laws, "choose_law", choose_law)
    monkeypatch.setattr(laws, "model_evidence", lambda search, linear: SimpleNamespace(has_force=force_after[linear]))
    none: Any = None
    choices = laws.choose_laws(none, none, none, none, none, ())
    assert [law.name for law in choices.laws] == expected
    assert asked[1:] == [(f"candidates {k}", f"search {k}", k - 1) for k in range(1, len(asked))]
    assert bool(choices.undecided) == (len(asked) > len(kept))


def test_a_second_law_keeps_the_prior_of_the_first() -> None:
    def model(names: tuple[str, ...], sd: list[float], first: int) -> CandidateModel:
        count = len(names)
        candidates = OrderedDict({f"law_{k + 1}": (first + k,) for k in range(count - first)})
        return CandidateModel(none, names, np.zeros(count), np.array(sd), candidates, {}, (), (), ())

    none: Any = None
    names = ("tyre.D", "effects.law_1.a", "effects.law_2.a")
    known, new = model(names[:2], [1.0, 0.06], 1), model(names, [1.0, 7.0, 7.0], 1)
    law = proposal("second", "X", ("x",), 0.0).law._replace(values={"a": 0.5})
    assert list(_with_wide_priors(new, known, "law_2", law).sd) == [1.0, 0.06, 1.5]


@pytest.mark.parametrize(
    ("predicts", "law", "falls", "instead", "word"),
    [
        (True, False, (50.0, 20.0, 13.0), (), "sure"),
        (True, False, (50.0, 20.0, 11.0), (), "likely"),
        (True, False, (50.0, 7.0, 3.0), (), "likely"),
        (True, False, (50.0, 5.0, 2.0), (), "stand_in"),
        (True, True, (50.0, 5.0, 2.0), (), "likely"),
        (True, True, (50.0, 20.0, 13.0), (), "sure"),
        (True, True, (50.0, 20.0, 13.0), ("Y = a * u",), "ambiguous"),
        (False, True, (50.0, 5.0, 2.0), (), "stand_in"),
        (True, True, (11.0, 5.0, 2.0), (), "stand_in"),
    ],
)
def test_the_word_for_a_law(predicts, law, falls, instead, word) -> None:
    assert sureness._confidence(12.0, predicts, law, falls, instead).word == word


def test_what_is_missing_without_a_law_tells_the_laws_that_do_as_well(monkeypatch) -> None:
    """The law is neutral in the model of which a force is missing; its variable comes first, its rivals last."""
    asked: list[Any] = []

    def random_force(search: Any, point: Any, switched: bool) -> LatentForce:
        asked.append(point)
        return LatentForce((), (), None, None, {}, switched)

    monkeypatch.setattr(explaining, "random_force", random_force)
    first, rival = (proposal(text, "X", (text,), 0.0) for text in ("x", "y"))
    model = SimpleNamespace(candidates={"law_1": [1]}, neutral=np.zeros(2))
    point = SimpleNamespace(_replace=lambda **new: new)
    law: Any = SimpleNamespace(
        name="law_1",
        proposal=first,
        rivals=(rival.law,),
        search=SimpleNamespace(values=lambda linear: np.array([3.0, 4.0]), model=model),
        linear=SimpleNamespace(point=point),
        candidate_set=SimpleNamespace(switched=True),
    )
    without: Any = "the discrepancy without it"
    force = explaining.force_without([law], without)
    assert [one.expression for one in force.laws] == ["x", "y"] and force.is_random
    assert [name for name, _ in force.depends_on] == ["world_position"]
    np.testing.assert_array_equal(asked[0]["values"], [3.0, 0.0])
    assert asked[0]["discrepancy"] == without
