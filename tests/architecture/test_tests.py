"""Tests lie in the room that they test, and share code by way of helpers and oracles alone."""

import ast
from pathlib import Path

import pytest
from helpers.folders import ROOT

TESTS = ROOT / "tests"
SOURCE = ROOT / "src" / "snakejax"
ROOMS = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").is_file()}
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


def folders_of(room: Path) -> dict[str, set[str]]:
    """For each name of a module of `room`, the folders inside it that have one; "." is the room itself."""
    places: dict[str, set[str]] = {}
    for module in room.rglob("*.py"):
        places.setdefault(module.stem, set()).add(str(module.parent.relative_to(room)))
    return places


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_folders_of_tests_are_those_of_the_room(room: str) -> None:
    """Where a room has folders its tests have the same; a test file named as a module lies in the folder of that."""
    places = folders_of(SOURCE / room)
    inside = {folder for folders in places.values() for folder in folders}
    for file in (TESTS / room).rglob("test_*.py"):
        own = str(file.parent.relative_to(TESTS / room))
        assert own in inside, f"{file}: {room} has no folder {own}"
        assert own in places.get(file.stem.removeprefix("test_"), {own}), f"{file}: its module lies elsewhere"


def test_no_file_imports_a_test() -> None:
    names = {str(file.relative_to(TESTS)): imported(file) for file in FILES}
    assert [file for file, some in names.items() if any(n.startswith("test_") or n == "conftest" for n in some)] == []


def test_the_name_of_a_test_file_is_used_once() -> None:
    """pytest would take the second for the first."""
    names = [file.name for file in FILES if file.name.startswith("test_")]
    assert len(names) == len(set(names))
