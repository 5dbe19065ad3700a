"""Exit statuses, and the one-line error message."""

import os
import sys
import traceback

from snakejax.core.errors import at_line

from ..user_code import place_in_user_code, user_files

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130
"""Exit statuses: of the contract in docs/commands.md, and 128 + SIGINT for an interrupt."""


def complain(error: object, status: int) -> int:
    """Print `error` on standard error in one line and return `status`."""
    if os.environ.get("SNAKEJAX_DEBUG") and isinstance(error, BaseException):
        traceback.print_exception(error)
    print(f"snakejax: error: {' '.join(str(error).split())}", file=sys.stderr)
    return status


def unexpected(error: Exception, where: str = "this command") -> str:
    """The message of an unexpected error."""
    if os.environ.get("SNAKEJAX_DEBUG"):
        traceback.print_exception(error)
    first = (str(error).strip().splitlines() or [""])[0][:200]
    what, debug = f"{type(error).__name__}: {first}", "set SNAKEJAX_DEBUG=1 for the traceback"
    if (place := place_in_user_code(error)) is not None:
        return f"{what}, {at_line(*place)}: correct the file; {debug}"
    whose = " or ".join(["snakejax", *user_files()])
    return f"{what}, {where}: a bug in {whose}; {debug}"
