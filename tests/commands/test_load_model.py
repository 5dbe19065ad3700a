"""A result that was written is loaded as a model again."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.command_inputs import WORLD_SPRING
from helpers.folders import DATA

import snakejax as sj
from snakejax.commands.cli import main
from snakejax.commands.requested_model import requested_model

LEVEL = DATA / "level-board"
SLOPE_Y = "effects.ground_slope.sy"
GIVEN = ["--set", "B=7.6,C=1.5,D=8.5,E=-0.1", "--start", "0,0,0.3"]


def end_of(model: sj.Model) -> np.ndarray:
    """The end pose of the first run of level-board, from (0, 0, 0.3)."""
    run = sj.load_case(LEVEL).runs[0]
    return np.asarray(sj.simulate(model, run.gait, run.times, start=(0.0, 0.0, 0.3)).pose)[-1]


def written(folder: Path, *words: str) -> tuple[Path, np.ndarray]:
    """The JSON of a simulation, and the end pose of the first run in it."""
    path = folder / "simulate.json"
    assert main(["simulate", str(LEVEL), *GIVEN, *words, "--json", str(path), "--quiet"]) == 0
    end = json.loads(path.read_text())["runs"][0]["end"]
    return path, np.array([end["x_m"], end["y_m"], end["heading_rad"]])


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("--with", "ground_slope:sx=0.01,sy=-0.005"),
        *(pytest.param(words, marks=pytest.mark.long) for words in [(), ("--skid", "coupled")]),
    ],
)
def test_a_written_model_gives_the_same_simulation(words: tuple[str, ...], tmp_path: Path) -> None:
    path, end = written(tmp_path, *words)
    model = sj.load_model(path)
    np.testing.assert_allclose(end_of(model), end, atol=1e-9)
    assert float(model.board.creep_speed) == 0.01 and float(model.tyre.C) == 1.5
    assert ("ground_slope" in model.effects) is ("--with" in words)


@pytest.mark.slow
def test_an_effect_of_ones_own_is_given_again(tmp_path: Path) -> None:
    own = tmp_path / "mine.py"
    own.write_text(WORLD_SPRING, encoding="utf-8")
    path, end = written(tmp_path, "--with", f"{own}:WorldSpring:k=0.5")
    with pytest.raises(sj.InputError, match="`world_spring`, which is not built in"):
        sj.load_model(path)
    np.testing.assert_allclose(end_of(sj.load_model(path, f"{own}:WorldSpring")), end, atol=1e-9)


@pytest.mark.slow
def test_the_final_model_of_an_explanation_is_loaded(tmp_path: Path) -> None:
    path, _ = written(tmp_path)
    found = json.loads(path.read_text())
    slope = {name: {"value": value, "sd": 1e-4, "unit": "rad"} for name, value in (("sx", 0.01), ("sy", -0.005))}
    constants = {**found["vehicle"]["constants"], "mass": {"value": 7.2, "unit": "kg"}}
    final = {
        "model": "pacejka",
        "skid": "free",
        "vehicle": {"kind": "snakeboard", "constants": constants},
        "parameters": found["base"]["parameters"],
        "effects": {"lateral_skid": {}, "ground_slope": slope},
    }
    path.write_text(json.dumps({**found, "skid": "coupled", "final": final}))
    model = sj.load_model(path)
    assert model.structure == "free" and list(model.effects) == ["ground_slope"]
    assert (float(model.effects["ground_slope"].sx), float(model.board.mass)) == (0.01, 7.2)


def test_what_an_explanation_estimated_of_the_vehicle_is_used_in_another_case(tmp_path: Path) -> None:
    constants = {"mass": {"value": 7.2, "sd": 0.1, "unit": "kg"}}
    slope = {name: {"value": value, "sd": 1e-4, "unit": "rad"} for name, value in (("sx", 0.01), ("sy", -0.005))}
    values = {"B": 7.6, "C": 1.5, "D": 8.5, "E": -0.1}
    tyre = {name: {"value": value, "sd": 0.1, "unit": "-"} for name, value in values.items()}
    final = {"model": "pacejka", "skid": "free", "parameters": tyre, "effects": {"ground_slope": slope}}
    path = tmp_path / "explain.json"
    path.write_text(
        json.dumps({"final": {**final, "constants": constants}, "base": {}, "model": "pacejka", "skid": "coupled"})
    )
    requested = requested_model(sj.load_case(LEVEL), {"from_": path})
    assert float(requested.model.board.mass) == 7.2
    assert requested.freed(["B", "D"]) == ["tyre.B", "tyre.D"], "what the file has a value for is estimated if named"
    assert set(requested.freed(None)) == {*(f"tyre.{n}" for n in values), "effects.ground_slope.sx", SLOPE_Y}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda found: found.pop("vehicle"), "does not hold the vehicle"),
        (lambda found: found["vehicle"].update(kind="boat"), "There is no vehicle `boat`"),
        (lambda found: found["vehicle"]["constants"].pop("mass"), "mass"),
        (lambda found: found["vehicle"]["constants"]["mass"].update(value=-1), "must be above 0"),
        (lambda found: found["base"]["parameters"]["C"].update(value="x"), "does not hold a fit"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(change, expected: str, tmp_path: Path) -> None:
    path, _ = written(tmp_path)
    found = json.loads(path.read_text())
    change(found)
    path.write_text(json.dumps(found))
    with pytest.raises(sj.InputError) as told:
        sj.load_model(path)
    assert expected in str(told.value) and "\n" not in str(told.value)
