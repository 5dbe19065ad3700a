"""Tests lie in the room that they test, and share code by way of helpers and oracles alone."""

import ast
from pathlib import Path

import pytest
from helpers.folders import ROOT

TESTS = ROOT / "tests"
ROOMS = {path.name for path in (ROOT / "src" / "snakejax").iterdir() if (path / "__init__.py").is_file()}
BESIDE = {"architecture", "studies"}
"""Folders with tests of no single room: of the tree itself, and of what is run as users run it."""
SHARED = {"helpers", "oracles"}
FILES = sorted(TESTS.rglob("*.py"))


def imported(file: Path) -> set[str]:
    """The first part of the name of each module that `file` imports, at run time or in a script that it writes."""
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            words = [line.split() for line in node.value.splitlines()]
            names |= {line[1] for line in words if len(line) > 1 and line[0] in ("from", "import")}
    return {name.split(".")[0] for name in names}


def test_every_room_has_its_tests_and_every_test_its_room() -> None:
    homes = {file.relative_to(TESTS).parts[0] for file in FILES if file.name.startswith("test_")}
    assert homes == ROOMS | BESIDE
    others = {file.relative_to(TESTS).parts[0] for file in FILES if not file.name.startswith("test_")}
    assert others == SHARED | {"conftest.py"}


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(TESTS)))
def test_no_file_imports_a_test(file: Path) -> None:
    assert not {name for name in imported(file) if name.startswith("test_") or name == "conftest"}


def test_the_name_of_a_test_file_is_used_once() -> None:
    """pytest would take the second for the first."""
    names = [file.name for file in FILES if file.name.startswith("test_")]
    assert len(names) == len(set(names))
