"""Programs beside the package import names that are there: nobody runs all of them after each change."""

import ast
import importlib
from pathlib import Path

import pytest
from helpers.folders import ROOT

PROGRAMS = sorted(path for folder in ("benchmarks", "fit") for path in (ROOT / folder).rglob("*.py"))


def missing(source: str) -> list[str]:
    """The names that `source` imports from snakejax and that are not there."""
    absent = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").split(".")[0] == "snakejax":
            absent += [f"{node.module}.{alias.name}" for alias in node.names if not there(node.module, alias.name)]
    return absent


def there(module: str, name: str) -> bool:
    """Whether `from module import name` works."""
    try:
        if hasattr(importlib.import_module(module), name):
            return True
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return False
    return True


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_program_imports_is_there(path: Path) -> None:
    assert not missing(path.read_text())


def test_a_name_that_moved_is_noticed() -> None:
    source = "from snakejax.estimation.sensitivity import Sensitivities, tested\nfrom snakejax.nowhere import Model\n"
    assert missing(source) == ["snakejax.estimation.sensitivity.tested", "snakejax.nowhere.Model"]
