"""The models in the JSON of an explanation: the base, each step, and the final one."""

import json
from pathlib import Path

import jsonschema
import pytest
from helpers.made_up_explanation import result

from snakejax.commands.loading import load_models
from snakejax.core.errors import InputError
from snakejax.core.parameter import parameters
from snakejax.present.as_json.saved import saved_models
from snakejax.present.as_json.schema import schema_of
from snakejax.present.as_json.values import clean


def written(tmp_path: Path, told: dict) -> Path:
    path = tmp_path / "explain.json"
    path.write_text(json.dumps(clean(told)), encoding="utf-8")
    return path


def test_every_step_of_an_explanation_is_a_model(tmp_path: Path) -> None:
    told = json.loads(json.dumps(clean(result())))
    jsonschema.validate(told["steps"][0], schema_of("explain") | {"allOf": [{"$ref": "#/$defs/step"}]})
    models = load_models(written(tmp_path, told))
    assert list(models) == ["base", "ground_slope", "rotor_gain", "final"]
    assert [list(model.effects) for model in models.values()] == [
        [],
        ["ground_slope"],
        ["ground_slope", "rotor_gain"],
        ["ground_slope", "rotor_gain"],
    ]
    sx = told["steps"][0]["fitted"]["effects"]["ground_slope"]["sx"]["value"]
    assert float(parameters(models["ground_slope"])["effects.ground_slope.sx"].value) == sx


def test_a_file_without_the_models_of_its_steps_has_base_and_final(tmp_path: Path) -> None:
    told = json.loads(json.dumps(clean(result())))
    for step in told["steps"]:
        del step["fitted"]
    assert list(saved_models(written(tmp_path, told))) == ["base", "final"]
    with pytest.raises(InputError, match="does not hold a fit"):
        saved_models(written(tmp_path, {"steps": 3, "base": {}}))
