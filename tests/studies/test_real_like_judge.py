"""The judge of boards as real ones are: what counts as sure, true and first, and boards that are what they say."""

import dataclasses
import sys

import numpy as np
import pytest
from helpers.folders import ROOT
from scipy.stats import norm

sys.path.insert(0, str(ROOT / "benchmarks" / "real_like"))

from boards import KINDS, draw
from folders import key, measured, write
from judge import clear, score, wilson
from layout import TYRE
from odd import slope
from truth import DETECTABLE

import snakejax as sj

KEY = {
    "case": "real_like-00",
    "kind": "real_like",
    "strong": "yaw_friction",
    "strange": "spring",
    "odd": {},
    "effects": {"yaw_friction": {"t": 0.008}, "grip_split": {"s": 0.02}},
    "off": {"m": 0.03, "I": 0.0, "Jr": -0.05, "L": 0.0},
    "noise": {"white": [3e-4, 1e-3], "wander": [4e-4, 0.0]},
}
TRUTH = {
    "heldout": {"position_m": 5e-4, "heading_rad": 1e-3},
    "sd": {"yaw_friction.t": 1e-4, "grip_split.s": 0.01},
}


def result(named: list[str], **final) -> dict:
    """What the program writes, as far as the judge reads it."""
    return {"effects": named, "verdict": "explained", "ranking": [], "seconds": {"total": 1.0}, "final": final}


def test_sure_is_what_the_program_calls_so_and_everything_where_it_says_nothing():
    """With `confidence` only what is sure; the first is what has the largest share."""
    plain = score(result(["rotor_gain", "yaw_friction"]), KEY, None)
    assert plain["sure"] == ["rotor_gain", "yaw_friction"]
    assert plain["first"] == "rotor_gain" and not plain["strong_first"]
    said = {"rotor_gain": "stand_in", "yaw_friction": "sure", "yaw_bias": "likely"}
    careful = score(
        result(list(said), confidence=said, share={"rotor_gain": 0.1, "yaw_friction": 0.8, "yaw_bias": 0.05}), KEY, None
    )
    assert careful["sure"] == ["yaw_friction"] and careful["strong_first"]
    assert careful["false_sure"] == [] and careful["absent"] == ["yaw_bias"]


@pytest.mark.parametrize(
    ("claim", "false"),
    [("rotor_gain", True), ("rotor_inertia", False), ("mass", False), ("half_length", True), ("law_1", False)],
)
def test_a_wrong_constant_makes_no_effect_true_that_works_like_it(claim, false):
    """The rotor's inertia is off by 5 % and the mass by 3 %, the length is not, and there is a strange force."""
    assert bool(score(result([claim]), KEY, None)["false_sure"]) is false


def test_interval_held_out_ratio_and_what_is_detectable():
    """By hand: 2.5 sd away, twice the error, and an effect of two standard errors, which nobody could find."""
    estimate = {"yaw_friction": {"t": {"value": 0.008 + 2.5e-4, "sd": 1e-4}}}
    rmse = {"heldout": {"position_m": 1e-3, "heading_rad": 2e-3}}
    row = score(result(["yaw_friction"], effects=estimate, rmse=rmse), KEY, TRUTH)
    assert row["holds"] == {"t": False}
    estimate["yaw_friction"]["t"]["interval"] = [0.007, 0.009]
    assert score(result(["yaw_friction"], effects=estimate), KEY, TRUTH)["holds"] == {"t": True}
    assert row["ratio"] == pytest.approx(2.0) and row["known_ratio"] is None
    known = {"known": {"position_m": 1e-3, "heading_rad": 1e-3}, "informed": {"position_m": 5e-4, "heading_rad": 0.0}}
    row |= score(result(["yaw_friction"], effects=estimate, rmse=rmse), KEY, TRUTH | known)
    assert row["known_ratio"] == pytest.approx(np.sqrt(8 / 5)) and row["informed_ratio"] > row["ratio"]
    assert row["detectable"] == row["detected"] == ["yaw_friction"]
    assert pytest.approx(norm.ppf(1 - 0.05 / 48) + norm.ppf(0.8), abs=5e-3) == DETECTABLE
    gain = {"effects": {"rotor_gain": {"g": 0.1}}}, {"sd": {"rotor_gain.g": 1e-4}}
    # 0.1 over the 0.07 to which the inertia is known that does the same.
    assert clear("rotor_gain", *gain) == pytest.approx(0.1 / 0.07, rel=1e-4)
    low, high = wilson(57, 60)
    for bound in (low, high):  # where the normal test of that share is just at 5 %
        assert abs(57 / 60 - bound) == pytest.approx(1.959964 * np.sqrt(bound * (1 - bound) / 60))


@pytest.mark.slow
def test_a_board_is_read_back_as_it_was_made(tmp_path):
    """The same poses to the last digit written, the stated mass, and nothing in the case of what is hidden."""
    board = draw("wrong_mass", "dev", 0)
    folder = write(board, "dev", tmp_path / "cases", tmp_path / "keys")
    case = sj.load_case(folder)
    assert abs(board.values["m"] / 7.0 - 1) == pytest.approx(0.05)
    assert float(case.board.mass) == 7.0
    assert {run.name: run.role for run in case.runs} == {run.name: run.role for run in board.runs}
    made = measured(board, "dev")
    for run in case.runs:
        off = np.asarray(run.pose) - made[run.name]
        off[:, 2] -= 2 * np.pi * np.round(off[0, 2] / (2 * np.pi))
        assert np.abs(off).max() < 6e-7
    assert sorted(path.suffix for path in folder.iterdir()) == [".csv"] * 7 + [".toml"]


@pytest.mark.slow
def test_boards_are_what_their_kind_says():
    """Effects and their number, and what is off; the sets and the numbers differ."""
    assert KINDS["real_like"] == 60
    several = key(draw("moderate", "dev", 1))
    assert 5 <= len(several["effects"]) <= 8 and not any(several["off"].values())
    longer = key(draw("wrong_length", "dev", 1))
    assert abs(longer["constants"]["L"] - 0.25) == pytest.approx(0.002)
    tyres = [key(draw("wandering", group, n))["tyre"]["B"] for group in ("dev", "final") for n in range(3)]
    assert len(set(tyres)) == 6


@pytest.mark.slow
def test_one_run_of_an_odd_board_is_off_by_five_standard_errors():
    """Beside the tyre and the start poses of all train runs, chi^2 of what it moves the path by is 25."""
    pytest.importorskip("numba", reason="numba, of the extra `bench`, is not here: without it this takes minutes.")
    board = draw("odd_tyre", "dev", 0)
    assert list(key(board)["odd"]) == ["train-arc-1"] and not key(board)["effects"]
    like_others = [dataclasses.replace(run, odd={}) for run in board.train]
    moved, columns = [], []
    for k, (run, other) in enumerate(zip(board.train, like_others, strict=True)):
        moved.append((run.path(board.values) - other.path(board.values))[:, :, None])
        starts = [other.moved(other.start + step).path(board.values) for step in np.diag([1e-5, 1e-5, 1e-5])]
        own = np.zeros((*moved[-1].shape[:2], 3 * len(board.train)))
        own[:, :, 3 * k : 3 * k + 3] = np.stack([(path - other.path(board.values)) / 1e-5 for path in starts], axis=2)
        tyre = np.stack([slope(other, board.values, name) for name in TYRE], axis=2)
        columns.append(np.concatenate([tyre, own], axis=2))
    whitened = [
        [
            board.noise.whiten(run.times, one).reshape(-1, one.shape[2])
            for run, one in zip(board.train, part, strict=True)
        ]
        for part in (moved, columns)
    ]
    r, C = (np.concatenate(part) for part in whitened)
    left = r - C @ np.linalg.lstsq(C, r, rcond=None)[0]
    assert float((left**2).sum()) == pytest.approx(25.0, rel=0.02)


@pytest.mark.slow
def test_a_real_like_board_has_one_strong_effect_three_weak_ones_and_a_strange_one():
    """And constants off by no more than is said."""
    pytest.importorskip("numba", reason="numba, of the extra `bench`, is not here: without it this takes minutes.")
    for kind, strong in (("real_like", True), ("real_like_null", False)):
        hidden = key(draw(kind, "dev", 3))
        assert bool(hidden["strong"]) is strong and len(hidden["weak"]) == 3 and hidden["strange"]
        assert all(
            0 < abs(hidden["off"][n]) <= most for n, most in {"m": 0.04, "L": 0.004, "I": 0.06, "Jr": 0.1}.items()
        )
