"""Explanations by effects that were chosen together: in which order laws and effects are tried."""

from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import all_effects_at_once as at_once_effects
from snakejax.diagnosis.all_effects_at_once import explain_inexact
from snakejax.diagnosis.selection.criteria import CRITERIA

none: Any = None


def asked(monkeypatch, sought: bool, exact: bool, law: bool, by_law: str | None, by_effects: Any) -> tuple[Any, list]:
    """What is explained, and in which order laws of whole runs and effects are asked."""
    order: list[str] = []
    evidence = SimpleNamespace(exact=exact, has_force=not exact, noise_wanders=False, suggests_law=sought)
    assessment = SimpleNamespace(evidence=evidence, law_force="force" if law else None)

    def of_law(*given: Any) -> str | None:
        order.append("law")
        return by_law

    def of_effects(*given: Any) -> Any:
        order.append("effects")
        return by_effects

    monkeypatch.setattr(at_once_effects, "by_exact_law", of_law)
    monkeypatch.setattr(at_once_effects, "_by_effects", of_effects)
    monkeypatch.setattr(at_once_effects, "assess_effects", lambda *given: assessment)
    at_once = at_once_effects.EffectsAtOnce(none, (), none, none, evidence)  # type: ignore[arg-type]
    return explain_inexact(none, none, none, at_once, none), order


@pytest.mark.parametrize(
    ("sought", "exact", "law", "by_law", "explained", "order"),
    [
        (True, False, False, "a law", "a law", ["law"]),
        (True, False, False, None, "effects", ["law", "effects"]),
        # A law beside the force makes the model exact: the force was the law. One on whole runs comes first.
        (False, True, True, "a law", "a law", ["law"]),
        (False, True, True, None, "effects", ["law", "effects"]),
        # Two laws do, so that none alone was found before: they are the explanation.
        (True, True, True, None, "effects", ["law", "effects"]),
        (False, False, True, "a law", "effects", ["effects"]),
    ],
)
def test_a_law_of_whole_runs_is_asked_before_those_beside_a_force(
    sought, exact, law, by_law, explained, order, monkeypatch
) -> None:
    monkeypatch.setattr(at_once_effects, "_law_may_explain", lambda assessment, explanation: False)
    assert asked(monkeypatch, sought, exact, law, by_law, "effects") == (explained, order)


def test_where_effects_explain_nothing_a_law_is_not_asked_again(monkeypatch) -> None:
    assert asked(monkeypatch, False, True, True, None, None) == (None, ["law", "effects"])
    assert asked(monkeypatch, False, False, False, "a law", None) == (None, ["effects"])


@pytest.mark.parametrize(("count", "law", "explains"), [(2, False, False), (2, True, True), (9, False, True)])
def test_an_exact_model_of_a_few_known_effects_is_left_to_the_fit_of_whole_runs(
    count, law, explains, monkeypatch
) -> None:
    """With a law among them it is not, as no candidate is that law."""
    effects = tuple(f"effect {k}" for k in range(count))
    assessment: Any = SimpleNamespace(
        evidence=SimpleNamespace(exact=True),
        candidate_set=SimpleNamespace(criteria=CRITERIA),
        effects=effects,
        law_force="force" if law else None,
        random_force_share=0.0,
        inside=lambda role: 0.95,
    )
    step = SimpleNamespace(effects=(), train=SimpleNamespace(misfit=9.0), fitted=none)
    last = SimpleNamespace(effects=effects, train=SimpleNamespace(misfit=1.0), fitted=none)
    fit = SimpleNamespace(solution=SimpleNamespace(values={}))
    monkeypatch.setattr(at_once_effects, "steps_of", lambda of: [last])
    fit_set = SimpleNamespace(problem=none)
    monkeypatch.setattr(at_once_effects, "_fitted_to_whole_runs", lambda candidate_set, of: (fit_set, fit))
    monkeypatch.setattr(at_once_effects, "consistent_with_noise", lambda solution: True)
    monkeypatch.setattr(at_once_effects, "fit_heldout_starts", lambda problem, values: none)
    monkeypatch.setattr(at_once_effects, "heldout_consistent", lambda *given: True)
    monkeypatch.setattr(at_once_effects, "explanation_of", lambda case, noise, of, steps, explained: explained)
    monkeypatch.setattr(at_once_effects, "bands_of", lambda fitted: ())
    monkeypatch.setattr(at_once_effects.dataclasses, "replace", lambda explanation, bands: explanation)
    diagnosis: Any = SimpleNamespace(base=SimpleNamespace(record=step))
    assert bool(at_once_effects._by_effects(none, none, diagnosis, assessment)) is explains
