"""In what order known effects and laws are tried."""

from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import explaining


@pytest.mark.parametrize(
    ("suggests_law", "coupled", "known_explain", "law_explains", "tried", "shown"),
    [
        # Under its own structure the search at once has seen all known effects.
        (True, False, True, True, ["inexact"], []),
        (True, True, True, True, ["known"], ["known"]),
        (True, True, False, True, ["known", "inexact"], []),
        (True, True, False, False, ["known", "inexact"], ["known"]),
        (False, True, True, True, ["inexact"], []),
        (False, True, False, False, ["inexact", "known"], ["known"]),
    ],
)
def test_known_effects_of_a_coupled_base_come_before_a_law(
    monkeypatch: pytest.MonkeyPatch,
    suggests_law: bool,
    coupled: bool,
    known_explain: bool,
    law_explains: bool,
    tried: list[str],
    shown: list[str],
) -> None:
    done: list[str] = []
    at_once = SimpleNamespace(few=None, evidence=SimpleNamespace(suggests_law=suggests_law))
    diagnosis: Any = SimpleNamespace(base="base", switched="free" if coupled else None)

    def known(*_):
        done.append("known")
        return [SimpleNamespace(record="known")]

    def inexact(*_):
        done.append("inexact")
        return "law" if law_explains else None

    monkeypatch.setattr(explaining, "_one_effect_explains", lambda *_: False)
    monkeypatch.setattr(explaining, "choose_effects_at_once", lambda *_: at_once)
    # What is known of the first structure is not found out again.
    monkeypatch.setattr(explaining, "_under_first_structure", known)
    monkeypatch.setattr(explaining, "_steps_beyond_base", lambda *given: (given[4:] and given[4]) or known())
    monkeypatch.setattr(explaining, "leaves_only_noise", lambda _: known_explain)
    monkeypatch.setattr(explaining, "explain_inexact", inexact)
    seen: list[Any] = []
    found: Any = explaining._explanation_or_steps(None, None, diagnosis, None, seen.append)  # type: ignore[arg-type]
    assert done == tried and seen == shown
    assert found[0] == ("law" if tried[-1] == "inexact" and law_explains else None)
    # What was sought in vain is not sought again.
    assert found[2] is (suggests_law and "inexact" in tried and not law_explains)


def test_a_search_on_whole_runs_begins_with_the_few_effects_that_segments_found(monkeypatch) -> None:
    begun: list[Any] = []
    at_once = SimpleNamespace(few="few")
    monkeypatch.setattr(explaining, "_one_effect_explains", lambda *_: False)
    monkeypatch.setattr(explaining, "choose_effects_at_once", lambda *_: at_once)
    monkeypatch.setattr(explaining, "_steps_beyond_base", lambda diagnosis, few, *_: begun.append(few) or [])
    diagnosis: Any = SimpleNamespace(base="base", switched=None)
    assert explaining._explanation_or_steps(None, None, diagnosis, None, None) == (None, ["base"], False)  # type: ignore[arg-type]
    assert begun == ["few"]
