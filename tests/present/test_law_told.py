"""A law that was found is told: in the JSON, which is read back, as text and in the report."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.made_up_explanation import models, result, story
from jsonschema import Draft202012Validator

from snakejax import InputError
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.law.grammar import Family
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.dynamics.law import LawParameter, law
from snakejax.estimation.uncertainty import Estimate
from snakejax.present.as_json.saved import saved_fit
from snakejax.present.as_json.schema import schema_of
from snakejax.present.as_text.certainty import law_sentences
from snakejax.present.as_text.first_lines import first_lines
from snakejax.present.report import explanation_page

EXPRESSION = "grip = 1 - a * tanh((rotor_rate / s) ** 2)"
NOTHING_SAID = {
    "seconds": {"total": 1.0, "compile": 0.5},
    "quality": {"as_recorded": False, "findings": [], "masked": {}},
}
VALUES, UNITS = {"a": 0.35, "s": 4.0}, {"a": "-", "s": "rad/s"}


def proposed(expression: str, left_out: float) -> ProposedLaw:
    parameters = (LawParameter("a", "-"),)
    shape = np.zeros(0)
    return ProposedLaw(expression, parameters, {"a": 0.1}, Family("", "", (), ()), shape, left_out, left_out, shape)


def told(rival: float = 1.02, verdict: str = "explained") -> Explanation:
    """A story that ends with a law; `rival`: what the second law leaves."""
    found, lacking = story(verdict="explained"), story()
    assert lacking.missing is not None
    laws = (proposed(EXPRESSION, 1.01), proposed("grip = 1 - a * rotor_rate ** 2", rival))
    force = dataclasses.replace(lacking.missing, laws=laws)
    final = found.final
    model = final.model.without(*final.model.effects).add(law_1=law(EXPRESSION, UNITS, VALUES))
    estimates = {f"effects.law_1.{n}": Estimate(v, 0.01, UNITS[n], True) for n, v in VALUES.items()}
    fitted = dataclasses.replace(final.fitted, model=model)
    final = dataclasses.replace(final, name="law_1", effects=("law_1",), fitted=fitted, estimates=estimates)
    steps = (*found.steps[:-1], final)
    missing = None if verdict == "explained" else force
    return dataclasses.replace(
        found, steps=steps, verdict=verdict, effects=("law_1",), law=force, missing=missing, partial=()
    )


def test_the_json_has_the_law_and_a_saved_fit_gives_it_back(tmp_path: Path) -> None:
    written = result(told())
    Draft202012Validator(schema_of("explain")).validate(json.loads(json.dumps(written | NOTHING_SAID)))
    entry = written["final"]["effects"]["law_1"]
    assert entry["expression"] == EXPRESSION and entry["s"]["value"] == 4.0 and entry["s"]["unit"] == "rad/s"
    path = tmp_path / "result.json"
    path.write_text(json.dumps(written))
    saved = saved_fit(path)
    assert saved.effects == {"law_1": VALUES}
    assert saved.kinds["law_1"].expression == EXPRESSION


def test_a_saved_law_that_is_none_is_refused(tmp_path: Path) -> None:
    written = result(told())
    written["final"]["effects"]["law_1"]["expression"] = "grip = __import__('os')"
    path = tmp_path / "result.json"
    path.write_text(json.dumps(written))
    with pytest.raises(InputError, match="does not hold a fit"):
        saved_fit(path)


def test_the_first_lines_tell_formula_values_and_rivals() -> None:
    lines = " ".join(line for _, line in first_lines(told()))
    assert EXPRESSION in lines and "s = 4.000 +- 0.010 rad/s" in lines
    assert "Over short windows these laws fit almost as well: grip = 1 - a * rotor_rate ** 2." in lines
    assert "rotor rate 82%" in lines


def test_a_rival_that_is_far_off_is_said_to_be() -> None:
    assert any("No other form comes near it" in line for line in law_sentences(told(rival=9.0)))


def test_a_law_that_leaves_more_than_noise_is_told_to_lower_the_error() -> None:
    lines = [line for _, line in first_lines(told(verdict="unexplained"))]
    assert any(line.startswith("Lowers the error: law_1") for line in lines)
    assert not any("Still significant together with the missing force" in line for line in lines)


@pytest.mark.slow
def test_the_report_has_a_section_of_the_law() -> None:
    found = told()
    page = explanation_page(found, result(found) | NOTHING_SAID, models(found))
    assert "The law of the missing force" in page and "rotor_rate / s" in page
