"""`--by`: parameters that have values of their own for each floor, and what a new floor has changed."""

import dataclasses
import io
import json
import re
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest
from helpers.wandering_car import CONSTANTS, TYRE, windows
from rich.console import Console

import snakejax as sj
from snakejax.commands.conditions import changes
from snakejax.commands.diagnosing import diagnose_case
from snakejax.commands.fitting import fit_case
from snakejax.core.parameter import with_parameters
from snakejax.dynamics.model import Model
from snakejax.present.as_json.fit import fit_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.as_json.schema import schema_of
from snakejax.present.as_json.values import as_text
from snakejax.present.as_text.explanation import candidate_table
from snakejax.recording.run import Case, Noise, Run
from snakejax.vehicles.car import DART, Car

GAIT = sj.Gait(sj.Sines.of([[0.35, 3.0, 0.0]]), sj.Sines.of([[1.2, 3.0, 0.4]]))
GRIP = {"rubber": 3.0, "tiles": 2.2}
ALL = ["B=8", "C=1.3", "E=0.2"]


def on(grip: float) -> Model:
    """A board that slips past the peak of its tyre."""
    return Model(sj.Board(**sj.TABLE_II), sj.Pacejka(8.0, 1.3, grip, 0.2), "free")


@cache
def two_floors() -> Case:
    """Two train runs and one held-out run on each of two floors."""
    noise, times = Noise(jnp.asarray(4e-4), jnp.asarray(2.5e-3), "stated"), jnp.arange(300.0) * 0.02
    rng, runs = np.random.default_rng(1), []
    for floor, grip in GRIP.items():
        pose = np.asarray(sj.simulate(on(grip), GAIT, times).pose)
        for number, role in enumerate(("train", "train", "heldout")):
            seen = jnp.asarray(pose + rng.normal(size=pose.shape) * np.asarray(noise.channels))
            runs.append(Run(f"{floor}{number}", role, times, seen, GAIT, labels=(("floor", floor),)))
    return Case("floors", "two floors", "free", on(1.0).board, tuple(runs), noise)


def alone(floor: str) -> Case:
    """The runs on one floor."""
    case = two_floors()
    return dataclasses.replace(case, runs=tuple(run for run in case.runs if ("floor", floor) in run.labels))


@pytest.mark.slow
def test_each_floor_has_the_value_of_a_fit_to_its_runs_alone(tmp_path: Path) -> None:
    options = {"set": ALL, "free": "D"}
    both, noise = fit_case(two_floors(), {**options, "by": "floor"})
    base = float(both.model.tyre.D)
    for floor, grip in GRIP.items():
        own = fit_case(alone(floor), options)[0]
        single = own.estimates["tyre.D"]
        ratio = both.estimates[f"effects.by_floor.D_{floor}"]
        assert ratio.value * base == pytest.approx(single.value, abs=0.1 * single.sd)
        assert ratio.sd * base == pytest.approx(single.sd, rel=0.15)
        assert abs(ratio.value * base - grip) < 4 * single.sd
    assert both.heldout_score.misfit < 1.2
    path = tmp_path / "fit.json"
    written = fit_json(two_floors(), noise, both, provenance_json(0, options, {}))
    effects = {"$ref": "#/$defs/effects", "$defs": schema_of("fit")["$defs"]}
    jsonschema.validate(json.loads(as_text(written))["base"]["effects"], effects)
    path.write_text(as_text(written))
    again = sj.load_model(path)
    for run in two_floors().runs:
        same = [model.in_run(run.payload, run.codes) for model in (again, both.model)]
        assert float(same[0].tyre.D) == float(same[1].tyre.D)
    # A run on a floor that the file does not know has the value that all runs share.
    assert float(again.in_run(jnp.zeros(2), np.zeros(4)).tyre.D) == base


@pytest.mark.parametrize(
    ("key", "message"),
    [("colour", "Runs have no label `colour`"), ("day", "No run to train on has a day")],
)
def test_a_label_that_is_not_there_is_one_line(key: str, message: str) -> None:
    with pytest.raises(sj.InputError, match=message):
        fit_case(two_floors(), {"by": key})


def test_what_may_have_changed_is_each_parameter_once_and_the_grip_of_both_axles_together() -> None:
    case = dataclasses.replace(two_floors(), board=Car(**DART, **CONSTANTS, creep_speed=0.1))
    named = changes(Model(case.board, TYRE, "free"), case, "floor")
    assert [one.names for one in named["grip_by_floor"].differences] == [("tyre.front.D", "tyre.rear.D")] * 2
    assert {"stiffness_by_floor", "front_C_by_floor", "mass_by_floor", "inertia_by_floor"} <= set(named)
    counted = [name for effect in named.values() for one in effect.differences for name in one.names]
    assert len(counted) == 2 * len(set(counted))


@pytest.mark.long
def test_a_floor_with_less_grip_is_named(tmp_path: Path) -> None:
    car = Car(**DART, **CONSTANTS, creep_speed=0.1)
    known = Model(car, TYRE, "free")
    slippery = with_parameters(
        known, {f"tyre.{axle}.D": 0.75 * float(getattr(TYRE, axle).D) for axle in ("front", "rear")}
    )
    case = windows(slippery, recordings=6, heldout=1, seed=5)
    runs = tuple(dataclasses.replace(run, labels=(("floor", "tiles"),)) for run in case.runs)
    case = dataclasses.replace(case, runs=runs, board=car, constraint="free")
    path = tmp_path / "known.json"
    fixed = {"value": 0.0, "sd": None, "unit": "-"}
    tyre = {
        f"{axle}.{n}": {**fixed, "value": float(getattr(getattr(TYRE, axle), n))}
        for axle in ("front", "rear")
        for n in "BCDE"
    }
    path.write_text(json.dumps({"model": "pacejka", "skid": "free", "base": {"parameters": tyre, "effects": {}}}))
    base = diagnose_case(case, {"from_": path, "by": "floor"}).base
    ranking = base.ranking
    printed = io.StringIO()
    Console(width=80, file=printed).print(candidate_table(base))
    # One line each: a label of effect and parameter would leave no room for the numbers.
    assert re.search(r"grip_tiles +\S+ +\S+ +0\.7\d* \+- 0\.\d+", printed.getvalue())
    assert ranking[0].effect == "grip_by_floor"
    estimate = ranking[0].estimate["grip_tiles"]
    assert abs(estimate.value - 0.75) < 3 * estimate.sd < 0.3


def test_values_by_floor_need_windows_to_be_searched_for() -> None:
    with pytest.raises(sj.InputError, match="needs train runs that are windows of recordings"):
        diagnose_case(two_floors(), {"by": "floor"})
