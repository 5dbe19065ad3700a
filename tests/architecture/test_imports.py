"""Which package may import which, and which library is known where."""

import ast
import graphlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "snakejax"

ALLOWED: dict[str, set[str]] = {
    "core": set(),
    "dynamics": {"core"},
    "vehicles": {"core", "dynamics"},
    "effects": {"core", "dynamics"},
    "simulation": {"core", "dynamics"},
    "recording": {"core", "dynamics", "vehicles"},
    "estimation": {"core", "dynamics", "simulation", "recording"},
    "diagnosis": {"core", "dynamics", "simulation", "recording", "estimation"},
    "design": {"core", "dynamics", "simulation", "recording", "estimation"},
    "present": {"core", "dynamics", "simulation", "recording", "estimation", "diagnosis", "design"},
}
TOP = "commands"
"""The commands may import everything, and no package imports them."""
ONLY_IN = {
    "diffrax": {"simulation.integrate", "simulation.forward_loop", "simulation.ensemble"},
    "optimistix": {"estimation.levenberg_marquardt", "simulation.rayleigh_match", "design.tuning"},
    "distributed": {"simulation.dask_executor"},
    "heyoka": {"simulation.taylor_series", "simulation.taylor_ensemble"},
    "matplotlib": {"present"},
    "plotly": {"present"},
    "jinja2": {"present"},
    "rich": {"present", "commands"},
}

FILES = sorted(SOURCE.rglob("*.py"))


def module_of(file: Path) -> str:
    """`dynamics.model`, or `dynamics` for its `__init__.py`."""
    parts = file.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file) for file in FILES}


def run_time(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes below `tree`, without what only a type checker sees."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            continue
        yield node
        yield from run_time(node)


def imported(text: str, package: tuple[str, ...]) -> set[str]:
    """Every dotted name that `text`, a module of `package`, imports, absolute."""
    names = set()
    for node in run_time(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            base = ".".join((*above, *(node.module or "").split("."))).strip(".")
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


def inside(names: set[str]) -> set[str]:
    """The modules of snakejax among `names`: `dynamics.model` for `snakejax.dynamics.model.Model`."""
    found = set()
    for name in names:
        root, *parts = name.split(".")
        if root == "snakejax":
            while parts and ".".join(parts) not in MODULES:
                parts.pop()
            found.add(".".join(parts))
    return found


@cache
def imports_of(file: Path) -> set[str]:
    """The dotted names that `file` imports."""
    return imported(file.read_text(encoding="utf-8"), ("snakejax", *file.relative_to(SOURCE).parts[:-1]))


def packages_of(modules: set[str]) -> set[str]:
    """The packages of `modules`; "" is the public face of snakejax."""
    return {module.split(".")[0] for module in modules}


def test_every_module_is_in_a_package() -> None:
    assert {module.split(".")[0] for module in MODULES} == {"", "__main__", TOP, *ALLOWED}


def test_imports_follow_the_arrows() -> None:
    wrong = {}
    for file in FILES:
        module = module_of(file)
        package = module.split(".")[0]
        if package in ALLOWED:
            wrong[module] = packages_of(inside(imports_of(file))) - ALLOWED[package] - {package}
    assert {module: names for module, names in wrong.items() if names} == {}, "packages that a module may not import"


@pytest.mark.slow
def test_no_module_imports_itself_through_others() -> None:
    graph = {module_of(file): inside(imports_of(file)) - {module_of(file), ""} for file in FILES}
    tuple(graphlib.TopologicalSorter(graph).static_order())  # Raises CycleError, which names the cycle.


def test_packages_are_at_most_two_levels_deep() -> None:
    assert max(len(file.relative_to(SOURCE).parts) for file in FILES) <= 3


def test_a_module_carries_no_underscore() -> None:
    named = [str(file) for file in FILES if file.name.startswith("_")]
    assert [name for name in named if not name.endswith(("__init__.py", "__main__.py"))] == []


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_is_known_to_few(library: str) -> None:
    others = [file for file in FILES if not {module_of(file), module_of(file).split(".")[0]} & ONLY_IN[library]]
    assert [module_of(file) for file in others if library in {name.split(".")[0] for name in imports_of(file)}] == []


@pytest.mark.parametrize(
    ("text", "modules"),
    [
        ("from ..core.parameter import param", {"core.parameter"}),
        ("from . import model", {"dynamics.model"}),
        ("import snakejax", {""}),
        ("import snakejax.dynamics.signals as g", {"dynamics.signals"}),
        ("def f():\n    from snakejax.effects.tyres import GripSplit", {"effects.tyres"}),
        ("if TYPE_CHECKING:\n    from .model import Model", set()),
        ("import numpy.linalg", set()),
    ],
)
def test_imports_are_found(text: str, modules: set[str]) -> None:
    assert inside(imported(text, ("snakejax", "dynamics"))) == modules


@pytest.mark.slow
def test_import_is_silent_and_sets_no_flag() -> None:
    script = (
        "import importlib, pkgutil, sys\n"
        "import jax\n"
        "before = dict(jax.config.values)\n"
        "import snakejax\n"
        "for module in pkgutil.walk_packages(snakejax.__path__, 'snakejax.'):\n"
        "    if not module.name.endswith('__main__'):\n"
        "        importlib.import_module(module.name)\n"
        "after = dict(jax.config.values)\n"
        "assert not jax.config.jax_enable_x64\n"
        "assert before == after, {k: v for k, v in after.items() if before.get(k) != v}\n"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
