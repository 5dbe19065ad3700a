"""Python files of a user's own: an effect, an objective."""

import importlib.util
from pathlib import Path
from types import ModuleType

from .._errors import InputError


def own_module(path: Path, where: str, example: str) -> ModuleType:
    """The module in the file at `path`, which the option `where` names; `example` is how that is written.

    **Raises:** `InputError` where there is none, or where it cannot be run.
    """
    if not path.is_file():
        raise InputError(f"There is no file `{path}`", where, f"name a Python file, as in {example}")
    description = importlib.util.spec_from_file_location(f"_snakejax_own_{path.stem}", path)
    assert description is not None and description.loader is not None
    module = importlib.util.module_from_spec(description)
    try:
        description.loader.exec_module(module)
    except Exception as error:
        line = f" line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"It cannot be run ({type(error).__name__}: {error})", f"{path}{line}", "mend it") from None
    return module
