"""Terms of a law that the recordings do not show, beside a random force."""

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from snakejax.diagnosis.inexact import fitted_law
from snakejax.diagnosis.inexact.fitted_law import FittedLaw, Proposal
from snakejax.diagnosis.inexact.left_out import LeftOut
from snakejax.diagnosis.inexact.search import Linear
from snakejax.diagnosis.inexact.subsets import Subsets
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.diagnosis.law.terms import Family, ShapeParameter, Term
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.dynamics.law import LawParameter
from snakejax.estimation.discrepancy.least_squares import Prior

RUNS, BLOCKS = 3, 4


def proposal(whole: bool = False) -> Proposal:
    """A washboard along both axes of the world."""
    terms = (Term("a", {"N": 1}, (("east", "sin(k * x)"),)), Term("f", {"N": 1}, (("north", "sin(k * x)"),)))
    shape = (ShapeParameter("k", {"m": -1}, (9.0,)),)
    family = Family("wave", "world", ("x",), terms, shape, whole)
    parameters = (LawParameter("a", "N"), LawParameter("f", "N"), LawParameter("k", "1/m", 9.0))
    values, none = {"a": 0.01, "f": 0.002, "k": 9.0}, np.zeros(0)
    law = ProposedLaw(family.expression(), parameters, values, family, none, 1.0, 1.0, none)
    weak: Any = None
    return Proposal(weak, law, 1.0)


def linear_problem() -> tuple[Linear, LeftOut]:
    """A tyre and the two amplitudes of a law, now at 0.01 N and 0.002 N, with blocks of three runs."""
    rng = np.random.default_rng(3)
    blocks = np.zeros((RUNS, BLOCKS, 4, 4))
    for r in range(RUNS):
        for b in range(BLOCKS):
            columns = rng.normal(size=(30, 4))
            blocks[r, b] = columns.T @ columns
    unbounded = np.full(3, np.inf)
    prior = Prior(np.array([0.0, -0.01, -0.002]), np.array([1.0, 1e3, 1e3]))
    candidates = OrderedDict(law_1=(1, 2))
    subsets = Subsets(blocks.sum(axis=(0, 1)), (0,), candidates, prior, -unbounded, unbounded)
    none: Any = None
    point: Any = SimpleNamespace(effects=("law_1",), values=np.array([5.0, 0.01, 0.002]))
    linear = Linear(point, none, blocks.sum(axis=1), subsets)
    return linear, LeftOut(linear, none, blocks, np.zeros((RUNS, BLOCKS)), np.ones((RUNS, BLOCKS), bool), 1)


def fitted(linear: Linear, deviance: float, mean_square: float, whole: bool = False) -> FittedLaw:
    """The law in a model of a tyre."""
    names = ("tyre.D", "effects.law_1.a", "effects.law_1.f")
    search: Any = SimpleNamespace(model=SimpleNamespace(names=names), criteria=CRITERIA)
    none: Any = None
    blocks = np.full(RUNS, deviance / RUNS)
    return FittedLaw("law_1", proposal(whole), none, search, linear, blocks, np.log(mean_square) * np.ones(RUNS))


def test_a_term_that_is_left_out_has_no_amplitude(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with a prior that holds its amplitude at zero."""
    linear, whole = linear_problem()
    monkeypatch.setattr(fitted_law, "left_out", lambda search, at: whole)
    without = fitted_law._deviances_without_terms(fitted(linear, 80.0, 1.0))
    for column, amplitude in ((1, "a"), (2, "f")):
        precision = linear.subsets.prior.precision.copy()
        precision[column] = 1e12
        held = linear.subsets._replace(prior=linear.subsets.prior._replace(precision=precision))
        expected = whole._replace(linear=linear._replace(subsets=held)).deviance(("law_1",)).sum()
        assert without[amplitude] == pytest.approx(expected, rel=1e-6)
        assert abs(without[amplitude] - whole.deviance(("law_1",)).sum()) > 1e-3


@pytest.mark.parametrize(
    ("deviance", "mean_square", "whole", "left"),
    [
        (83.0, 1.0, False, "east = a * sin(k * x)"),
        (95.0, 1.0, False, "east = a * sin(k * x); north = f * sin(k * x)"),  # these runs show it
        (83.0, 4.0, False, "east = a * sin(k * x); north = f * sin(k * x)"),  # whole runs show it
        (83.0, 1.0, True, "east = a * sin(k * x); north = f * sin(k * x)"),  # another form without it
    ],
)
def test_a_law_keeps_the_terms_that_predict_runs_left_out(
    monkeypatch: pytest.MonkeyPatch, deviance: float, mean_square: float, whole: bool, left: str
) -> None:
    """With both terms -2 log density is 80 and the error of each whole run 1; without the second, as given."""
    linear, _ = linear_problem()
    refitted: list[np.ndarray] = []

    def refit(point, effects):
        refitted.append(point.values)
        return linear

    def search_with(case, noise, like, search, base, name, shorter):
        assert [part.name for part in shorter.law.parameters] == ["a", "k"] and set(shorter.law.values) == {"a", "k"}
        return None, SimpleNamespace(model=SimpleNamespace(names=("tyre.D", "effects.law_1.a")), refit=refit)

    def judged(name, shorter, own_set, own, at):
        return fitted(linear, deviance, mean_square)._replace(proposal=shorter)

    class Point(SimpleNamespace):
        def _replace(self, **changes):
            return Point(**{**vars(self), **changes})

    linear = linear._replace(point=Point(**vars(linear.point)))  # type: ignore[arg-type]
    monkeypatch.setattr(fitted_law, "_deviances_without_terms", lambda law: {"a": 300.0, "f": 84.0})
    monkeypatch.setattr(fitted_law, "search_with", search_with)
    monkeypatch.setattr(fitted_law, "_judged", judged)
    search: Any = SimpleNamespace(criteria=CRITERIA)
    none: Any = None
    kept = fitted_law.without_idle_terms(none, none, none, search, (), fitted(linear, 80.0, 1.0, whole))
    assert kept.proposal.law.expression == left
    assert [values.tolist() for values in refitted] == ([] if whole else [[5.0, 0.01]])
