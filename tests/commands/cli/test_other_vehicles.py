"""Commands on another vehicle than the snakeboard, made up."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.folders import DATA
from helpers.schema import deviations
from helpers.vehicle_case import steps, write_case

import snakejax as sj
from snakejax.commands import predict
from snakejax.commands.cli import main
from snakejax.core.parameter import parameters
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Pacejka
from snakejax.effects import library
from snakejax.vehicles.car import DART, Car

TRUE = {"steering_ratio": 0.45, "force_gain": 22.0}
TYRES = {"front.B": 6.0, "front.C": 1.4, "front.D": 6.0, "front.E": 0.1} | {
    "rear.B": 8.0, "rear.C": 1.4, "rear.D": 5.5, "rear.E": 0.1,
}  # fmt: skip


@pytest.fixture(scope="module")
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    vehicle = Car(**DART, **TRUE)
    front, rear = ([TYRES[f"{axle}.{name}"] for name in "BCDE"] for axle in ("front", "rear"))
    tyres = FrontRear(Pacejka(*front), Pacejka(*rear))
    truth = Model(vehicle, tyres, "free", {"steering_lag": library(vehicle)["steering_lag"](tau=0.1)})
    commands = ({"steer": steps(rng, 4, -0.6, 0.6), "drive": steps(rng, 4, 0.05, 0.2)} for _ in range(2))
    starts = ((0.0, 0.0, 0.0), (0.3, 0.1, 0.2, 1.0, 0.1, 0.3))
    runs = {name: (one, start) for name, one, start in zip(("train-1", "held-1"), commands, starts, strict=True)}
    return write_case(tmp_path_factory.mktemp("cases") / "car", "car", {**DART, **TRUE}, truth, runs, 4.0)


@pytest.mark.slow
def test_a_car_with_its_true_values_leaves_noise(car: Path, tmp_path: Path) -> None:
    """Commands held between samples, a lag, tyres by axle, and a held-out run that begins in motion."""
    values = ",".join(f"{name}={value}" for name, value in TYRES.items())
    where = tmp_path / "simulated.json"
    options = ["--set", values, "--effect", "steering_lag:tau=0.1", "--json", str(where), "--quiet"]
    assert main(["simulate", str(car), *options]) == 0
    runs = json.loads(where.read_text())["runs"]
    assert [run["run"] for run in runs] == ["train-1", "held-1"]
    assert all(0.8 < run["misfit"] < 1.2 for run in runs)
    loaded = sj.load_model(where)
    assert isinstance(loaded.board, Car) and list(loaded.effects) == ["steering_lag"]
    stated = {name.removeprefix("tyre."): float(p.value) for name, p in parameters(loaded).items()}
    assert {name: stated[name] for name in TYRES} == TYRES
    assert {name: stated[f"board.{name}"] for name in (*DART, *TRUE)} == {**DART, **TRUE}
    assert stated["effects.steering_lag.tau"] == 0.1


@pytest.mark.slow
def test_a_run_in_motion_is_swept_from_its_velocities(car: Path, tmp_path: Path, capsys) -> None:
    """It ends where the simulation of the run ends; without velocities the sweep says what it needs."""
    values = ",".join(f"{name}={value}" for name, value in TYRES.items())
    model = ["--set", values, "--with", "steering_lag:tau=0.1", "--run", "held-1", "--quiet"]
    swept, vary = tmp_path / "swept.json", ["--vary", "front.D=6:7:2"]
    assert main(["sweep", str(car), *model, *vary]) == 2
    assert "give the velocities too: --start X,Y,HEADING,U,W,R" in " ".join(capsys.readouterr().err.split())
    start = ["--start", "0.3,0.1,0.2,1.0,0.1,0.3"]
    assert main(["sweep", str(car), *model, *vary, *start, "--json", str(swept)]) == 0
    end = [column[0] for column in json.loads(swept.read_text())["end"].values()]
    case = sj.load_case(car)
    measured = np.asarray(next(run.pose for run in case.runs if run.name == "held-1"))[-1]
    np.testing.assert_allclose(end, measured, atol=3e-3)


@pytest.mark.slow
def test_saved_models_of_a_car_are_judged_by_what_they_predict(car: Path, tmp_path: Path) -> None:
    """The true model is off by a few times the noise; a file of `simulate` holds one model: base and final are it."""
    values = ",".join(f"{name}={value}" for name, value in TYRES.items())
    saved, where = tmp_path / "simulated.json", tmp_path / "predicted.json"
    options = ["--set", values, "--effect", "steering_lag:tau=0.1", "--json", str(saved), "--quiet"]
    assert main(["simulate", str(car), *options]) == 0
    words = ["--horizon", "1,2", "--lead", "0.6", "--json", str(where), "--out", str(tmp_path), "--quiet"]
    assert main(["predict", str(car), "--from", str(saved), *words]) == 0
    result = json.loads(where.read_text())
    assert deviations("predict", result) == []
    assert list(result["groups"]) == ["train", "heldout"] and result["lead_s"] == 0.6
    for models in result["groups"].values():
        assert models["base"] == models["final"] and list(models["final"]) == ["1", "2"]
        assert models["final"]["1"]["windows"] >= 3
        assert models["final"]["1"]["position_m"] < 0.01 and models["final"]["1"]["heading_rad"] < 0.01
    assert (tmp_path / "predict-errors.png").exists()
    table = predict(car, saved, (1.0,), 0.6).columns()
    assert table["position_m"][0] == result["groups"]["train"]["base"]["1"]["position_m"]


@pytest.mark.slow
def test_a_prediction_that_cannot_be_made_is_one_line(car: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["predict", str(car), "--from", str(tmp_path / "none.json")]) == 2
    assert "Cannot read the saved fit" in capsys.readouterr().err
    (tmp_path / "list.json").write_text("[]")
    assert main(["predict", str(car), "--from", str(tmp_path / "list.json")]) == 2
    assert "does not hold a fit" in capsys.readouterr().err
    assert main(["predict", str(car), "--from", str(tmp_path / "list.json"), "--lead", "soon"]) == 2
    assert "option --lead" in capsys.readouterr().err


def test_a_gain_beside_a_constant_to_be_estimated_is_refused(car: Path) -> None:
    vehicle = Car(**DART, **TRUE, unknown=("steering_ratio",))
    model = Model(vehicle, Pacejka(6.0, 1.4, 6.0, 0.1), "ideal")
    assert "is estimated" in (library(vehicle)["steering_gain"]().inapplicable_because(model) or "")
    assert library(vehicle)["drive_gain"]().inapplicable_because(model) is None
    assert "do not slip" in (library(vehicle)["load_transfer"]().inapplicable_because(model) or "")


def test_a_plan_leaves_the_result_of_an_explanation_as_it_is(car: Path, tmp_path: Path) -> None:
    (tmp_path / "explain.json").write_text("a result of minutes")
    assert main(["explain", str(car), "--plan", "--out", str(tmp_path), "--quiet"]) == 0
    assert (tmp_path / "explain.json").read_text() == "a result of minutes"
    assert "candidates" in json.loads((tmp_path / "plan.json").read_text())


def test_a_plan_names_the_windows_that_a_first_look_takes(capsys: pytest.CaptureFixture) -> None:
    taken = {}
    for words in ((), ("--quick",)):
        assert main(["explain", str(DATA / "car"), "--plan", *words, "--json", "-", "--quiet"]) == 0
        taken[words] = json.loads(capsys.readouterr().out)["train"]
    assert set(taken["--quick",]) < set(taken[()])
    assert len(taken["--quick",]) <= len(taken[()]) / 5


def test_the_result_is_told_before_it_is_drawn(
    car: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def fails(path: Path, text: str) -> None:
        raise RuntimeError("no room on the disk")

    monkeypatch.setattr("snakejax.core.files.write_whole", fails)
    assert main(["explain", str(car), "--plan", "--out", str(tmp_path), "--quiet"]) == 1
    assert main(["explain", str(car), "--plan", "--out", str(tmp_path)]) == 1
    assert "steering_lag" in capsys.readouterr().out


def test_the_options_of_a_car_are_those_of_its_vehicle(car: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["fit", str(car), "--skid", "coupled"]) == 2
    assert "A car has no structure `coupled`, option --skid" in capsys.readouterr().err
    for skid, free in (("free", ["tyre.front.B"]), ("ideal", [])):
        words = ["--skid", skid, "--with", "steering_lag:tau=0.1", *(["--free", "front.B"] if free else [])]
        assert main(["explain", str(car), "--plan", *words, "--json", "-", "--quiet"]) == 0
        plan = json.loads(capsys.readouterr().out)
        assert plan["structures"] == ([skid] if skid == "free" else ["ideal", "free"])
        assert plan["free"] == free
        assert "steering_lag" not in plan["candidates"] and "drive_lag" in plan["candidates"]
    assert main(["explain", str(car), "--plan", "--with", "rotor_lag"]) == 2
    assert "There is no effect `rotor_lag`" in capsys.readouterr().err


def test_what_a_gait_of_a_car_needs(car: Path, capsys: pytest.CaptureFixture) -> None:
    """Its recorded commands jump, so they set no limits; runs that tell effects apart are those of a snakeboard."""
    with pytest.raises(sj.InputError, match="Nothing limits `steer`"):
        sj.tune(Model(Car(**DART), Pacejka(6.0, 1.4, 6.0, 0.1), "free"), seconds=2)
    values = ",".join(f"{name}={value}" for name, value in TYRES.items())
    tune = ["tune", str(car), "--objective", "distance", "--seconds", "2", "--set", values]
    assert main([*tune, "--limit", "steer=0.5"]) == 2
    assert "Nothing limits `drive`" in capsys.readouterr().err
    assert main([*tune, "--limit", "phi=0.5"]) == 2
    assert "There is no limit `phi`" in capsys.readouterr().err
    assert main(["design", str(car), "--objective", "information"]) == 2
    assert "designed for a snakeboard, but the vehicle is a car" in capsys.readouterr().err
