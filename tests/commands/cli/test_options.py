"""What options may hold."""

from pathlib import Path

import pytest

from snakejax.commands.cli.design import effects_of
from snakejax.commands.cli.main import main, parser, prepared
from snakejax.commands.cli.options import given, varied
from snakejax.core.errors import InputError

CASE = Path(__file__).resolve().parents[3] / "data" / "tilted-floor"


@pytest.mark.parametrize("text", ["D", "D=1:2", "D=1:2:one", "D=2:1:5", "=1:2:3", "D=1:2:1", "D=nan:2:3"])
def test_values_that_are_none_are_refused(text) -> None:
    with pytest.raises(InputError, match="--vary"):
        varied(text)


@pytest.mark.parametrize("text", ["seperate:a,b", "foo:a,b", "information:a,b"])
def test_a_misspelt_objective_of_a_design_is_refused(text) -> None:
    with pytest.raises(InputError, match="no objective"):
        effects_of(text)


@pytest.mark.parametrize("case", [".", "2024-09-04", "CASE"])
def test_robust_takes_no_case_for_its_number(case) -> None:
    assert prepared(["--robust", case]) == ["--robust=", case]


def test_a_zero_that_was_given_is_recorded() -> None:
    options = parser().parse_args(["simulate", "paper-gait1", "--camber", "0"])
    assert given(options)["camber"] == 0.0


@pytest.mark.parametrize("command", ["diagnose", "explain"])
def test_a_tenth_of_whole_recordings_is_refused(command, capsys) -> None:
    """Before anything is fitted."""
    assert main([command, str(CASE), "--quick"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "option --quick" in told and "whole recording" in told
