"""Where the files lie that tests read."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
"""The bundled cases."""
SHARED = ROOT.parent / "shared"
"""Data that lie beside the repository and do not travel with it."""


def beside(name: str) -> Path:
    """A folder of `SHARED`; a test that asks for it is skipped where it is not there."""
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"The data are not here: they belong in ../shared/{name}.")
    return folder
