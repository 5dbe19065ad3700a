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
