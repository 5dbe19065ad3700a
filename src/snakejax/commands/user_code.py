"""Python files of the user: effects and objectives."""

import importlib.util
import sys
import traceback
from pathlib import Path
from types import FrameType, ModuleType

from snakejax.core.errors import InputError

PREFIX = "_snakejax_own_"
"""Modules with this prefix are files of the user."""


def user_module(path: Path, where: str, example: str) -> ModuleType:
    """The module in the file at `path`; `where` is the option that names it, `example` a valid value of the option.

    **Raises:** `InputError` where there is no such file, or where it cannot be run.
    """
    if not path.is_file():
        raise InputError(f"There is no file `{path}`", where, f"name a Python file, as in {example}")
    description = importlib.util.spec_from_file_location(f"{PREFIX}{path.stem}", path)
    assert description is not None and description.loader is not None
    module = sys.modules[description.name] = importlib.util.module_from_spec(description)
    try:
        description.loader.exec_module(module)
    except Exception as error:
        del sys.modules[description.name]
        line = f" line {error.lineno}" if isinstance(error, SyntaxError) else ""
        what = f"The file cannot be run ({type(error).__name__}: {error})"
        raise InputError(what, f"{path}{line}", "correct the file") from None
    return module


def user_files() -> list[str]:
    """The files of the user that were run so far."""
    return [str(module.__file__) for name, module in sys.modules.items() if name.startswith(PREFIX)]


def place_in_user_code(error: BaseException) -> tuple[str, int] | None:
    """File and line of the last call in a file of the user before `error` was raised; None where there is none."""
    frames = traceback.walk_tb(error.__traceback__)
    own = [(str(frame.f_globals["__file__"]), line) for frame, line in frames if _is_own(frame)]
    return own[-1] if own else None


def _is_own(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).startswith(PREFIX)
