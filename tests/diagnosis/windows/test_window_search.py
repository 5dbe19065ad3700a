"""Explaining windows of a car that wanders: the effect that is there is found, and no other one is claimed."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.wandering_car import CONSTANTS, NOISE, TYRE, windows
from scipy import stats

from snakejax.diagnosis.inexact.left_out import Gain
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.diagnosis.windows import explaining
from snakejax.diagnosis.windows import search as search_module
from snakejax.diagnosis.windows.explaining import (
    FEWEST_RECORDINGS,
    MOST_RECORDINGS,
    explain_windows,
    recordings_of,
    supports,
)
from snakejax.diagnosis.windows.search import Candidate, SearchState, _p_value
from snakejax.dynamics.model import Model
from snakejax.effects import library
from snakejax.estimation.window_fit import WindowColumns, scale_of, weights_of
from snakejax.vehicles.car import DART, Car

OFFERED = ("steering_asymmetry", "rolling_resistance", "yaw_damping", "ground_slope", "load_transfer")
ASYMMETRY = -0.15


def offered(names: tuple[str, ...]) -> dict:
    kinds = library(Car(**DART))
    return {name: kinds[name]() for name in names}


@pytest.mark.long
def test_the_tyre_and_the_asymmetry_of_a_wandering_car_are_found_and_nothing_else() -> None:
    effect = offered(OFFERED)["steering_asymmetry"]
    truth = Model(Car(**DART, **CONSTANTS, creep_speed=0.1), TYRE, "free").add(
        steering_asymmetry=type(effect)(a=ASYMMETRY)
    )
    case = windows(truth, recordings=6, heldout=2, seed=3)
    assert supports(case)
    found = explain_windows(case, NOISE, offered(OFFERED))
    assert [step.name for step in found.steps] == ["", "lateral_skid", "steering_asymmetry"]
    estimate = found.final.estimates_of("steering_asymmetry")["a"]
    assert estimate.sd is not None and abs(estimate.value - ASYMMETRY) < 3 * estimate.sd
    assert estimate.sd < 0.2 * abs(ASYMMETRY)
    heldout = [step.heldout for step in found.steps]
    assert heldout[-1] is not None and heldout[0] is not None
    assert heldout[-1].position_m < 0.5 * heldout[0].position_m
    assert sum(row.taken for row in found.candidates) == 1
    assert found.explained_share is not None and found.explained_share > 0.5


@pytest.mark.parametrize(
    ("better", "path"),
    [
        ({("base", "slips")}, [(0, "base"), (1, "slips"), (1, "slips, a")]),
        ({("base, b", "slips, a")}, [(0, "base"), (1, "slips"), (1, "slips, a")]),
        (set(), [(0, "base"), (0, "base, b")]),
    ],
)
def test_a_structure_is_taken_alone_or_for_the_effects_that_it_lets_act(
    monkeypatch: pytest.MonkeyPatch, better: set, path: list
) -> None:
    """`better`: from which model to which recordings left out gain. Else the effects of the base remain."""

    def state(name: str) -> SimpleNamespace:
        return SimpleNamespace(linear=name)

    further = {"base": "base, b", "slips": "slips, a"}
    monkeypatch.setattr(explaining, "further_states", lambda _, first: [state(further[first.linear])])
    monkeypatch.setattr(
        explaining, "left_out_gain", lambda old, new: SimpleNamespace(exceeds_standard_error=(old, new) in better)
    )
    question: Any = SimpleNamespace(
        sets=(0, 1), searches=(None, None), first=lambda number: state("slips" if number else "base")
    )
    states, switches = explaining._path(question)
    assert [(number, one.linear) for number, one in states] == path
    assert switches is bool(better)


def test_an_effect_that_a_later_one_makes_idle_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """`a` and `c` gain nothing beside `b`, and `c` gains less: `c` goes first, then `a` predicts and stays."""

    def candidate(linear: SimpleNamespace, effect: str) -> SimpleNamespace:
        idle = {"a": {"b", "c"}, "b": set(), "c": {"b"}}[effect]
        predicts = not (idle and idle <= set(linear.effects))
        gain = SimpleNamespace(by_part=np.array([{"a": 0.2, "b": 5.0, "c": 0.1}[effect]]))
        return SimpleNamespace(effect=effect, gain=gain, predicts=lambda criteria: predicts)

    def state(_: object, point: object, effects: tuple[str, ...]) -> SearchState:
        linear: Any = SimpleNamespace(effects=effects, point=None)
        return SearchState(linear, ())

    monkeypatch.setattr(search_module, "_state", state)
    search: Any = SimpleNamespace(candidate=candidate, criteria=None, fitted=lambda point, effects: None)
    states = search_module._without_idle_effects(search, state(None, None, ("a", "c", "b")))
    assert [(one.dropped, one.effects) for one in states] == [("c", ("a", "b"))]


@pytest.mark.parametrize(
    ("by_part", "share", "p_value", "at_bound", "taken"),
    [
        ([2.0, 3.0, 2.5], 0.06, 0.049, False, True),
        ([2.0, 3.0, 2.5], 0.06, 0.051, False, False),  # the 95% interval holds the neutral value
        ([2.0, 3.0, 2.5], 0.04, 0.001, False, False),  # too small to matter
        ([9.0, -8.0, 1.0], 0.06, 0.001, False, False),  # the recordings differ by more than they gain
        ([2.0, 3.0, 2.5], 0.06, 0.001, True, False),
    ],
)
def test_what_an_effect_must_do_to_be_added(by_part, share, p_value, at_bound, taken) -> None:
    candidate = Candidate("a", Gain(np.array(by_part), share), p_value, (1.0,), np.ones(1), at_bound)
    assert candidate.predicts(CRITERIA) == taken


def test_start_states_are_projected_out_as_least_squares_does() -> None:
    rng = np.random.default_rng(0)
    residual, by_values, by_start = rng.normal(size=(4, 30)), rng.normal(size=(4, 30, 3)), rng.normal(size=(4, 30, 6))
    by_start[2, :, 4] = 0.0
    left, columns = WindowColumns(residual, by_values, by_start, np.full(4, 30.0)).without_starts
    for w in range(4):
        fitted = np.linalg.lstsq(by_start[w], np.column_stack([residual[w], by_values[w]]), rcond=None)[0]
        expected = np.column_stack([residual[w], by_values[w]]) - by_start[w] @ fitted
        np.testing.assert_allclose(np.column_stack([left[w], columns[w]]), expected, atol=1e-12)


def test_a_window_far_off_has_no_weight() -> None:
    square = np.array([1.0, 1.2, 0.8, 1.1, 1e6])
    weight = weights_of(square, scale_of(square))
    assert weight[:4].min() > 0.9 and weight[4] < 1e-4


def test_p_values_of_agreeing_recordings_are_uniform_where_nothing_is_there() -> None:
    rng, found = np.random.default_rng(5), []
    F, k = 9, 2
    for _ in range(2000):
        each = rng.normal(size=(F, k)) @ np.array([[1.0, 0.6], [0.0, 0.5]])
        others = np.array([np.delete(each, f, axis=0).mean(axis=0) for f in range(F)])
        off = others - others.mean(axis=0)
        found.append(_p_value(each.mean(axis=0), (F - 1) / F * off.T @ off, F))
    assert stats.kstest(found, "uniform").pvalue > 0.001


def test_few_recordings_are_left_out_in_parts() -> None:
    many = recordings_of([f"run{k % FEWEST_RECORDINGS}" for k in range(12)])
    assert np.unique(many).size == FEWEST_RECORDINGS
    single = recordings_of(["one"] * 9)
    assert single.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert np.unique(recordings_of([f"run{k:03}" for k in range(100)])).size == MOST_RECORDINGS
