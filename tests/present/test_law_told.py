"""A law that was found is told: in the JSON, which is read back, as text and in the report."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.made_up_explanation import models, result, story
from jsonschema import Draft202012Validator

from snakejax import TABLE_II, Board, Gait, InputError, Model, Pacejka, Run, Sines, simulate
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.diagnosis.law.terms import Family
from snakejax.diagnosis.residuals.replays import RunReplay, replay_model
from snakejax.dynamics.law import Law, LawParameter, law
from snakejax.estimation.uncertainty import Estimate
from snakejax.present.as_json.saved import saved_fit
from snakejax.present.as_json.schema import schema_of
from snakejax.present.as_text.certainty import confidence_sentences, law_sentences
from snakejax.present.as_text.first_lines import first_lines
from snakejax.present.report import explanation_page
from snakejax.present.report.charts import shape
from snakejax.present.report.law_force import law_forces

EXPRESSION = "grip = 1 - a * tanh((rotor_rate / s) ** 2)"
NOTHING_SAID = {
    "seconds": {"total": 1.0, "compile": 0.5},
    "quality": {"as_recorded": False, "findings": [], "masked": {}},
}
VALUES, UNITS = {"a": 0.35, "s": 4.0}, {"a": "-", "s": "rad/s"}


def proposed(expression: str, left_out: float) -> ProposedLaw:
    parameters = (LawParameter("a", "-"),)
    shape = np.zeros(0)
    family = Family("even saturation", "grip", ("rotor_rate",), ())
    return ProposedLaw(expression, parameters, {"a": 0.1}, family, shape, left_out, left_out, shape)


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
    size = "grows with the size of the rotor rate and levels off beyond s"
    assert f"In words, law_1 is a change of the grip of each wheel that {size}." in lines


def test_a_rival_with_more_numbers_is_not_told_and_a_long_one_is_told_in_words() -> None:
    found = told()
    assert found.law is not None
    first, second = found.law.laws
    long = "grip = 1 - a * (abs(rotor_rate) + " + " + ".join(["rotor_rate ** 2"] * 8) + ")"
    rival = second._replace(expression=long, family=Family("square", "grip", ("steering_rate",), ()))
    more = second._replace(expression="grip = 1 - a - b", parameters=(LawParameter("a", "-"), LawParameter("b", "-")))
    law = dataclasses.replace(found.law, laws=(first, rival, more))
    text = " ".join(law_sentences(dataclasses.replace(found, law=law)))
    words = "a change of the grip of each wheel in proportion to the square of the steering rate"
    assert f"these laws fit almost as well: {words}." in text


def test_a_rival_that_is_far_off_is_said_to_be() -> None:
    assert any("No other form comes near it" in line for line in law_sentences(told(rival=9.0)))


def test_laws_that_do_as_well_beside_a_random_force_are_told() -> None:
    found = told()
    assert found.law is not None
    law = dataclasses.replace(found.law, misfit=None)
    sure = {"law_1": "ambiguous"}
    beside = dataclasses.replace(found, law=law, confidence=sure)
    lines = list(law_sentences(beside))
    assert lines[-1] == "These laws predict omitted runs as well: grip = 1 - a * rotor_rate ** 2."
    assert "Ambiguous: another law would explain" in " ".join(confidence_sentences(beside, "law_1"))
    alone = dataclasses.replace(beside, law=dataclasses.replace(law, laws=law.laws[:1]))
    assert not any("omitted runs as well" in line for line in law_sentences(alone))


def test_a_law_that_leaves_more_than_noise_is_told_to_lower_the_error() -> None:
    lines = [line for _, line in first_lines(told(verdict="unexplained"))]
    assert any(line.startswith("Lowers the error: law_1") for line in lines)
    assert not any("Still significant together with the missing force" in line for line in lines)


@pytest.mark.slow
def test_the_report_has_a_section_of_the_law() -> None:
    found = told()
    page = explanation_page(found, result(found) | NOTHING_SAID, models(found))
    assert "The law of the missing force" in page and "rotor_rate / s" in page
    assert '"name":"law"' not in page.replace(" ", ""), "A factor on the grip is no force."


FORCE = "east = k * (0.5 - x) + a * tanh(rotor_rate); N = -c * r"
OF_FORCE = {"k": (0.4, "N/m"), "a": (0.1, "N"), "c": (0.02, "N m s")}


def driven_by(effect: Law, constraint: str) -> tuple[Model, RunReplay, dict[str, np.ndarray]]:
    """The law along a run that it drives: the model, the replay, and the force drawn."""
    base = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=7.0, C=1.4, D=5.0, E=0.0), constraint)
    model, gait = base.add(law_1=effect), Gait(*(Sines.of([[size, 4.0, 0.0]]) for size in (0.9, 1.6)))
    times, start = jnp.arange(60) / 50, (0.1, 0.2, 0.3)
    run = Run("driven", "train", times, simulate(model, gait, times, start).pose, gait)
    replays = replay_model(model, [run], np.array([[*start, 0.0, 0.0, 0.0]]))
    fitted: Any = SimpleNamespace(model=model, recordings=(run,))
    return model, replays[0], law_forces(fitted, replays)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["free", "coupled"])
def test_the_force_of_a_law_along_a_run_is_that_of_its_effect(constraint: str) -> None:
    effect = law(FORCE, {n: unit for n, (_, unit) in OF_FORCE.items()}, {n: v for n, (v, _) in OF_FORCE.items()})
    _, replay, forces = driven_by(effect, constraint)
    theta, r = replay.pose[:, 2] - replay.skid_angle, replay.velocity[:, 2]
    east = 0.4 * (0.5 - replay.track.variables["x"]) + 0.1 * np.tanh(replay.track.variables["rotor_rate"])
    expected = np.stack([east * np.cos(theta), -east * np.sin(theta), -0.02 * r], axis=1)
    np.testing.assert_allclose(forces["driven"], expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expression", "units", "values"),
    [
        ("lateral = a * axle * steering_angle", {"a": "N/rad"}, {"a": 0.4}),
        ("resistance = a * tanh(rolling_speed / 0.01)", {"a": "N"}, {"a": 0.3}),
        ("height = a * wheel_x ** 2", {"a": "1/m"}, {"a": 0.05}),
    ],
)
def test_the_force_of_a_law_at_the_wheels_accelerates_the_body_as_the_law_does(
    expression: str, units: dict, values: dict
) -> None:
    effect = law(expression, units, values)
    model, replay, forces = driven_by(effect, "free")
    gait, without = Gait(*(Sines.of([[size, 4.0, 0.0]]) for size in (0.9, 1.6))), model.without("law_1")
    for k in (7, 31, 59):
        state, t = jax.tree.map(lambda leaf, k=k: leaf[k], replay.states), replay.times[k]
        with_law, other = (np.array(one.rates(t, state, gait)[0][3:6]) for one in (model, without))
        inertia = np.array([model.board.mass, model.board.mass, model.board.total_inertia])
        np.testing.assert_allclose(forces["driven"][k], inertia * (with_law - other), rtol=1e-9, atol=1e-12)
        assert np.abs(forces["driven"][k]).max() > 1e-3


@pytest.mark.slow
def test_a_law_that_is_a_factor_on_other_forces_has_no_force_of_its_own() -> None:
    assert driven_by(law(EXPRESSION, UNITS, VALUES), "free")[2] == {}


@pytest.mark.slow
def test_the_report_draws_a_law_that_is_a_force() -> None:
    found = told()
    effect = law("X = -a * u", {"a": "N s/m"}, {"a": 0.3})
    final = found.final
    model = final.model.without("law_1").add(law_1=effect)
    estimates = {"effects.law_1.a": Estimate(0.3, 0.01, "N s/m", True)}
    final = dataclasses.replace(final, fitted=dataclasses.replace(final.fitted, model=model), estimates=estimates)
    found = dataclasses.replace(found, steps=(*found.steps[:-1], final))
    page = explanation_page(found, result(found) | NOTHING_SAID, models(found)).replace(" ", "")
    assert page.count('"name":"law"') >= 2, "over time, and over the variable"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variable", "unit"), [("slip", "m/s"), ("time", "s"), ("speed", "m/s"), ("handle_angle", "rad")]
)
def test_the_force_over_a_variable_has_its_unit_on_any_vehicle(variable: str, unit: str) -> None:
    """Another vehicle has joints of other names."""
    found = told()
    assert found.law is not None
    view = models(found)[0]
    scenes = tuple(
        scene._replace(track=scene.track._replace(variables={**scene.track.variables, "handle_angle": scene.times}))
        for scene in view.scenes
    )
    chart = shape(found.law, variable, view._replace(scenes=scenes), {})
    assert f"{variable.replace('_', ' ')} [{unit}]" in json.dumps(chart.layout)
