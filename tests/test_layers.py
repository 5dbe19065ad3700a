"""The order of the modules: each may import only what stands before it, so that every room can be read by itself."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "snakejax"

# From the bottom up. A package (`effects`, `readers`) is one place in the order; its files may share among themselves.
# fmt: off
ORDER = [
    "_prepare", "_errors", "_units", "_math", "_tyre", "_board", "_gait", "_recording", "_whitening", "_batch",
    "_effect", "_skid", "_model", "_simulate", "_lanes", "_marquardt", "_least_squares", "_study", "effects",
    "readers", "quality", "_toml",
    "_hints", "_case", "_presets", "_check", "_template", "_understand", "_import", "_pieces", "_cluster", "_sweep",
    "_rayleigh", "_windows", "_starting", "_misfit", "_estimates", "_approach", "_fit", "_profile",
    "_log_clocks", "_window_clocks", "_replay", "_log_noise",
    "_align", "_scenes", "_grip", "_stretches", "_whiteness", "_shares", "_compare", "_score", "_sight",
    "_bench", "_refit", "_prospects", "_accomplices", "_rank", "_free_force", "_driven", "_process", "_drive",
    "_dependence", "_missing", "_starter",
    "_acceptance", "_stage", "_diagnose", "_follow", "_explain", "_shapes", "_limits", "_torque", "_objective", "_ran",
    "_draws", "_descend", "_task", "_tune", "_apart", "_bed", "_discriminate", "_files", "_json", "_provenance",
    "_results", "_saved", "_text", "_story", "_tuned", "_palette", "_played", "plot", "report", "_cli", "__main__",
    "__init__",
]
# fmt: on
CORE = ORDER[: ORDER.index("effects")]
ONLY_IN = {
    "diffrax": {"_simulate", "_lanes"},
    "optimistix": {"_marquardt", "_rayleigh", "_tune"},
    "distributed": {"_cluster"},
}

FILES = sorted(SOURCE.rglob("*.py"))
each_file = pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))


def place(file: Path) -> str:
    """Where `file` stands in the order: `_fit.py` at `_fit`, `effects/tyres.py` at `effects`."""
    return file.relative_to(SOURCE).with_suffix("").parts[0]


def run_time(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes below `tree`, without what only a type checker sees: it may look up, to name a type."""
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
            # `from . import plot` names a module where there is one of that name, and otherwise the package's face.
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


def imported_places(text: str, package: tuple[str, ...]) -> set[str]:
    """The places in the order that `text` imports from."""
    inside = [name.split(".") for name in imported(text, package) if name.split(".")[0] == "snakejax"]
    known = {place(file) for file in FILES} | set(ORDER)
    return {parts[1] if len(parts) > 1 and parts[1] in known else "__init__" for parts in inside}


def imports_of(file: Path) -> tuple[str, tuple[str, ...]]:
    return file.read_text(encoding="utf-8"), ("snakejax", *file.relative_to(SOURCE).parts[:-1])


@each_file
def test_a_module_has_its_place(file: Path) -> None:
    assert place(file) in ORDER, f"`{place(file)}` is not in ORDER of {__file__}: add it where it belongs."


@each_file
def test_imports_point_down(file: Path) -> None:
    here = place(file)
    if here not in ORDER:
        pytest.skip("It has no place yet, which another test says.")
    allowed = set(ORDER[: ORDER.index(here)]) | ({here} if (SOURCE / here).is_dir() else set())
    upward = imported_places(*imports_of(file)) - allowed
    assert not upward, f"{here} imports {', '.join(sorted(upward))}, which must not stand before it in ORDER."


@each_file
def test_the_core_knows_no_effect(file: Path) -> None:
    if place(file) in CORE:
        assert "effects" not in imported_places(*imports_of(file)), "Candidates are arguments: the core names none."


@each_file
@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_is_known_to_few(file: Path, library: str) -> None:
    if place(file) not in ONLY_IN[library]:
        roots = {name.split(".")[0] for name in imported(*imports_of(file))}
        assert library not in roots, f"Only {', '.join(sorted(ONLY_IN[library]))} may import {library}."


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("from ._units import param", {"_units"}),
        ("from . import _fit, fit", {"_fit", "__init__"}),
        ("import snakejax", {"__init__"}),
        ("import snakejax._gait as g", {"_gait"}),
        ("def f():\n    from snakejax.effects.tyres import GripSplit", {"effects"}),
        ("if TYPE_CHECKING:\n    from ._model import Model", set()),
        ("import numpy.linalg", set()),
    ],
)
def test_imports_are_found(text: str, places: set[str]) -> None:
    assert imported_places(text, ("snakejax",)) == places


def test_imports_are_found_from_within_a_package() -> None:
    assert imported_places("from .._model import Model", ("snakejax", "effects")) == {"_model"}
    assert imported_places("from ._text import rows", ("snakejax", "readers")) == {"readers"}


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
