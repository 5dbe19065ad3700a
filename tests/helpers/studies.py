"""The studies of `fit/`, loaded by the path of the file, as a user runs them."""

import importlib.util
from types import ModuleType

from helpers.folders import ROOT


def study(name: str) -> ModuleType:
    """The module of one study of `fit/`."""
    description = importlib.util.spec_from_file_location(f"study_{name}", ROOT / "fit" / f"{name}.py")
    assert description is not None and description.loader is not None
    module = importlib.util.module_from_spec(description)
    description.loader.exec_module(module)
    return module
