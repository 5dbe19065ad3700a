"""What the functions of the package return: plain data that shows itself in a few lines."""

import dataclasses
import re
from types import SimpleNamespace
from typing import Any, cast

import equinox as eqx
import numpy as np
import pytest
from helpers.made_up_explanation import story
from helpers.small_case import small

from snakejax import Diagnosis, DiscriminationDesign, Gait, Limits, Logged, PrecisionDesign, Sines, TuningResult
from snakejax.core.tabular import Tabular
from snakejax.design.experiments import Advice
from snakejax.design.tuning import GaitResult
from snakejax.diagnosis.residuals.comparison import compare
from snakejax.diagnosis.selection.candidates import CandidateSet
from snakejax.estimation.multiple_shooting import Windows
from snakejax.estimation.problem import Problem, Solution


def tuned(gait: Gait, before: Any = 1.0, after: Any = 2.5) -> TuningResult:
    """A gait that nobody tuned."""
    run = cast(Any, None)
    limits = Limits.of({"phi": 0.9, "psi": 1.6})
    sides = GaitResult(gait, before, run), GaitResult(gait, after, run)
    units = {"phi": "rad", "psi": "rad"}
    return TuningResult(*sides, [], limits, {}, 8.0, (0.0, 0.0, 0.0), False, 10, 5, units)


def sines() -> Gait:
    return Gait(Sines.of([[0.3, 4.0, 0.1]]), Sines.of([[1.0, 4.0, 0.0], [0.2, 8.0, 1.0]]))


def designed() -> DiscriminationDesign:
    advice = [Advice("with a payload", "here", 0.8)]
    ends = ({"effects.a.p": 1.0}, {"effects.a.p": 0.4})
    return DiscriminationDesign(tuned(sines()), ("a", "b"), ends[0], 0.7, 0.8, 0.93, ends, 2, (4.0, 5.0), advice)


def precise() -> PrecisionDesign:
    return PrecisionDesign(tuned(sines()), {"tyre.B": 0.2, "tyre.D": 0.8}, None, {"tyre.B": 0.1, "tyre.D": 0.1})


RESULTS = {
    "fit": lambda: small()[2],
    "comparison": lambda: compare(small()[2]),
    "step": lambda: story().final,
    "diagnosis": lambda: Diagnosis(story().case, story().noise, story().base),
    "explanation": story,
    "missing": lambda: story().missing,
    "tuning": lambda: tuned(sines()),
    "discrimination": designed,
    "precision": precise,
}
HEADLINES = {
    "fit": r"Fit: Pacejka, free, with pull; 0\.975 times the noise, 1\.03 held out; 1 train and 1 held-out run\n"
    r"D = 0\.\d+ \+- \d\S* N",
    "comparison": r"Comparison: only noise is left; worst in \S.* at \d\.\d\d s \(-?\d\.\d sd\)",
    "step": "SelectionStep: added rotor_gain; 2.65 times the noise, 3.08 held out; lateral_skid first of 7 candidates",
    "diagnosis": "Diagnosis: base; 205 times the noise, 361 held out; lateral_skid first of 7 candidates; "
    "1 train and 1 held-out run",
    "explanation": "Explanation: unexplained; 205 -> 2.65 times the noise; ground_slope and rotor_gain helped; "
    "1 train and 1 held-out run",
    "missing": r"LatentForce: 0\.0\d+ N along the body, 0 N m in yaw \(root mean square\); depends on "
    r"rotor_rate \(82%\), gait_phase \(56%\), world_position \(22%\)",
    "tuning": "TuningResult: 1 -> 2.5 in 8 s; the target is not reached",
    "discrimination": "DiscriminationDesign: a or b; probability of the right answer 0.70 -> 0.93 by a run of 8 s",
    "precision": r"PrecisionDesign: standard errors times 0.25 \(geometric mean\) by a run of 8 s",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_told_in_a_line_or_two(name) -> None:
    assert re.fullmatch(HEADLINES[name], repr(RESULTS[name]()))


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_a_table(name) -> None:
    found: Tabular = RESULTS[name]()
    columns = found.columns()
    assert len({len(column) for column in columns.values()}) == 1
    frame = found.to_dataframe()
    assert list(frame) == list(columns) and len(frame) > 0
    shown = found._repr_html_()
    assert shown.count("<th>") == len(columns) and shown.count("<td>") == min(frame.size, 40 * len(columns))


def test_the_tables_hold_the_numbers() -> None:
    found, told = small()[2], story()
    row = found.to_dataframe().set_index("parameter").loc["tyre.D"]
    estimate = found.estimates["tyre.D"]
    assert (row["value"], row["sd"], row["low_95"]) == (estimate.value, estimate.sd, estimate.interval()[0])
    steps = told.to_dataframe().set_index("step")
    assert steps.loc["added ground_slope", "times_noise_train"] == pytest.approx(np.sqrt(312.0))
    assert steps.loc["base", "position_m_heldout"] == told.base.heldout.position_m
    candidates = told.base.to_dataframe().set_index("effect")
    assert candidates.loc["quadratic_drag", "confusable_with"] == "longitudinal_slip, body_drag"
    gait = tuned(sines()).to_dataframe()
    assert gait.values.tolist() == [["phi", 0.3, 4.0, 0.1], ["psi", 1.0, 4.0, 0.0], ["psi", 0.2, 8.0, 1.0]]


def test_a_tuned_spline_is_a_table_of_its_knots() -> None:
    times = np.linspace(0.0, 1.0, 5)
    gait = Gait(Logged.of(times, 0.3 * np.sin(times)), Logged.of(times, np.cos(times)))
    table = tuned(gait).to_dataframe()
    assert np.allclose(table["phi_rad"], 0.3 * np.sin(times)) and np.allclose(table["psi_rad"], np.cos(times))


def test_an_explanation_that_ends_well_names_its_effects() -> None:
    told = repr(story(verdict="explained"))
    assert told.startswith("Explanation: explained by ground_slope and rotor_gain; 205 -> 2.65 times the noise;")
    one = dataclasses.replace(story(verdict="adequate"), steps=story().steps[:1], effects=())
    assert repr(one) == "Explanation: adequate; 205 times the noise; 1 train and 1 held-out run"


WORKSPACES = (Problem, Solution, CandidateSet, Windows)


def held_by(found: object) -> set[type]:
    """The types of all objects that `found` refers to, but for what belongs to classes, functions and modules."""
    seen, waiting, types = set(), [found], set()
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, type) or (callable(one) and not isinstance(one, eqx.Module)):
            continue
        seen.add(id(one))
        types.add(type(one))
        if not isinstance(one, str | bytes | int | float | np.ndarray) and type(one).__module__ != "builtins":
            waiting.extend(vars(one).values() if hasattr(one, "__dict__") else [])
        if isinstance(one, list | tuple | set):
            waiting.extend(one)
        if isinstance(one, dict):
            waiting.extend(one.values())
    return types


@pytest.mark.parametrize("name", RESULTS)
def test_no_workspace_is_inside(name) -> None:
    held = held_by(RESULTS[name]())
    assert not held & set(WORKSPACES)


def test_a_workspace_would_be_found() -> None:
    problem = Problem.of(small()[2].model, small()[0].runs, small()[1], (), 1)
    assert Problem in held_by(SimpleNamespace(parts=[{"inside": (problem,)}]))
