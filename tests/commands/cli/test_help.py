"""Help, and options that mean the same wherever they are taken."""

import argparse
import json
import re

import pytest
from helpers.folders import DATA

from snakejax.commands.cli import main
from snakejax.commands.cli.main import COMMANDS, parser

LEVEL = str(DATA / "level-board")


def choices() -> dict[str, argparse.ArgumentParser]:
    """The parsers of the commands by name."""
    (found,) = (action.choices for action in parser()._actions if isinstance(action.choices, dict))
    return found


def test_without_a_command_the_help_is_printed(capsys) -> None:
    assert main([]) == 0
    alone = capsys.readouterr()
    assert main(["--help"]) == 0
    assert alone == capsys.readouterr() and alone.err == ""
    assert main(["help"]) == 0
    assert capsys.readouterr() == alone
    assert "\n    design " in alone.out and "\n    help " in alone.out


@pytest.mark.parametrize("command", ["check", "fit", "explain", "design", "import"])
def test_help_of_a_command(command: str, capsys) -> None:
    assert main(["help", command]) == 0
    asked = capsys.readouterr().out
    assert main([command, "--help"]) == 0
    assert capsys.readouterr().out == asked and asked.startswith(f"usage: snakejax {command}")


def test_help_of_nothing_is_one_line(capsys) -> None:
    assert main(["help", "fitt"]) == 2
    said = capsys.readouterr().err
    assert said.startswith('snakejax: error: There is no command `fitt`, argument COMMAND: write "fit"')
    assert said.count("\n") == 1


def test_the_version_has_a_short_option(capsys) -> None:
    assert main(["-V"]) == 0
    assert re.fullmatch(r"snakejax \d\S*\n", capsys.readouterr().out)


def options_of(name: str) -> dict[str, argparse.Action]:
    """The shown options of a command by their long names."""
    actions = choices()[name]._actions
    return {a.option_strings[-1]: a for a in actions if a.option_strings and a.help != argparse.SUPPRESS}


@pytest.mark.parametrize("option", ["--with", "--out", "--json", "--model", "--skid", "--set", "--from", "--free"])
def test_an_option_is_described_by_the_same_words_everywhere(option: str) -> None:
    described = {o[option].help for name in choices() if name != "import" and option in (o := options_of(name))}
    assert len(described) == 1


def test_effect_is_a_candidate_wherever_it_is_shown() -> None:
    shown = {name for name in choices() if "--effect" in options_of(name)}
    assert shown == {"diagnose", "explain", "design"}
    assert "--out" not in options_of("import") and "--case" in options_of("import")


def test_fit_compare_diagnose_and_explain_have_the_same_model_options() -> None:
    groups = []
    for name in ("fit", "compare", "diagnose", "explain"):
        parts = {g.title: [a.dest for a in g._group_actions] for g in choices()[name]._action_groups}
        groups.append((parts["model"], [dest for dest in parts["estimation"] if dest not in ("profile", "bootstrap")]))
    assert groups[0][1] == ["free", "by", "robust"]
    # `--effect` in the spelling of before is the second `with_` of fit and compare.
    assert all((list(dict.fromkeys(model)), rest) == (groups[3][0], groups[0][1]) for model, rest in groups)


def test_every_command_with_cases_says_so_in_groups() -> None:
    for module in COMMANDS:
        name = module.__name__.rsplit(".", 1)[-1]
        if name in ("new", "completion", "importing"):
            continue
        titles = [group.title for group in choices()[name]._action_groups]
        assert "output" in titles and (name == "check" or "model" in titles)


@pytest.mark.slow
@pytest.mark.parametrize("word", ["--with", "--effect"])
def test_both_spellings_put_an_effect_into_the_model(word: str, tmp_path, capsys) -> None:
    values = "B=7.6,C=1.5,D=8.5,E=-0.1"
    path = tmp_path / "found.json"
    words = ["simulate", LEVEL, "--set", values, "--start", "0,0,0", word, "ground_slope:sx=0.01,sy=0"]
    assert main([*words, "--json", str(path), "--quiet"]) == 0
    found = json.loads(path.read_text())
    assert found["base"]["effects"]["ground_slope"]["sx"]["value"] == 0.01
    assert found["provenance"]["options"]["with"] == ["ground_slope:sx=0.01,sy=0"]


@pytest.mark.slow
def test_results_of_two_commands_stay_side_by_side(tmp_path, capsys) -> None:
    values = ["--set", "B=7.6,C=1.5,D=8.5,E=-0.1"]
    assert main(["simulate", "paper-forward", *values, "--out", str(tmp_path), "--quiet"]) == 0
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert {"simulate.json", "simulate-paths.png"} <= set(first)
    vary = ["--model", "ideal", "--vary", "mass=6:8:2"]
    assert main(["sweep", "paper-rotate", *vary, "--out", str(tmp_path), "--quiet"]) == 0
    assert main(["check", LEVEL, "--out", str(tmp_path), "--quiet"]) == 0
    assert {"sweep.json", "sweep.html", "check.json"} <= {path.name for path in tmp_path.iterdir()}
    assert all((tmp_path / name).read_bytes() == content for name, content in first.items())
