"""Every public name is documented in the code, and stands on the page of its room in the reference."""

import ast
import re

import griffe
import pytest
from helpers.folders import ROOT

SOURCE = ROOT / "src" / "snakejax"
FACES = {
    "core": ("core",),
    "dynamics": ("dynamics",),
    "vehicles": ("vehicles",),
    "effects": ("effects",),
    "simulation": ("simulation",),
    "recording": ("recording",),
    "estimation": ("estimation",),
    "diagnosis": ("diagnosis",),
    "design": ("design",),
    "commands": ("commands",),
    "present": ("present.plot", "present.report", "present.exchange"),
}
"""The page of each room, and the packages whose public names it shows."""


def public_names(package: str) -> set[str]:
    """What `package` offers: `__all__` where it stands, else what is imported as itself (PEP 484), and its data."""
    folder = SOURCE.joinpath(*package.split("."))
    stub = folder / "__init__.pyi"
    body = ast.parse((stub if stub.exists() else folder / "__init__.py").read_text(encoding="utf-8")).body
    data = {n.target.id: n for n in body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)}
    for node in body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    imported = {a.asname for n in body if isinstance(n, ast.ImportFrom) for a in n.names if a.asname == a.name}
    return {name for name in (*imported, *data) if name is not None}


EXPECTED = {
    room: {f"snakejax.{package}.{name}" for package in packages for name in public_names(package)}
    for room, packages in FACES.items()
}


@pytest.fixture(scope="module")
def code() -> griffe.Object | griffe.Alias:
    """The package as the documentation reads it: its source, without importing it."""
    return griffe.load("snakejax", search_paths=[SOURCE.parent])


def test_every_room_has_a_page() -> None:
    rooms = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert rooms == set(FACES) == {path.stem for path in (ROOT / "docs" / "api").glob("*.md")}


@pytest.mark.parametrize("room", FACES)
def test_the_page_shows_every_public_name_and_no_other(room: str) -> None:
    page = (ROOT / "docs" / "api" / f"{room}.md").read_text(encoding="utf-8")
    shown = re.findall(r"^::: (\S+)$", page, flags=re.MULTILINE)
    assert len(shown) == len(set(shown))
    assert set(shown) == EXPECTED[room]


@pytest.mark.parametrize("room", FACES)
def test_every_public_name_is_documented(code: griffe.Object, room: str) -> None:
    """Its own sentence comes first, and ends."""
    for name in sorted(EXPECTED[room]):
        docstring = code[name.removeprefix("snakejax.")].docstring
        assert docstring is not None, f"{name} has no docstring."
        first = docstring.value.split("\n\n")[0].rstrip()
        assert first.endswith((".", ":")), f"The docstring of {name} begins with no whole sentence: {first}"


def test_what_a_public_function_raises_is_in_its_docstring(code: griffe.Object) -> None:
    for name in sorted(set().union(*EXPECTED.values())):
        thing = code[name.removeprefix("snakejax.")]
        if thing.is_function and thing.docstring is not None:
            source = ast.parse(thing.source)
            raised = {ast.unparse(n.exc).split("(")[0] for n in ast.walk(source) if isinstance(n, ast.Raise) and n.exc}
            assert all(error in thing.docstring.value for error in raised), f"{name} raises {', '.join(sorted(raised))}"
