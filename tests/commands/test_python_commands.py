"""The commands as functions: a case or its folder in, the options of the command line, the same result."""

import inspect
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.command_inputs import TRAIN_CASE
from helpers.folders import DATA

import snakejax as sj
from snakejax.commands.cli import main
from snakejax.commands.cli.main import parser
from snakejax.effects import GroundSlope

LEVEL = DATA / "level-board"
GIVEN = {"free": "B,D", "set": {"C": 1.5, "E": -0.12}}
WORDS = ["--free", "B,D", "--set", "C=1.5,E=-0.12"]


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small case: four seconds of one run, in which the cameras followed another body for 30 frames."""
    folder = tmp_path_factory.mktemp("cases") / "short-board"
    folder.mkdir()
    (folder / "case.toml").write_text(TRAIN_CASE, encoding="utf-8")
    lines = (LEVEL / "train-forward-1.csv").read_bytes().decode().split("\r\n")
    for row in range(200, 230):
        cells = lines[row].split(",")
        lines[row] = ",".join([*cells[:5], str(float(cells[5]) + 700), *cells[6:]])
    (folder / "train-forward-1.csv").write_bytes("\r\n".join(lines).encode())
    return folder


@pytest.fixture(scope="module")
def fitted(short: Path) -> sj.Fit:
    """What `sj.fit` finds in the small case, by its folder."""
    with pytest.warns(UserWarning, match=r"short-board: run train-forward-1: .*: masked"):
        return sj.fit(str(short), **GIVEN)


@pytest.mark.slow
def test_a_fit_in_python_is_that_of_the_command(short: Path, fitted: sj.Fit, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    assert main(["fit", str(short), *WORDS, "--json", str(path), "--quiet"]) == 0
    written = json.loads(path.read_text())
    assert written["quality"]["masked"] == {"train-forward-1": 30}
    for name in "BD":
        assert fitted.estimates[f"tyre.{name}"].value == written["base"]["parameters"][name]["value"]
    assert int(np.isnan(fitted.recordings[0].pose[:, 0]).sum()) >= 30
    assert fitted.train_score.misfit == written["base"]["misfit"]["train"]


@pytest.mark.slow
def test_a_case_without_noise_is_fitted_by_the_estimated_one(short: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(short, tmp_path / "short-board")
    text = TRAIN_CASE.replace("[noise]\nposition_m = 0.0004\nheading_rad = 0.0025\n", "")
    (folder / "case.toml").write_text(text, encoding="utf-8")
    with pytest.warns(UserWarning):
        found = sj.fit(sj.load_case(folder), **GIVEN)
    assert 0.5 < found.train_score.misfit < 2


@pytest.mark.slow
def test_compare_takes_a_fit_or_a_case(short: Path, fitted: sj.Fit) -> None:
    compared = sj.compare(fitted)
    with pytest.warns(UserWarning):
        again = sj.compare(short, **GIVEN)
    assert compared.columns() == again.columns()


@pytest.mark.slow
def test_diagnose_and_explain_work_with_the_options_of_a_fit(short: Path) -> None:
    few = [name for name in sj.effects.LIBRARY if name not in ("body_drag", "yaw_bias")]
    model = dict(without=few, with_="ground_slope:sx=0.0", robust=True, **GIVEN)
    with pytest.warns(UserWarning):
        ranked = sj.diagnose(short, **model)
    assert set(ranked.base.estimates) == {"tyre.B", "tyre.D", "effects.ground_slope.sy"}
    assert {row.effect for row in ranked.base.ranking} <= {"body_drag", "yaw_bias"}
    with pytest.warns(UserWarning):
        found = sj.explain(short, **model)
    assert "effects.ground_slope.sx" not in found.base.estimates and "effects.ground_slope.sy" in found.base.estimates
    assert (found.verdict, found.effects, found.base.effects) == ("explained", ("ground_slope",), ("ground_slope",))
    assert len(found.steps) == 1


@pytest.fixture
def few_guesses(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gait is looked for from one start, in two steps."""
    from snakejax.design import gait_problem, tuning

    monkeypatch.setattr(gait_problem, "GUESSES", 12)
    for name, value in (("STARTS", 1), ("MOST", 2)):
        monkeypatch.setattr(tuning, name, value)


@pytest.mark.slow
def test_tune_works_on_a_case(short: Path, few_guesses: None) -> None:
    values = "B=7.6,C=1.5,D=8.5,E=-0.1"
    with pytest.warns(UserWarning):
        of_case = sj.tune(short, "distance", seconds=2, set=values)
    assert of_case.after.result >= of_case.before.result > 0 and of_case.seconds == 2


@pytest.mark.long
def test_tune_works_on_a_model(few_guesses: None) -> None:
    limit = {"phi": 0.9, "psi": 1.6, "phi_rate": 4.0, "psi_rate": 6.5}
    of_model = sj.tune(sj.preset("paper-forward").model, "turn", seconds=2, limit=limit)
    assert of_model.limits["phi"].angle == 0.9 and of_model.after.result > 0


@pytest.mark.long
def test_tune_works_on_a_preset(few_guesses: None) -> None:
    assert sj.tune("paper-forward", seconds=2).after.result > 0


@pytest.mark.parametrize("name", ["fit", "compare", "diagnose", "explain", "tune"])
def test_arguments_are_the_options_in_their_order(name: str) -> None:
    """Those that Python has, less what only a terminal needs."""
    (choices,) = (action.choices for action in parser()._actions if isinstance(action.choices, dict))
    shown = [a for group in choices[name]._action_groups for a in group._group_actions if "SUPPRESS" not in str(a.help)]
    options = [action.option_strings[-1].lstrip("-").replace("-", "_") for action in shown if action.option_strings]
    arguments = list(inspect.signature(getattr(sj, name)).parameters)
    assert arguments[0] == "case"
    plain = [argument.rstrip("_") for argument in arguments[1:]]
    assert set(plain) <= {*options, "progress"}
    apart = ("as_recorded", "quick", "seed", "objective")
    ordered = [option for option in options if option in plain and option not in apart]
    assert ordered == [a for a in plain if a not in (*apart, "progress")]


def test_an_unknown_argument_is_refused() -> None:
    with pytest.raises(TypeError, match=r'fit\(\) has no argument `fre`: write "free"'):
        sj.fit(LEVEL, fre="B")  # type: ignore[call-arg]


def test_a_case_and_what_was_found_in_it_print_in_a_line_each(short: Path) -> None:
    sj.prepare_jax()
    case = sj.load_case(short)
    line = "Case short-board: Board, free; 1 train run and 0 held-out runs"
    assert repr(case) == line
    head, *findings = repr(sj.inspect(case)).splitlines()
    assert head == f"{line}; {len(findings)} finding{'s' * (len(findings) != 1)}" and "train-forward-1: " in findings[0]


def test_check_takes_a_folder_or_a_case(short: Path) -> None:
    issues = sj.check(short)
    assert issues and issues == sj.check(sj.load_case(short), short)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: sj.fit("nowhere"), "There is no such folder"),
        (lambda: sj.fit(sj.preset("paper-forward").model), "A case is needed, but this is a Model"),
        (lambda: sj.fit(LEVEL, model="pacejca"), 'option --model: write "pacejka"'),
        (lambda: sj.fit(LEVEL, with_=[GroundSlope, "ground_slope"]), "given twice"),
        (lambda: sj.explain(LEVEL, model="ideal"), "cannot start from the model `ideal`"),
        (lambda: sj.explain(LEVEL, free="board.mass"), "not one of the parameters that the base can estimate"),
        (lambda: sj.diagnose(LEVEL, effect="body_drag:c=1"), "The candidate `body_drag` is estimated"),
        (lambda: sj.diagnose(LEVEL, without=["body_drg"]), 'option --without: write "body_drag"'),
        (lambda: sj.tune(LEVEL, "far"), "There is no objective `far`"),
        (lambda: sj.tune(sj.preset("paper-forward").model, limit="phi=1,psi=1"), "give the seconds of the run"),
    ],
)
def test_what_cannot_be_done_is_one_line(call, expected: str) -> None:
    with pytest.raises(sj.InputError) as told:
        call()
    assert expected in str(told.value) and "\n" not in str(told.value)


def test_a_class_and_an_effect_are_put_into_the_model() -> None:
    from snakejax.commands.requested_model import requested_model

    case = sj.load_case(LEVEL)
    by_class = requested_model(case, {"with_": GroundSlope})
    assert "effects.ground_slope.sx" in by_class.free
    started = requested_model(case, {"with_": {"slope": GroundSlope(sx=0.01, sy=0.0)}})
    assert float(started.model.effects["slope"].sx) == 0.01 and "effects.slope.sx" in started.free
    fixed = requested_model(case, {"with_": "ground_slope:sx=0.01"})
    assert fixed.free[-1] == "effects.ground_slope.sy"
