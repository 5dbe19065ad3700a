"""The command line: what it says, what it writes, and how it ends."""

import io
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from helpers.command_inputs import SHORT_CASE, WORLD_SPRING
from helpers.folders import DATA
from helpers.schema import deviations
from rich.console import Console

import snakejax
from snakejax.commands.cli import main
from snakejax.commands.cli.main import parser, prepared
from snakejax.effects import LIBRARY
from snakejax.estimation.goodness_of_fit import RunScore
from snakejax.present.as_json.saved import saved_fit
from snakejax.present.as_text.fit import runs_table

LEVEL = DATA / "level-board"
LINE = re.compile(r"snakejax: error: [^\n]+, [^\n]+: [^\n]+\n")


class Said(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture(scope="session")
def compiled(pytestconfig: pytest.Config) -> Path:
    """Where these tests keep compiled programs, so that they leave the user's cache alone."""
    assert pytestconfig.cache is not None
    return pytestconfig.cache.mkdir("snakejax")


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, compiled: Path) -> Callable[..., Said]:
    """Run a command in this process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(compiled))

    def run(*arguments: Any) -> Said:
        status = main([str(argument) for argument in arguments])
        return Said(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small case: four seconds of two runs."""
    folder = tmp_path_factory.mktemp("cases") / "short-board"
    folder.mkdir()
    (folder / "case.toml").write_text(SHORT_CASE, encoding="utf-8")
    for name in ("train-forward-1.csv", "heldout-reverse-1.csv"):
        (folder / name).write_bytes((LEVEL / name).read_bytes())
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("fly",), "There is no command `fly`, argument COMMAND: remove it or write one that is known (known: check, "),
        (("comparre", LEVEL), 'There is no command `comparre`, argument COMMAND: write "compare"'),
        (("separate", LEVEL), 'There is no command `separate`, argument COMMAND: write "design"'),
        (("fit", LEVEL, "--skid", "fre"), '`fre` is not a value of --skid, option --skid: write "free" (known: free,'),
        (("fit", "nowhere"), "There is no such folder, nowhere: give the folder with case.toml"),
        (("fit", LEVEL, "--seed", "x"), "invalid int value"),
        (("fit", LEVEL, "--foo"), "--foo"),
        (("fit",), "`snakejax fit` was called without CASE, command line: write `snakejax fit CASE`"),
        (("fit", LEVEL, "-o", "out"), '`snakejax fit` has no option `-o`, command line: write "--out" (known: -h'),
        (("fit", LEVEL, "-x"), "has no option `-x`, command line: remove it or write one that is known (known: -h"),
        (("-v",), '`snakejax` has no option `-v`, command line: write "-V" (known: -h, --help, -V, --version)'),
        (("fit", "paper-rotate"), "is a preset without recordings"),
        (("fit", LEVEL, "--free", "Q"), "No parameter is called `Q`, option --free"),
        (("fit", LEVEL, "--with", "ground_slop"), 'option --with: write "ground_slope"'),
        (("fit", LEVEL, "--with", "ground_slope:q=1"), "no parameter `q`"),
        (("fit", LEVEL, "--effect", "rolling_resistance:f=-1"), "must be at least 0"),
        (("fit", LEVEL, "--with", "no.py:Spring"), "There is no file `no.py`"),
        (("fit", LEVEL, "--effect", "no.py"), "write no.py:Class"),
        (("fit", LEVEL, "--effect", "lateral_skid:x=1"), "has no parameters"),
        (("fit", LEVEL, "--effect", "com_offset", "--skid", "coupled"), "cannot act here"),
        (("fit", LEVEL, "--robust=-1"), "option --robust"),
        (("fit", LEVEL, "--bootstrap", "6"), "6 refits are too few for the ends of a 95% interval, option --bootstrap"),
        (("fit", LEVEL, "--bootstrap", "40", "--free=", "--quiet"), "No parameter is estimated, option --bootstrap"),
        (("fit", LEVEL, "--from", "no.json"), "Cannot read the saved fit"),
        (("fit", LEVEL, "--from", DATA / "README.md"), "is not JSON"),
        (("fit", LEVEL, LEVEL), "Two CASEs have the name `level-board`"),
        (("fit", LEVEL, DATA / "spring-board", "--json", "-"), "name a folder"),
        (("fit", LEVEL, "--json", LEVEL / "case.toml" / "x.json"), "Cannot write"),
        (("simulate", LEVEL, "--set", "B=6"), "C, D, E have no value, option --set"),
        (("simulate", LEVEL, "--set", "B"), "`B` is not NAME=NUMBER"),
        (("simulate", LEVEL, "--set", "B=1,B=2"), "given twice"),
        (("simulate", LEVEL, "--set", "B=six"), "does not contain a finite number"),
        (("simulate", LEVEL, "--set", "B=6,C=1.4,D=6,E=2"), "must be at most 1"),
        (("simulate", LEVEL, "--effect", "ground_slope"), "no value for `sx`"),
        (("simulate", LEVEL, "--load", "3"), "options --load and --camber"),
        (("simulate", "paper-rotat"), 'write "paper-rotate"'),
        (("simulate", "paper-rotate", "--load", "3"), "does not depend on load or camber"),
        (("simulate", "paper-gait1", "--load", "-3"), "The load -3 N is not above 0"),
        (("simulate", "paper-gait1", "--camber", "30"), "The camber 30 rad is out of range"),
        (("simulate", "paper-gait1", "--load", "60000"), "beyond Bakker's formulas: Pacejka.B must be above 0"),
        (("simulate", "paper-rotate", "--start", "1,2"), "`1,2` is not a pose"),
        (("simulate", "paper-rotate", "--set", "k_s=9"), "add --model rayleigh"),
        (("simulate", "paper-rotate", "--model", "rayleigh"), "k_s has no value"),
        (("new", DATA / "level-board"), "already exists"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(say, arguments: tuple, expected: str) -> None:
    said = say(*arguments)
    assert said.status == 2
    assert said.out == ""
    assert LINE.fullmatch(said.err), said.err
    assert expected in said.err


def test_help_ends_well(say) -> None:
    assert say("--help").status == 0
    for command in ("check", "new", "fit", "compare", "simulate"):
        said = say(command, "--help")
        assert said.status == 0
        assert "example:\n  snakejax" in said.out
        assert max(map(len, said.out.splitlines())) <= 80


def test_the_examples_in_the_help_can_be_parsed(say) -> None:
    for command in ("check", "new", "fit", "compare", "simulate"):
        example = say(command, "--help").out.split("example:\n")[1].split()
        assert parser().parse_args(prepared(example[1:])).command == command


def test_help_does_not_wait_for_jax() -> None:
    script = "import sys; from snakejax.commands.cli import main; main(['--help']); assert 'jax' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_pose_that_begins_with_a_minus_is_no_option() -> None:
    assert prepared(["--start", "-1,0,0"]) == ["--start=-1,0,0"]
    assert prepared(["--robust", "CASE"]) == ["--robust=", "CASE"]
    assert prepared(["--robust", "2.5", "CASE"]) == ["--robust", "2.5", "CASE"]


@pytest.mark.parametrize("word", ["--form", "--form=x.json"])
def test_a_misspelt_option_is_answered_with_the_right_one(say, word: str) -> None:
    said = say("fit", DATA / "level-board", word)
    assert said.status == 2 and LINE.fullmatch(said.err)
    assert '`snakejax fit` has no option `--form`, command line: write "--from" (known: --help' in said.err


def test_new_then_check(say, tmp_path: Path) -> None:
    folder = tmp_path / "my-board"
    assert say("new", folder).status == 0
    said = say("check", folder)
    assert said.status == 2 and LINE.fullmatch(said.err)
    assert "mass_kg (line 8), rotor_inertia_kgm2 (line 9)" in said.err and 'are still "?"' in said.err
    text = (folder / "case.toml").read_text()
    for key, value in {"mass": 7, "rotor_inertia": 0.0238, "wheelset_inertia": 0.001, "half_length": 0.25}.items():
        text = re.sub(rf'^({key}_\w+) = "\?"', rf"\1 = {value}", text, flags=re.MULTILINE)
    text = re.sub(r'^(phi|psi) = "\?"', r"\1 = [[0.9, 4.0, 0.0]]", text, flags=re.MULTILINE)
    (folder / "case.toml").write_text(text)
    said = say("check", folder)
    assert said.status == 2
    assert "train-1.csv" in said.err
    for name, source in (("train-1.csv", "train-forward-1.csv"), ("heldout-1.csv", "heldout-reverse-1.csv")):
        (folder / name).write_bytes((LEVEL / source).read_bytes())
    said = say("check", folder, "--json", tmp_path / "check.json")
    assert said.status == 0
    assert "12.00 s   100.0 Hz" in said.out
    found = json.loads((tmp_path / "check.json").read_text())
    assert [run["run"] for run in found["runs"]] == ["train-1", "heldout-1"]


@pytest.mark.slow
def test_paper_rotate_turns_as_published(say, tmp_path: Path) -> None:
    """P1: an independent integration gives 0.916 rad under Table II and 1.003 rad under Rayleigh with k_s = 9."""
    said = say("simulate", "paper-rotate", "--csv", tmp_path, "--quiet")
    assert (said.status, said.out) == (0, "")
    lines = (tmp_path / "paper-rotate.csv").read_text().splitlines()
    assert lines[0] == "time_s,x_m,y_m,heading_rad"
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    np.testing.assert_allclose(table[:, 0], np.arange(1401) / 100, atol=1e-12)
    np.testing.assert_allclose(table[0], 0.0)
    assert table[-1, 3] == pytest.approx(0.916, abs=1e-3)
    said = say("simulate", "paper-rotate", "--model", "rayleigh", "--set", "k_s=9", "--json", "-")
    found = json.loads(said.out)
    assert "noise" not in say("simulate", "paper-rotate").out, "a preset has no recording to be compared with"
    assert found["runs"][0]["end"]["heading_rad"] == pytest.approx(1.003, abs=1e-3)
    assert (found["case"], found["model"], found["skid"]) == ("paper-rotate", "rayleigh", "coupled")


@pytest.mark.slow
def test_the_start_pose_moves_the_whole_path(say) -> None:
    def end(*more: str) -> np.ndarray:
        found = json.loads(say("simulate", "paper-forward", "--json", "-", *more).out)
        return np.array([found["runs"][0]["end"][key] for key in ("x_m", "y_m", "heading_rad")])

    x, y, heading = end()
    turned = end("--start", f"-1,2,{math.pi / 2}")
    np.testing.assert_allclose(turned, (-1 - y, 2 + x, heading + math.pi / 2), atol=1e-6)


def test_presets_follow_load(say) -> None:
    found = json.loads(say("simulate", "paper-gait2", "--json", "-", "--load", "4").out)
    assert found["model"] == "bakker"
    assert found["base"]["parameters"]["load"]["value"] == 4.0
    assert found["base"]["parameters"]["camber"] == {
        "value": 0.3,
        "sd": None,
        "unit": "rad",
        "determined": None,
        "held": True,
    }


@pytest.fixture
def fitted(say, short: Path, tmp_path: Path) -> tuple[dict, Path]:
    """A fit of the small case and the file that holds it."""
    path = tmp_path / "fit.json"
    said = say("fit", short, "--free", "B,D", "--set", "C=1.5,E=-0.12", "--json", path, "--quiet")
    assert said == (0, "", "")
    return json.loads(path.read_text()), path


@pytest.mark.slow
def test_fit_writes_what_the_contract_says(fitted: tuple[dict, Path]) -> None:
    found, _ = fitted
    head = {"schema", "case", "model", "skid", "noise", "provenance"}
    assert head | {"base", "runs", "correlation", "combinations", "advice", "seconds"} <= set(found)
    assert (found["schema"], found["case"], found["model"], found["skid"]) == (1, "short-board", "pacejka", "free")
    assert set(found["noise"]) == {"position_m", "heading_rad", "source"}
    assert set(found["provenance"]) == {"versions", "seed", "options", "sha256"}
    assert {"python", "snakejax", "jax", "diffrax", "optimistix", "equinox", "numpy"} <= set(
        found["provenance"]["versions"]
    )
    assert set(found["provenance"]["sha256"]) == {"case.toml", "train-forward-1.csv", "heldout-reverse-1.csv"}
    base = found["base"]
    assert set(base["parameters"]) == {"B", "C", "D", "E"}
    assert {"value", "sd", "unit", "determined", "interval"} <= set(base["parameters"]["B"])
    assert base["parameters"]["C"] == {"value": 1.5, "sd": None, "unit": "-", "determined": None, "held": True}
    assert set(base["misfit"]) == set(base["rmse"]) == {"train", "heldout"}
    assert set(base["rmse"]["train"]) == {"position_m", "heading_rad"}
    assert [set(run) >= {"run", "role", "misfit", "worst_time_s", "channels"} for run in found["runs"]] == [True, True]
    assert set(found["runs"][0]["channels"]) == {"x", "y", "heading"}
    assert set(found["seconds"]) == {"total", "compile"}


def spoiled(short: Path, folder: Path, change: Callable[[list[str]], None]) -> Path:
    """The small case with the lines of its train recording changed."""
    shutil.copytree(short, folder)
    path = folder / "train-forward-1.csv"
    lines = path.read_bytes().decode().split("\r\n")
    change(lines)
    path.write_bytes("\r\n".join(lines).encode())
    return folder


def follow_another_body(lines: list[str]) -> None:
    for row in range(200, 230):
        cells = lines[row].split(",")
        lines[row] = ",".join([*cells[:5], str(float(cells[5]) + 700), *cells[6:]])


@pytest.mark.slow
def test_what_is_wrong_with_a_recording_is_mended_and_said(say, short: Path, tmp_path: Path, fitted) -> None:
    case = spoiled(short, tmp_path / "short-board", follow_another_body)
    path = tmp_path / "spoiled.json"
    said = say("fit", case, "--free", "B,D", "--set", "C=1.5,E=-0.12", "--json", path)
    assert said.status == 0 and said.err == ""
    assert said.out.index("30 frames masked") < said.out.index("parameter")
    found = json.loads(path.read_text())
    (finding,) = found["quality"]["findings"]
    assert (finding["kind"], finding["run"], finding["applied"]) == ("swap", "train-forward-1", True)
    assert (finding["from_s"], finding["to_s"]) == (pytest.approx(1.95), pytest.approx(2.24))
    assert finding["size"] == pytest.approx(0.7, abs=0.01) and finding["unit"] == "m"
    assert found["quality"]["masked"] == {"train-forward-1": 30}
    clean_fit = fitted[0]
    assert clean_fit["quality"] == {"as_recorded": False, "findings": [], "masked": {}}
    for name in "BD":
        before, after = (f["base"]["parameters"][name] for f in (clean_fit, found))
        assert abs(after["value"] - before["value"]) < 2 * before["sd"]
    raw = say("fit", case, "--free", "B,D", "--set", "C=1.5,E=-0.12", "--as-recorded", "--json", path, "--quiet")
    assert raw == (0, "", "")
    assert json.loads(path.read_text())["base"]["misfit"]["train"] > 1000


def test_a_wrong_unit_is_refused_before_any_fit(say, short: Path, tmp_path: Path) -> None:
    def in_metres(lines: list[str]) -> None:
        lines[4] = lines[4].replace("mm", "m")

    said = say("fit", spoiled(short, tmp_path / "short-board", in_metres), "--quiet")
    assert said.status == 2 and LINE.fullmatch(said.err)
    assert "is the unit of length right?, short-board, run train-forward-1: correct the unit" in said.err


@pytest.mark.slow
def test_fit_finds_the_answer(fitted: tuple[dict, Path]) -> None:
    """The values with which level-board was simulated, given C and E, lie within a few standard errors."""
    found, _ = fitted
    for name, truth in (("B", 7.589), ("D", 8.543)):
        entry = found["base"]["parameters"][name]
        assert abs(entry["value"] - truth) < 5 * entry["sd"] + 0.02 * truth
    assert found["base"]["misfit"]["train"] == pytest.approx(1, abs=0.15)
    assert found["base"]["misfit"]["heldout"] == pytest.approx(1, abs=0.15)


@pytest.mark.slow
def test_a_saved_fit_is_simulated(say, fitted: tuple[dict, Path], short: Path, tmp_path: Path) -> None:
    found, path = fitted
    said = say("simulate", short, "--from", path, "--csv", tmp_path / "csv", "--json", "-")
    again = json.loads(said.out)
    for before, after in zip(found["runs"], again["runs"], strict=True):
        assert after["misfit"] == pytest.approx(before["misfit"], rel=1e-2)
    rows = (tmp_path / "csv" / "train-forward-1.csv").read_text().splitlines()
    assert len(rows) == 402


@pytest.mark.slow
def test_compare_says_where_it_fails(say, short: Path, tmp_path: Path) -> None:
    said = say("compare", short, "--set", "B=7.589,C=1.515,E=-0.122", "--json", tmp_path / "c.json")
    assert said.status == 0
    assert max(map(len, said.out.splitlines())) <= 80
    found = json.loads((tmp_path / "c.json").read_text())["comparison"]
    assert ("are white noise" in said.out) is found["white"]
    assert {test["channel"] for test in found["whiteness"]} >= {"x", "y", "heading"}
    assert {"run", "time_s", "channel", "residual_sd", "residual", "unit"} == set(found["worst"][0])
    said = say("compare", short, "--against", "wheel")
    assert said.status == 2
    assert "option --against" in said.err


@pytest.mark.slow
def test_several_cases_and_one_that_is_wrong(say, short: Path, tmp_path: Path) -> None:
    values = "B=7.6,C=1.5,D=8.5,E=-0.1"
    said = say(
        *("simulate", tmp_path / "none", short, "paper-rotate", "--json", tmp_path / "out"),
        *("--skid", "free", "--set", values, "--quiet"),
    )
    assert said.status == 2
    assert LINE.fullmatch(said.err)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"short-board.json", "paper-rotate.json"}


@pytest.mark.slow
def test_an_effect_of_ones_own_is_fitted(say, short: Path, tmp_path: Path) -> None:
    own = tmp_path / "mine.py"
    own.write_text(WORLD_SPRING, encoding="utf-8")
    path = tmp_path / "fit.json"
    said = say("fit", short, "--model", "ideal", "--effect", f"{own}:WorldSpring", "--json", path)
    assert said.status == 0
    assert "world_spring.k" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    saved = saved_fit(path)
    assert (saved.model, saved.constraint) == ("ideal", "ideal")
    assert set(saved.effects["world_spring"]) == {"k"}
    said = say("simulate", short, "--from", path)
    assert said.status == 2
    assert "--with FILE.py:Class" in said.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("returned", "expected"),
    [
        ("(jnp.zeros(3) @ jnp.zeros(2), 0.0, 0.0)", " line 8: correct the file; "),
        ("(0.0, 0.0)", ", this command: a bug in snakejax or "),
    ],
)
def test_an_error_in_an_effect_of_ones_own_is_not_called_a_bug_of_snakejax(say, tmp_path, returned, expected) -> None:
    own = tmp_path / "mine.py"
    lines = ["import jax.numpy as jnp", "import snakejax as sj", "", "class Pull(sj.Force):"]
    lines += [
        '    k: sj.Scalar = sj.param("N/m", default=0.0)',
        "",
        "    def wrench(self, motion):",
        f"        return {returned}",
    ]
    own.write_text("\n".join(lines), encoding="utf-8")
    said = say("simulate", "paper-rotate", "--with", f"{own}:Pull:k=1")
    assert said.status == 1 and said.out == ""
    assert expected in said.err and str(own) in said.err and LINE.fullmatch(said.err)


def test_a_table_of_the_worst_fits_80_columns() -> None:
    score = RunScore("heldout-reverse-12", "heldout", 2.84e5, dict(x=5.4e5, y=1e8, heading=5e3), 0.4, 1.2, 9, 112.0)
    console = Console(width=78, file=io.StringIO(), record=True)
    console.print(runs_table([score, score._replace(role="train", run="[s] run")]))
    text = console.export_text()
    assert "heldout-reverse-12" in text
    assert "[s] run" in text
    assert {"position", "heading", "error", "worst"} <= set(text.split())  # no name of a column is broken
    row = next(line for line in text.splitlines() if line.strip().startswith("heldout-reverse-12"))
    assert row.split()[1:] == ["400", "1200", "533", "735", "10000", "70.7", "112.00"]


def test_double_precision_is_on() -> None:
    assert jax.config.jax_enable_x64


@pytest.mark.slow
def test_diagnose_ranks_every_candidate_and_adds_none(say, short):
    said = say("diagnose", short, "--json", "-", "--quiet", "--without", "clock_offset")
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert deviations("diagnose", found) == []
    assert found["schema"] == 1 and found["case"] == "short-board" and "verdict" not in found
    names = [candidate["effect"] for candidate in found["ranking"]]
    left = [one["effect"] for one in found["left_out"]]
    assert len(set(names)) == len(names) and not set(names) & set(left)
    assert set(names) | set(left) | {"clock_offset"} >= set(LIBRARY) and "clock_offset" not in names
    for candidate in found["ranking"]:
        assert {"p_value", "statistic", "predicted_misfit", "refit_misfit", "estimate"} <= set(candidate)
        assert {"confusable_with", "detectable"} <= set(candidate)
        if candidate["p_value"] is not None:
            assert 0 <= candidate["p_value"] <= 1


@pytest.mark.slow
def test_explain_finds_a_level_board_adequate(say, short, tmp_path):
    """Four seconds of a board without a hidden effect, one train run: nothing to add."""
    said = say("explain", short, "--json", "-", "--quiet", "--out", tmp_path, "--without", "clock_offset")
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert deviations("explain", found) == []
    assert (found["verdict"], found["effects"], found["steps"]) == ("adequate", [], [])
    assert found["unexplained"] is None and found["final"]["misfit"] == found["base"]["misfit"]
    assert (tmp_path / "explain-fall.png").is_file() and (tmp_path / "explain.json").is_file()


@pytest.mark.slow
def test_sweep_writes_the_curve_and_the_figure(say, tmp_path):
    said = say("sweep", "paper-rotate", "--vary", "D=1:4:7", "--json", "-", "--quiet", "--out", tmp_path)
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert found["D"] == pytest.approx(np.linspace(1, 4, 7).tolist())
    assert len(found["k_s"]) == len(found["mismatch"]) == 7 and len(found["polynomial"]) == 5
    page = (tmp_path / "sweep.html").read_text()
    assert found["units"] == {"D": "N"} and page.count(">D [N]<") == 1 and page.count('"D [N]"') == 2
    assert found["fitted_range"] == [1.0, 4.0] and 0.9 < found["r_squared"] <= 1
    assert (tmp_path / "sweep.png").exists() and (tmp_path / "sweep.nc").exists()
    assert len(list((tmp_path / "sweep-pieces").glob("*/*.npz"))) == 1


@pytest.mark.slow
def test_sweep_over_the_k_s_of_a_rayleigh_board(say, tmp_path):
    """What is varied needs no other value, and no second Rayleigh board follows it."""
    vary = ("--model", "rayleigh", "--vary", "k_s=2:40:3")
    said = say("sweep", "paper-rotate", *vary, "--json", "-", "--quiet", "--out", tmp_path)
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert found["k_s"] == [2, 21, 40] and "mismatch" not in found and found["polynomial"] is None
    assert len(set(found["end"]["x_m"])) == 3 and "k_s" in (tmp_path / "sweep.html").read_text()
    said = say("sweep", "paper-rotate", *vary)
    assert said.out.splitlines()[1].split("  ")[0] == "k_s [N s/m]"
    assert said.status == 0 and [line.split()[0] for line in said.out.splitlines()[3:6]] == ["2", "21", "40"]


def test_what_is_not_there_to_be_varied_is_told_before_the_fit(say, monkeypatch):
    def never(*_):
        raise AssertionError("nothing was to be fitted")

    monkeypatch.setattr("snakejax.commands.cli.sweep.fitted", never)
    said = say("sweep", LEVEL, "--vary", "massive=1:2:3")
    assert said.status == 2 and said.err.startswith("snakejax: error: No parameter is called `massive`, option --vary:")


@pytest.mark.slow
def test_sweep_over_two_parameters_and_over_a_table(say, tmp_path):
    both = ("--vary", "D=1:4:2", "--vary", "B=0.08:0.1:3")
    said = say("sweep", "paper-rotate", *both, "--json", "-", "--quiet", "--out", tmp_path)
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert found["axes"] == ["D", "B"] and np.shape(found["k_s"]) == np.shape(found["end"]["x_m"]) == (2, 3)
    assert found["polynomial"] is None and (tmp_path / "sweep.png").exists()
    (tmp_path / "boards.csv").write_text("D,board.mass\n1,7\n4,7\n4,9\n")
    said = say("sweep", "paper-rotate", "--table", tmp_path / "boards.csv", "--json", "-", "--quiet")
    assert said.status == 0 and said.err == ""
    rows = json.loads(said.out)
    assert rows["axes"] == ["row"] and rows["board.mass"] == [7, 7, 9] and len(rows["k_s"]) == 3
    (tmp_path / "boards.csv").write_text("D\n" + "".join(f"{D}\n" for D in (4, 1, 2, 3, 5, 6, 7)))
    said = say("sweep", "paper-rotate", "--table", tmp_path / "boards.csv", "--json", "-", "--quiet")
    assert json.loads(said.out)["polynomial"] is None  # its axis is the row
    said = say("sweep", "paper-gait1", "--vary", "load=2:3:2", "--vary", "camber=0:0.5:2", "--json", "-", "--quiet")
    assert np.shape(json.loads(said.out)["mismatch"]) == (2, 2)


@pytest.mark.slow
def test_the_sweep_of_a_board_that_none_follows_says_where_it_ends(say):
    said = say("sweep", "paper-rotate", "--model", "ideal", "--vary", "mass=6:8:2", "--json", "-", "--quiet")
    assert said.status == 0 and said.err == ""
    found = json.loads(said.out)
    assert "k_s" not in found and np.isfinite(found["end"]["heading_rad"]).all()


@pytest.mark.slow
def test_the_inertia_of_a_recorded_board_follows_the_mass_that_is_swept(say):
    said = say("sweep", LEVEL, "--model", "ideal", "--vary", "mass=5:9:2", "--json", "-", "--quiet")
    assert said.status == 0 and said.err == ""
    case = snakejax.load_case(LEVEL)
    model, run = snakejax.starting_model(case, "ideal"), case.runs[0]
    alone = snakejax.sweep(model, run.gait, run.times[-1:], {"board.mass": [5.0, 9.0]})
    np.testing.assert_array_equal(json.loads(said.out)["end"]["heading_rad"], alone.heading.values[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("sweep", "paper-rotate", "--vary", "Q=1:4:7"), "`Q`"),
        (("sweep", "paper-rotate", "--vary", "load=1:4:7"), "load"),
        (("sweep", LEVEL, "--vary", "load=1:4:7"), "paper-gait1"),
        (("sweep", LEVEL, "--vary", "D=1:4:7", "--run", "nothing", "--set", "B=6,C=1.4,D=6,E=0"), "nothing"),
        (("sweep", "paper-rotate", "--vary", "D=1:4:7", "--model", "rayleigh", "--set", "k_s=9"), "`D`"),
        (("sweep", "paper-gait1", "--vary", "D=1:4:7", "--vary", "load=1:2:3"), "`load`"),
        (("sweep", "paper-rotate", "--vary", "D=1:4:7", "--vary", "D=1:2:3"), "twice"),
        (("sweep", "paper-rotate", "--vary", "D=1:4:7", "--vary", "tyre.D=1:2:3"), "twice"),
        (("sweep", "paper-rotate", "--vary", "D=-1:4:7"), "at least 0"),
        (("sweep", "paper-rotate"), "--vary"),
        (("sweep", "paper-rotate", "--table", "nowhere.csv"), "nowhere.csv"),
    ],
)
def test_a_sweep_that_cannot_be_made_is_one_line(say, arguments, what):
    said = say(*arguments)
    assert said.status == 2 and said.out == ""
    assert LINE.fullmatch(said.err) and what in said.err
