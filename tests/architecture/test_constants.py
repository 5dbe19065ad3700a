"""Each number that a module names says what it is: by a docstring below it, or by a comment."""

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "snakejax"
FILES = sorted(SOURCE.rglob("*.py"))


def is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def is_number(node: ast.stmt) -> bool:
    """Whether `node` names numbers alone."""
    if not isinstance(node, ast.Assign):
        return False
    constants = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
    numbers = [c for c in constants if isinstance(c, int | float) and not isinstance(c, bool)]
    return bool(numbers) and not any(isinstance(c, str) for c in constants)


def unexplained(text: str) -> list[int]:
    """The lines of numbers that nothing explains. A docstring also explains the assignments right before it."""
    body, lines = ast.parse(text).body, text.splitlines()
    missing = []
    for k, node in enumerate(body):
        if not is_number(node):
            continue
        commented = "#" in lines[node.lineno - 1] or lines[node.lineno - 2].startswith("#")
        following = next((other for other in body[k + 1 :] if not isinstance(other, ast.Assign)), None)
        if not commented and (following is None or not is_docstring(following)):
            missing.append(node.lineno)
    return missing


def test_a_bare_number_is_noticed():
    assert unexplained("A = 3.0\nB = (1, 2)\n\n\ndef f(): ...\n") == [1, 2]
    assert unexplained('A = 3.0\n"""Metres."""\nB = 2  # seconds\n# Volts.\nC = 1\nNAME = "x"\n') == []


def test_numbers_are_explained():
    lines = {str(file.relative_to(SOURCE)): unexplained(file.read_text(encoding="utf-8")) for file in FILES}
    assert {file: missing for file, missing in lines.items() if missing} == {}
