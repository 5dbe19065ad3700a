"""What an explanation would try, and criteria that a case states."""

import dataclasses

import pytest
from helpers.small_case import small

from snakejax.core.errors import InputError
from snakejax.diagnosis.plan import plan_of
from snakejax.diagnosis.selection.criteria import CRITERIA, SelectionCriteria
from snakejax.effects import LIBRARY


def test_a_plan_has_every_effect_once() -> None:
    case, _, _ = small()
    plan = plan_of(case, {name: kind() for name, kind in LIBRARY.items()}, with_=["body_drag"])
    assert set(plan.candidates) | set(plan.left_out) | {"body_drag"} == set(LIBRARY)
    assert plan.candidates["ground_slope"] == ("sx", "sy")
    assert (plan.train, plan.heldout) == (("here",), ("there",))
    assert plan.free[-1] == "effects.body_drag"


def test_a_case_states_criteria() -> None:
    case, _, _ = small()
    stated = dataclasses.replace(case, search={"significance_level": 0.05, "most_effects": 2.0})
    found = SelectionCriteria.of(stated)
    assert found == CRITERIA._replace(significance_level=0.05, most_effects=2)
    assert isinstance(found.most_effects, int)
    assert SelectionCriteria.of(case) == CRITERIA
    with pytest.raises(InputError, match="There is no criterion `significance`"):
        SelectionCriteria.of(dataclasses.replace(case, search={"significance": 0.05}))
