"""How sure an effect is where it leaves only noise of the train runs."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from snakejax.diagnosis import exact_explanation
from snakejax.diagnosis.exact_explanation import confidence_where_exact
from snakejax.diagnosis.odd_runs import OddRun


@pytest.mark.parametrize(
    ("before", "after", "word"),
    [
        (7.4, 2498.0, "stand_in"),
        (7.4, 1.0, "sure"),
        (2498.0, 7.4, "sure"),
        # Noise may leave a little more than it did.
        (1.0, 1.01, "sure"),
        (None, None, "sure"),
    ],
)
def test_an_effect_with_which_held_out_runs_are_further_off_is_not_sure(before, after, word, monkeypatch) -> None:
    monkeypatch.setattr(exact_explanation, "indistinguishable", lambda steps, effect: ())
    model = SimpleNamespace(effects={}, board=SimpleNamespace(stated_sd={}))

    def step(name: str, misfit: float | None) -> SimpleNamespace:
        heldout = None if misfit is None else SimpleNamespace(misfit=misfit, samples=10_000)
        return SimpleNamespace(name=name, heldout=heldout, model=model)

    steps = cast(Any, [step("base", before), step("law_1", after)])
    assert confidence_where_exact(steps, "law_1") == word


@pytest.mark.parametrize(
    ("before", "after", "verdict"),
    [(7.4, 2498.0, "unexplained"), (7.4, 2.6, "explained"), (1.0, 1.01, "explained"), (None, None, "explained")],
)
def test_what_leads_held_out_runs_astray_explains_only_train_runs(before, after, verdict, monkeypatch) -> None:
    """Also where the train runs determine its values so badly that the error does not contradict it."""
    for name in ("bands_of", "odd_runs_beside"):
        monkeypatch.setattr(exact_explanation, name, lambda *given: ())
    monkeypatch.setattr(exact_explanation, "shares_of", lambda steps: ({}, 1.0))
    monkeypatch.setattr(exact_explanation, "confidence_where_exact", lambda *given: "sure")

    def step(misfit: float | None, *effects: str) -> SimpleNamespace:
        heldout = None if misfit is None else SimpleNamespace(misfit=misfit, samples=10_000)
        return SimpleNamespace(name="", heldout=heldout, effects=effects, left_out=(), fitted=None)

    steps, last = (step(before), step(after, "law_1")), SimpleNamespace(candidate_set=None, step=None)
    found = exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps)))
    assert found.verdict == verdict
    assert (found.partial if verdict == "unexplained" else found.effects) == ("law_1",)
    assert exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps[:1]))).verdict == "adequate"


def test_an_effect_instead_of_which_a_run_may_be_odd_is_not_sure_and_the_run_is_named(monkeypatch) -> None:
    monkeypatch.setattr(exact_explanation, "indistinguishable", lambda steps, effect: ())
    monkeypatch.setattr(exact_explanation, "shares_of", lambda steps: ({}, 1.0))
    monkeypatch.setattr(exact_explanation, "bands_of", lambda *given: ())
    beside = OddRun("two", "tyre.D", 1.0, 0.1, 1e-4)
    monkeypatch.setattr(exact_explanation, "odd_runs_beside", lambda *given: (beside,))
    instead = OddRun("four", "tyre.B", 1.0, 0.2, 1e-3, effects=("ground_slope",))

    def step(*effects: str) -> SimpleNamespace:
        model = SimpleNamespace(effects={}, board=SimpleNamespace(stated_sd={}))
        return SimpleNamespace(name="", heldout=None, effects=effects, left_out=(), fitted=None, model=model)

    steps, last = (step(), step("com_offset", "ground_slope")), SimpleNamespace(candidate_set=None, step=None)
    found = exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps)), instead=(instead,))
    assert found.confidence == {"com_offset": "sure", "ground_slope": "stand_in"}
    assert found.odd_runs == (beside, instead)
    both = (instead, instead._replace(effects=("com_offset",)))
    found = exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps)), instead=both)
    assert found.confidence == {"com_offset": "stand_in", "ground_slope": "stand_in"}
    assert [odd.effects for odd in found.odd_runs] == [(), ("ground_slope", "com_offset")]
