"""The JSON Schema that is shipped: every command's result follows it, and the documentation names its keys."""

import copy
import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.folders import ROOT
from helpers.made_up_explanation import result, story
from helpers.schema import deviations
from jsonschema import Draft202012Validator

from snakejax.commands.cli import main
from snakejax.commands.cli.main import parser
from snakejax.diagnosis.explanation import PoseError, Remainder, RunBand, TriedCandidate
from snakejax.diagnosis.odd_runs import OddRun
from snakejax.estimation.uncertainty import Estimate
from snakejax.present.as_json.schema import schema_of

LEVEL = ROOT / "data" / "level-board"
GIVEN = ("--set", "B=7.589,C=1.515,D=8.543,E=-0.122")
FITTED = ("--free", "B,D", "--set", "C=1.515,E=-0.122")
DESIGN = ("--limit", "phi=0.9,psi=1.6", "--seconds", "1.5")
RUNS = {
    "check": [("check", "CASE")],
    "import": [("import", LEVEL / "train-forward-1.csv")],
    "fit": [("fit", "CASE", *FITTED, "--profile", "B", "--bootstrap", "40"), ("fit", "CASE", "--model", "ideal")],
    "compare": [("compare", "CASE", *FITTED, "--against", "ideal")],
    "simulate": [("simulate", "paper-rotate"), ("simulate", "CASE", *GIVEN)],
    "sweep": [
        ("sweep", "paper-rotate", "--vary", "D=1:4:7"),
        ("sweep", "paper-rotate", "--vary", "D=1:2:2", "--vary", "B=5:6:2"),
        ("sweep", "paper-rotate", "--model", "ideal", "--vary", "mass=6:8:2"),
    ],
    "tune": [
        ("tune", "CASE", *GIVEN, "--objective", "reach:0.1,0.1,0.2", *DESIGN),
        ("tune", "CASE", "--objective", "separate:ground_slope,body_drag", *DESIGN),
    ],
    "design": [
        ("design", "CASE", "--objective", "separate:ground_slope,body_drag", *DESIGN),
        ("design", "CASE", "--objective", "information", *DESIGN),
    ],
}
"""By command, its arguments; CASE stands for a case of four seconds."""
ELSEWHERE = {
    "diagnose": "commands/cli/test_commands.py",
    "explain": "commands/cli/test_commands.py",
    "predict": "commands/cli/test_other_vehicles.py",
}
"""By command that takes long, the file of the test that runs it and holds what it writes against the schema."""


def marks(command: str) -> list[pytest.MarkDecorator]:
    """A designed run needs many simulations. What tuning writes is also checked where its numbers are
    (tests/design/test_tuning.py)."""
    return [pytest.mark.long] * (command in ("tune", "design"))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first four seconds of a train and of a held-out run of `level-board`."""
    folder = tmp_path_factory.mktemp("cases") / "four-seconds"
    folder.mkdir()
    head, *runs = (LEVEL / "case.toml").read_text(encoding="utf-8").split("[[runs]]")
    kept = [run for run in runs if "train-forward-1" in run or "heldout-reverse-1" in run]
    text = "[[runs]]".join([head, *(f"{run.rstrip()}\nwindow_s = [0.0, 4.0]\n\n" for run in kept)])
    (folder / "case.toml").write_text(text, encoding="utf-8")
    for run in kept:
        (name,) = re.findall('mocap = "(.*)"', run)
        (folder / name).write_bytes((LEVEL / name).read_bytes())
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        pytest.param(command, arguments, marks=marks(command), id=f"{command} {k}")
        for command, several in RUNS.items()
        for k, arguments in enumerate(several)
    ],
)
def test_what_a_command_writes_follows_the_schema(command, arguments, case, tmp_path, monkeypatch, pytestconfig):
    assert pytestconfig.cache is not None
    monkeypatch.setenv("XDG_CACHE_HOME", str(pytestconfig.cache.mkdir("snakejax")))
    file = tmp_path / "result.json"
    words = [str({"CASE": case}.get(word, word)) for word in arguments]
    assert main([*words, "--json", str(file), "--quiet"]) == 0
    assert deviations(command, json.loads(file.read_text(encoding="utf-8"))) == []


def test_every_command_that_writes_json_is_run() -> None:
    choices = next(action.choices for action in parser()._actions if action.choices and "fit" in action.choices)
    writing = {name for name, command in choices.items() if "--json" in command.format_help()}
    assert writing == {*RUNS, *ELSEWHERE}
    for command, file in ELSEWHERE.items():
        assert f'deviations("{command}", ' in (ROOT / "tests" / file).read_text(encoding="utf-8")


def told(**parts: Any) -> dict[str, Any]:
    """The result of an explanation that was made up, with other parts."""
    made = result(dataclasses.replace(story(), **parts))
    return made | {"seconds": {"total": 1.0, "compile": 0.5}}


CERTAIN = {
    "confidence": {"ground_slope": "sure"},
    "share": {"ground_slope": 0.9},
    "explained_share": 0.95,
    "floor": PoseError(4e-4, 2.5e-3, "cameras"),
    "remainder": Remainder(1e-3, 4e-3, (("speed", 0.4),), ("east = b * x", "east = b * y")),
    "constants": {"board.mass": Estimate(7.0, 0.05, "kg", True)},
    "candidates": (TriedCandidate(1, "ground_slope", 0.9, 1e-9, 1.2, True, "it explains most"),),
    "bands": (RunBand("one", "train", 0.94, *np.zeros((3, 2))),),
    "odd_runs": (OddRun("one", "tyre.D", 0.5, 0.1, 1e-4, ("tyre.B",), ("ground_slope",)),),
}


@pytest.mark.parametrize("parts", [{}, {"verdict": "explained", "missing": None}, CERTAIN], ids=["", "ends", "sure"])
def test_an_explanation_of_any_end_follows_the_schema(parts) -> None:
    made = told(**parts)
    assert deviations("explain", made) == []
    if parts is CERTAIN:
        assert made["final"]["remainder"]["depends_on"] == [{"variable": "speed", "share": 0.4}]
        assert made["final"]["remainder"]["laws"] == ["east = b * x", "east = b * y"]
        assert made["candidates"][0]["why"] == "it explains most"


SPOILED = {
    "a key is missing": lambda made: made["base"].pop("misfit"),
    "a key is misspelled": lambda made: made["base"].update(missfit=1.0),
    "a number is text": lambda made: made["runs"][0].update(misfit="1.0"),
    "a verdict is unknown": lambda made: made.update(verdict="perhaps"),
    "a step has no name": lambda made: made["steps"][0].pop("added"),
    "an estimate lacks its unit": lambda made: made["base"]["parameters"]["D"].pop("unit"),
    "a key is new": lambda made: made.update(news=1),
}


@pytest.mark.parametrize("change", SPOILED)
def test_the_schema_refuses_what_does_not_follow_it(change) -> None:
    made = copy.deepcopy(told())
    SPOILED[change](made)
    assert deviations("explain", made) != []


def keys_of(part: Any) -> Iterator[str]:
    """Every key that a schema names."""
    if isinstance(part, dict):
        yield from part.get("properties", {})
        for below in part.values():
            yield from keys_of(below)
    if isinstance(part, list):
        for below in part:
            yield from keys_of(below)


@pytest.mark.parametrize("command", [*RUNS, *ELSEWHERE])
def test_the_schema_is_one(command) -> None:
    Draft202012Validator.check_schema(schema_of(command))


def test_no_key_is_described_twice() -> None:
    """Not in the schema, where the last one would silently hold, and not in the pages."""

    def once(members: list[tuple[str, Any]]) -> dict[str, Any]:
        assert len(dict(members)) == len(members), [key for key, _ in members]
        return dict(members)

    schema = ROOT / "src" / "snakejax" / "present" / "as_json" / "schema.json"
    json.loads(schema.read_text(encoding="utf-8"), object_pairs_hook=once)
    page = (ROOT / "docs" / "json.md").read_text(encoding="utf-8")
    for section in re.split(r"^## .*$", page, flags=re.MULTILINE):
        rows = re.findall(r"^\| (`[^|]*`) \|", section, flags=re.MULTILINE)
        assert len(set(rows)) == len(rows)


def test_every_key_of_the_schema_is_documented() -> None:
    page = (ROOT / "docs" / "json.md").read_text(encoding="utf-8")
    tables = [line for line in page.splitlines() if line.startswith("|") or "`{" in line]
    named = set(re.findall(r"\w+", " ".join(re.findall("`([^`]+)`", " ".join(tables)))))
    assert set(keys_of(schema_of("fit"))) - named == set()
