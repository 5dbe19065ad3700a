"""Names of variables and arguments say what a thing is, not that it was found or told."""

import ast

import pytest
from helpers.folders import ROOT

SOURCE = ROOT / "src" / "snakejax"
VAGUE = {"found", "seen", "told", "there", "mine", "said", "asked", "thing"}
FILES = sorted(SOURCE.rglob("*.py"))


def bound_names(text: str) -> list[tuple[str, int]]:
    """Each variable, argument and field that `text` binds, and its line; function and class names are no part of it."""
    names = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append((node.id, node.lineno))
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.append((node.attr, node.lineno))
        elif isinstance(node, ast.arg):
            names.append((node.arg, node.lineno))
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name is not None:
            names.append((node.name, node.lineno))
    return names


def vague_names(text: str) -> list[str]:
    return [f"{name} (line {line})" for name, line in bound_names(text) if name.strip("_") in VAGUE]


def test_a_name_says_what_a_thing_is() -> None:
    vague = {str(file.relative_to(SOURCE)): vague_names(file.read_text(encoding="utf-8")) for file in FILES}
    assert {file: names for file, names in vague.items() if names} == {}, "names that should say what their values are"


@pytest.mark.parametrize(
    "text",
    [
        "found = 1",
        "found: int",
        "_found = 1",
        "self.found = 1",
        "a, (b, *found) = c",
        "for found in a: ...",
        "a = [found for found in b]",
        "with a as found: ...",
        "if found := a: ...",
        "def f(found): ...",
        "def f(*found): ...",
        "f = lambda **found: 1",
        "try: ...\nexcept ValueError as found: ...",
        "match a:\n    case [found]: ...",
    ],
)
def test_a_bound_name_is_noticed(text: str) -> None:
    assert len(vague_names(text)) == 1


@pytest.mark.parametrize("text", ["a = found.told", "a(found=1)", "def found(): ...", "founded = 1", "a['found'] = 1"])
def test_other_uses_of_the_words_are_free(text: str) -> None:
    assert vague_names(text) == []
