"""Tuning and designing by the command line, on a case whose first run carries a payload."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.payload_case import PAYLOAD, TYRE, laden, written

from snakejax import Gait, Model, Sines, Tracked, effects, load_case, prior_information, simulate
from snakejax.commands import gaits as command
from snakejax.commands.cli import gait_options, main
from snakejax.commands.named_effects import effect_class
from snakejax.commands.option_texts import effect_spec
from snakejax.core.errors import InputError
from snakejax.core.parameter import with_parameters
from snakejax.design import experiments as discriminate
from snakejax.design import gait_problem as task
from snakejax.design import tuning
from snakejax.design.discrimination import correct_selection_probability, information
from snakejax.effects import BodyDrag
from snakejax.estimation import fit
from snakejax.estimation.initial_model import starting_tyre

SECONDS = 1.5
TYRE_GIVEN = ["--set", ",".join(f"{name}={value}" for name, value in TYRE.items())]
OWN = ["--effect", "{spring}:CableSpring:x0=1"]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return written(tmp_path_factory.mktemp("laden") / "heavy-board")


@pytest.fixture
def told(case, tmp_path, monkeypatch, capsys):
    """Tune by the command line, few guesses and short descents: its JSON, page and text."""
    monkeypatch.setattr(task, "GUESSES", 12)
    monkeypatch.setattr(command, "DRAWS", 3)
    for name, value in (("STARTS", 1), ("MOST", 2)):
        monkeypatch.setattr(discriminate, name, value)
        monkeypatch.setattr(tuning, name, value)

    def run(*options):
        options = [option.format(spring=case.parent / "spring.py", cost=case.parent / "cost.py") for option in options]
        asked = ["tune", str(case), "--seconds", str(SECONDS), "--out", str(tmp_path)]
        assert main([*asked, *options]) == 0
        found = json.loads((tmp_path / "tune.json").read_text())
        page, gait = (tmp_path / "tune.html").read_text(), (tmp_path / "tune-gait.toml").read_text()
        assert f"phi = {found['gait']['phi']}" in gait and (tmp_path / "tune.png").stat().st_size > 10_000
        return found, page, capsys.readouterr().out

    return run


def run_of(found, model):
    """The poses of a told gait on `model`, simulated anew."""
    gait = Gait(*(Tracked(Sines.of(found["gait"][joint]), 100.0, 10.0) for joint in ("phi", "psi")))
    return np.asarray(simulate(model, gait, jnp.linspace(0.0, SECONDS, 151)).pose)


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "payload", "said"),
    [
        (["--json", "-"], PAYLOAD, None),
        ([], PAYLOAD, "carrying 2 kg and 0.05 kg m^2 as in one"),
        (["--payload", "3,0.1"], (3.0, 0.1), "carrying 3 kg and 0.1 kg m^2"),
    ],
)
def test_the_board_carries_what_the_first_run_does_or_what_is_asked(told, options, payload, said) -> None:
    """The end that is told is that of a board whose mass and inertia are those of board and payload together."""
    found, page, text = told(*TYRE_GIVEN, "--objective", "{cost}:left", *options)
    assert found["objective"] == pytest.approx(-run_of(found, laden(payload=payload))[-1, 1], abs=1e-6)
    assert found["payload"] == {"mass_kg": payload[0], "inertia_kgm2": payload[1]}
    assert f"carrying {payload[0]:g} kg and {payload[1]:g} kg m^2" in page
    assert json.loads(text) == found if said is None else said in " ".join(text.split())


@pytest.mark.slow
def test_a_payload_is_said_where_any_run_has_one(case) -> None:
    read = load_case(case)
    assert gait_options.design_payload((0.0, 0.0), read) == ((0.0, 0.0), ", carrying nothing")
    empty = eqx.tree_at(lambda c: c.runs[0].payload, read, jnp.zeros(2))
    assert gait_options.design_payload(None, empty) == ((0.0, 0.0), "")
    assert gait_options.payload_of("2") == (2.0, 0.0) and gait_options.payload_of(None) is None
    for text in ("1,2,3", "-1", "x"):
        with pytest.raises(InputError, match=r"payload|number"):
            gait_options.payload_of(text)


@pytest.mark.long
@pytest.mark.parametrize("over", ["mean", "worst"])
def test_a_gait_for_draws_from_the_fit_does_on_them_what_is_said(told, over) -> None:
    """Two seconds leave B and C open."""
    found, *_ = told("--over", over)
    assert found["over"] == over and len(found["spread"]) == 3 and np.ptp(found["spread"]) > 0
    assert min(found["spread"]) <= found["objective"] * 1.5 and found["before"]["objective"] > 0


@pytest.mark.long
def test_an_effect_of_ones_own_is_told_from_another_on_the_laden_board(told, case) -> None:
    """Against differences of simulations of a board whose mass and inertia are those of board and payload.

    The parameter with a value is held: only the other one has a strength.
    """
    found, page, _ = told("--model", "rayleigh", "--objective", "separate:cable_spring,body_drag", *OWN)
    part = found["separate"]
    assert set(part["strengths"]) == {"effects.cable_spring.k", "effects.body_drag.c"}
    assert part["before"] == pytest.approx(0.7, abs=0.01) and part["after"] == found["objective"] > part["before"]
    assert found["before"]["objective"] <= found["objective"] and "cable_spring" in page
    assert found["payload"] == dict(zip(("mass_kg", "inertia_kgm2"), PAYLOAD, strict=True))

    read = load_case(case)
    fitted = fit(Model(read.board, starting_tyre("rayleigh", read.board), "free"), read.runs, read.noise, ["tyre.k_s"])
    cable = effect_class(effect_spec(f"{case.parent / 'spring.py'}:CableSpring"))(x0=1.0)
    both = {"cable_spring": cable, "body_drag": BodyDrag()}
    known = prior_information(fitted, both, ["effects.cable_spring.x0"])
    pair = known.pair("cable_spring", "body_drag")
    base, k_s = laden(fitted.model.tyre).add(**both), float(fitted.model.tyre.k_s)
    steps = {"tyre.k_s": 0.01, "effects.cable_spring.k": 1e-3, "effects.body_drag.c": 1e-3}
    moved = {name: k_s * np.exp(step) if name == "tyre.k_s" else step for name, step in steps.items()}
    boards = [base, *(with_parameters(base, {name: value}) for name, value in moved.items())]
    poses = jnp.stack([jnp.asarray(run_of(found, board)) for board in boards])
    mine = np.asarray(information(poses, jnp.asarray([*steps.values()]), jnp.asarray(known.weight)))
    assert known.names == tuple(steps)
    assert part["after"] == pytest.approx(correct_selection_probability(known.G + mine, pair), abs=0.01)


@pytest.mark.long
def test_the_two_that_look_most_alike_are_found(told, monkeypatch) -> None:
    few = {name: effects.LIBRARY[name] for name in ("body_drag", "longitudinal_slip", "yaw_damping")}
    monkeypatch.setattr(effects, "LIBRARY", few)
    alike, *_ = told("--model", "rayleigh", "--objective", "separate")
    assert set(alike["separate"]["effects"]) < set(few) and alike["separate"]["after"] > alike["separate"]["before"]


@pytest.mark.long
def test_a_run_says_more_about_the_tyre(told) -> None:
    with_tighter_tolerances, *_ = told("--model", "rayleigh", "--objective", "information")
    sds = with_tighter_tolerances["information"]
    assert with_tighter_tolerances["objective"] == pytest.approx(
        sds["sd_after"]["tyre.k_s"] / sds["sd_before"]["tyre.k_s"]
    )
    assert with_tighter_tolerances["objective"] <= with_tighter_tolerances["before"]["objective"] < 1


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--objective", "separate:lateral_skid,body_drag"], "a change of structure"),
        (["--objective", "separate:cable_sprin,body_drag", *OWN], 'write "cable_spring"'),
        (["--objective", "separate:cable_spring,body_drag", *OWN, *OWN], "given twice"),
        (["--objective", "separate:cable_spring,body_drag", "--effect", OWN[1] + ",k=1"], "are fixed"),
        pytest.param(
            *(["--objective", "separate:cable_spring,body_drag", "--effect", OWN[1][:-5]], "do not show `x0`"),
            marks=pytest.mark.long,
        ),
    ],
)
def test_what_cannot_be_told_apart_is_said_in_one_line(case, options, why, capsys) -> None:
    options = [option.format(spring=case.parent / "spring.py") for option in options]
    assert main(["tune", str(case), "--model", "rayleigh", "--quiet", *options]) == 2
    said = capsys.readouterr().err
    assert why in said and said.count("\n") == 1 and "Traceback" not in said
