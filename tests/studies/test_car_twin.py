"""The made-up car of benchmarks/car_twin.py, whose plant shares no code with the program, against the program."""

import sys
from collections import OrderedDict

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import ROOT

from snakejax import Model, Pacejka, simulate
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.sampled_signals import Held
from snakejax.effects import library
from snakejax.vehicles.car import DART, Car

sys.path.insert(0, str(ROOT / "benchmarks"))

import car_twin


def twin_model(p: dict[str, float]) -> Model:
    """The program's model with the numbers of a twin."""
    constants = {name: p[letter] for name, letter in car_twin.CONSTANTS.items()}
    board = Car(**DART | {"inertia": p["I"]}, **constants, creep_speed=car_twin.CREEP)
    tyres = FrontRear(Pacejka(p["B_f"], p["C_f"], p["D_f"], 0.0), Pacejka(p["B_r"], p["C_r"], p["D_r"], 0.0))
    effects = library(board)
    added = {"steering_asymmetry": effects["steering_asymmetry"](a=p["a"])}
    if p["T"]:
        added["steering_lag"] = effects["steering_lag"](tau=p["T"])
    return Model(board, tyres, "free", added)


@pytest.mark.parametrize("number", [0, 1])
def test_plant_and_program_move_alike(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Without disturbances, with and without a lag of the steering: 4 s of changing commands within 0.1 mm."""
    monkeypatch.setattr(car_twin, "YAW", 0.0)
    monkeypatch.setattr(car_twin, "SPEED", 0.0)
    monkeypatch.setattr(car_twin, "STEP", 0.001)
    p = car_twin.draw(number)
    at = np.arange(0.0, 4.0, 0.5)
    throttle, steering = np.tile([0.35, 0.5, 0.3, 0.42], 2), np.array([0.0, 0.4, -0.7, 0.2, 0.8, -0.3, 0.0, 0.5])
    times, poses = car_twin.driven(p, at, throttle, steering, 4.0, np.random.default_rng(0))
    gait = Inputs(OrderedDict(steer=Held.of(at, steering), drive=Held.of(at, throttle)))
    own = simulate(twin_model(p), gait, jnp.asarray(times), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert np.ptp(poses[:, :2], axis=0).max() > 1.0
    np.testing.assert_allclose(np.asarray(own.pose), poses, rtol=0, atol=1e-4)


def test_a_result_is_scored_as_by_hand() -> None:
    """One effect named, one that stands behind its twin, one absent one called sure; one interval of two off."""
    p = car_twin.draw(1)
    k = {"value": p["k"] + 0.01, "sd": 0.01}
    a = {"value": p["a"] + 0.03, "sd": 0.01}
    rmse = {"heldout": {"position_m": 0.1, "heading_rad": 0.1}}
    result = {
        "base": {"rmse": rmse},
        "effects": [],
        "final": {
            "effects": {"lateral_skid": {}, "steering_asymmetry": {"a": a}, "yaw_bias": {"t": k}},
            "confidence": {"lateral_skid": "sure", "steering_asymmetry": "ambiguous", "yaw_bias": "sure"},
            "constants": {"steering_ratio": k},
            "rmse": rmse,
        },
        "candidates": [{"effect": "clock_offset", "instead_of": ["yaw_bias"]}],
        "seconds": {"total": 1.0},
    }
    row = car_twin.score(1, result)
    assert row["true"] == row["hit"] == {"lateral_skid", "steering_asymmetry", "steering_lag"}
    assert row["absent sure"] == {"yaw_bias"}
    assert row["holds"] == {"steering_ratio": True, "steering_asymmetry.a": False}
    assert "1 of 2" in car_twin.table([row])
