"""How sure an effect is where it leaves only noise of the train runs."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from snakejax.diagnosis import exact_explanation
from snakejax.diagnosis.exact_explanation import confidence_where_exact


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
    monkeypatch.setattr(exact_explanation, "confidence_where_exact", lambda steps, effect: "sure")

    def step(misfit: float | None, *effects: str) -> SimpleNamespace:
        heldout = None if misfit is None else SimpleNamespace(misfit=misfit, samples=10_000)
        return SimpleNamespace(name="", heldout=heldout, effects=effects, left_out=(), fitted=None)

    steps, last = (step(before), step(after, "law_1")), SimpleNamespace(candidate_set=None, step=None)
    found = exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps)))
    assert found.verdict == verdict
    assert (found.partial if verdict == "unexplained" else found.effects) == ("law_1",)
    assert exact_explanation.exact_explanation(*cast(Any, (None, None, last, steps[:1]))).verdict == "adequate"
