"""Python files of the user: effects and objectives."""

import importlib.util
from pathlib import Path
from types import ModuleType

from snakejax.core.errors import InputError


def user_module(path: Path, where: str, example: str) -> ModuleType:
    """The module in the file at `path`; `where` is the option that names it, `example` a valid value of the option.

    **Raises:** `InputError` where there is no such file, or where it cannot be run.
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
        what = f"The file cannot be run ({type(error).__name__}: {error})"
        raise InputError(what, f"{path}{line}", "correct the file") from None
    return module
