"""The laws that segments propose are compared fairly: each beside the known effects and the force that it needs."""

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.proposed_laws import proposal
from scipy import stats

from snakejax.diagnosis.inexact import law_proposals
from snakejax.diagnosis.inexact.law_proposals import LAW, Beside
from snakejax.diagnosis.inexact.subsets import Subsets
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.diagnosis.law.terms import Family, ShapeParameter, Term
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.dynamics.law import LawParameter
from snakejax.estimation.discrepancy.kalman import Discrepancy
from snakejax.estimation.discrepancy.least_squares import Prior

SAMPLES = 400


def test_each_form_is_proposed_once(monkeypatch) -> None:
    found = [
        proposal("worse", "N", ("time",), 1009.1),
        proposal("other variable", "world", ("y",), 1008.9),
        proposal("best", "world", ("x",), 1000.0),
        proposal("the same in another form", "world", ("x",), 1001.0),
        proposal("best", "world", ("x",), 1002.0),  # beside other effects
        proposal("other action", "X", ("x",), 1008.0),
    ]
    none: Any = None
    monkeypatch.setattr(law_proposals, "bases", lambda search, linear: [0, 3])
    monkeypatch.setattr(law_proposals, "proposed", lambda search, beside: found[beside : beside + 3])
    ordered = law_proposals.proposals(none, none)
    assert [(one.law.expression, one.penalised) for one in ordered] == [
        ("best", 1000.0),
        ("the same in another form", 1001.0),
        ("other action", 1008.0),
        ("other variable", 1008.9),
        ("worse", 1009.1),
    ]
    monkeypatch.setattr(law_proposals, "bases", lambda search, linear: [])
    assert law_proposals.proposals(none, none) == []


class Made(SimpleNamespace):
    """A record of which parts can be replaced."""

    def _replace(self, **new: Any) -> "Made":
        return Made(**(vars(self) | new))


def test_a_law_is_looked_for_beside_a_weaker_force(monkeypatch) -> None:
    """Two columns: the candidate shows only where the force no longer explains it. Of the effects that were found one
    is not needed whatever else acts; each set is tried once."""
    of = Discrepancy(np.ones(3), np.ones(3), 0.2, np.array([0.3, 3e-4, 0.0]), 1.0)
    asked: list[Any] = []

    def under(discrepancy: Discrepancy) -> Subsets:
        asked.append(discrepancy)
        columns = np.array([[5.0, 0.0], [0.0, 0.01]]) if discrepancy.force[0] > 0.2 else np.diag([8.0, 8.0])
        columns[0, 1] = columns[1, 1]
        unbounded = np.full(1, np.inf)
        prior = Prior(np.zeros(1), np.full(1, 1e-9))
        return Subsets(columns.T @ columns, (), OrderedDict(drag=(0,)), prior, -unbounded, unbounded)

    search: Any = SimpleNamespace(scales=SimpleNamespace(least_force=np.full(3, 2e-4)))
    whole: Any = Made(point=Made(discrepancy=of, effects=("drag",)), under=under)
    needed = whole._replace(point=whole.point._replace(effects=()))
    weaker = law_proposals.beside_weaker_force(search, whole, 1 / 3)
    np.testing.assert_allclose(asked[0].force, [0.1, 2e-4, 2e-4])
    assert weaker.point.discrepancy is asked[0]
    np.testing.assert_array_equal(weaker.subsets.gram, under(asked[0]).gram)
    monkeypatch.setattr(law_proposals, "with_needed_effects", lambda search, linear: needed)
    found = law_proposals.bases(search, whole)
    assert [one.point.effects for one in found] == [("drag",), ()]
    assert all(one.point.discrepancy is of for one in found)


@pytest.mark.parametrize(("size", "needed"), [(2.0, ("drag",)), (20.0, ("drag", "slope"))])
def test_a_law_is_looked_for_beside_the_effects_that_are_needed_whatever_else_acts(size, needed) -> None:
    """Under the estimated force both effects are significant; where more is unknown, a slope of 2 is not."""
    of = Discrepancy(np.ones(3), np.ones(3), 0.2, np.zeros(3), 1.0)
    forces: list[Any] = []

    def under(discrepancy: Discrepancy) -> Subsets:
        forces.append(discrepancy)
        columns = np.array([[20.0, 20.0, 0.0], [size, 0.0, size], [1.0, 0.0, 0.0]])
        unbounded = np.full(2, np.inf)
        prior = Prior(np.zeros(2), np.full(2, 1e-9))
        return Subsets(columns.T @ columns, (), OrderedDict(drag=(0,), slope=(1,)), prior, -unbounded, unbounded)

    linear: Any = SimpleNamespace(point=SimpleNamespace(discrepancy=of, effects=("drag", "slope")), under=under)
    search: Any = SimpleNamespace(
        scales=SimpleNamespace(force=np.full(3, 10.0)), criteria=CRITERIA, refit=lambda point, effects: tuple(effects)
    )
    kept = law_proposals.with_needed_effects(search, linear)
    assert (linear.point.effects if kept is linear else kept) == needed
    np.testing.assert_allclose(forces[0].force, CRITERIA.cautious_force * 10.0)
    assert forces[0].force_time >= CRITERIA.shortest_force


def of_two_effects(law: np.ndarray, drag: float = 0.0, seed: int = 1) -> tuple[Beside, ProposedLaw]:
    """Runs of a drag of size `drag` and of a law, of whose history a slope is a part; `law` (n,): what the law moves in
    the samples, which it did with an amplitude of 20."""
    rng = np.random.default_rng(seed)
    known = np.column_stack([rng.normal(size=SAMPLES), 0.6 * law + 0.8 * rng.normal(size=SAMPLES)]) / np.sqrt(SAMPLES)
    y = drag * known[:, 0] + 20.0 * law / np.sqrt(SAMPLES) + rng.normal(size=SAMPLES)
    columns = np.column_stack([known, law / np.sqrt(SAMPLES)])

    def normal(histories: Any) -> tuple[np.ndarray, np.ndarray]:
        return (columns.T @ columns)[None, None], (columns.T @ y)[None, None]

    unbounded = np.full(2, np.inf)
    prior = Prior(np.zeros(2), np.full(2, 1e-9))
    of_known = Subsets(np.zeros((3, 3)), (), OrderedDict(drag=(0,), slope=(1,)), prior, -unbounded, unbounded)
    windows: Any = SimpleNamespace(
        normal=normal, histories=lambda family, shape: None, square=np.array([y @ y]), prior_mean=np.zeros(2)
    )
    family = Family("", "X", ("x",), (Term("a", {}, (("X", "x"),)),), (ShapeParameter("s", {}, (0.1, 0.2, 0.4)),))
    made = ProposedLaw(
        "X = a * x", (LawParameter("a", "N"),), {"a": 1.0, "s": 0.2}, family, np.array([0.2]), 1.0, 0.0, y
    )
    return Beside(windows, of_known, 5.0), made._replace(forms=1000)


def test_known_effects_are_chosen_again_beside_a_law() -> None:
    """The slope stood in for the law, and goes; the drag, which was not seen beside it, comes."""
    beside, law = of_two_effects(np.random.default_rng(3).normal(size=SAMPLES), drag=8.0)
    penalised, effects, step = law_proposals.chosen_beside(beside, law, ("slope",))
    assert set(effects) == {"drag", LAW}
    np.testing.assert_allclose(step, [8.0, 0.0, 20.0], atol=3.5)
    problem = law_proposals.with_law(beside, law)
    level = CRITERIA.significance_level / CRITERIA.nominal_candidates
    paid = stats.chi2.isf(level, 1) + stats.chi2.isf(level / 3000, 1)
    assert penalised == pytest.approx(problem.with_effects(effects).chi2 + paid + beside.log)


def test_laws_are_compared_beside_the_force_with_which_each_is_likeliest(monkeypatch) -> None:
    """A larger force hides more, so that chi^2 is smaller beside it, and is less likely where it is not needed. A law
    that is not needed beside the effects that it brings is none."""
    made = proposal("the law", "world", ("x",), 0.0).law._replace(
        parameters=(LawParameter("a", "N"),), values={"a": 1.0}
    )
    of_force = {1 / 3: (50.0, ["drag", LAW], 1.0), 1 / 10: (41.0, ["slope", LAW], 2.0), 1 / 30: (42.0, ["drag"], 3.0)}

    def weaker(search: Any, linear: Any, share: float) -> Any:
        subsets = SimpleNamespace(without=lambda unfit: share)
        return Made(share=share, subsets=subsets, point=Made(effects=()))

    def chosen(beside: Beside, law: ProposedLaw, start: Any) -> Any:
        penalised, effects, amplitude = of_force[beside.known]  # type: ignore[index]
        return penalised, effects, np.array([7.0, 8.0, amplitude])

    windows = SimpleNamespace(keeping=lambda columns: None)
    monkeypatch.setattr(law_proposals, "beside_weaker_force", weaker)
    monkeypatch.setattr(law_proposals, "slopeless", lambda search, point: [])
    monkeypatch.setattr(law_proposals, "force_windows", lambda search, linear: windows)
    monkeypatch.setattr(law_proposals, "log_determinant", lambda linear: 0.0)
    monkeypatch.setattr(law_proposals, "search_laws", lambda windows, most: (made,))
    monkeypatch.setattr(law_proposals, "chosen_beside", chosen)
    model = SimpleNamespace(names=("drag", "slope"), free=lambda effects: [("drag", "slope").index(e) for e in effects])
    segments = SimpleNamespace(moved=lambda values, step: values + step)
    search: Any = SimpleNamespace(model=model, segments=segments)
    linear: Any = SimpleNamespace(point=SimpleNamespace(effects=("drag",), values=np.array([0.5, 0.25])))
    (only,) = law_proposals.proposed(search, linear)
    asked: list[dict[str, float]] = []
    monkeypatch.setattr(law_proposals, "is_passive", lambda windows, law, known: asked.append(known))
    assert law_proposals.proposed(search, linear) == [], "a law that is not passive is none"
    assert asked == [{"drag": 7.5, "slope": 8.25}]
    monkeypatch.setattr(law_proposals, "is_passive", lambda *_: True)
    assert (only.penalised, only.weak.point.effects) == (41.0, ("slope",))
    assert only.weak.share == 1 / 3, "the fit begins beside the force of the search"  # type: ignore[attr-defined]
    assert only.law.values == {"a": 2.0} and only.law.steps.tolist() == [8.0]
    of_force[1 / 30] = (40.0, ["drag"], 3.0)
    assert law_proposals.proposed(search, linear) == []
