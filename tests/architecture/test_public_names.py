"""Every package shows its public face, and every public name is there."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import snakejax

SOURCE = Path(snakejax.__file__).parent
FACES = sorted(".".join(("snakejax", *stub.relative_to(SOURCE).parts[:-1])) for stub in SOURCE.rglob("__init__.pyi"))


@pytest.mark.parametrize("face", FACES)
def test_a_face_has_every_name_that_it_lists(face: str) -> None:
    module = importlib.import_module(face)
    assert module.__all__ and (module.__doc__ or "").strip()
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        module.nothing  # noqa: B018


def test_public_names_are_no_modules() -> None:
    """A submodule of the name of a function would take its place as soon as it is imported."""
    for face in FACES:
        folder = SOURCE.joinpath(*face.split(".")[1:])
        below = {path.stem for path in folder.iterdir()}
        folders = {path.name for path in folder.iterdir() if path.is_dir()}
        named = set(importlib.import_module(face).__all__) - folders
        assert not named & below, f"{face}: {', '.join(sorted(named & below))}"


def test_looking_at_the_package_does_not_wait_for_jax() -> None:
    script = (
        "import sys, snakejax, snakejax.estimation, snakejax.recording; dir(snakejax); assert 'jax' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0
