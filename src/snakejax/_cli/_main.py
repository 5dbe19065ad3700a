"""The parser, and the one line that every failure becomes."""

import argparse
import os
import re
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from .._errors import InputError
from . import check, compare, completion, diagnose, explain, fit, importing, new, simulate, sweep, tune
from ._interrupt import persistent_interrupt
from ._options import Formatter

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130
COMMANDS = (check, new, importing, fit, compare, diagnose, explain, simulate, sweep, tune, completion)

_EXAMPLES = """\
examples:
  snakejax check data/level-board
  snakejax fit data/level-board --out out
  snakejax simulate paper-rotate --csv out
"""


class _Parser(argparse.ArgumentParser):
    """A parser that complains as everything else here does."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message, "command line", f"see `{self.prog} --help`")


def parser() -> argparse.ArgumentParser:
    """The parser of every command."""
    top = _Parser(
        prog="snakejax",
        description="Simulate a skidding snakeboard, fit its tyres to recordings,\nand see where the two disagree.",
        epilog=_EXAMPLES,
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    top.add_argument("--version", action=_Version, nargs=0, help="show the version and end")
    commands = top.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return top


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        import importlib.metadata

        print(f"snakejax {importlib.metadata.version('snakejax')}")
        parser.exit()


def prepared(arguments: Sequence[str]) -> list[str]:
    """`arguments` as argparse needs them: it takes `-1,0,0` for an option, and a CASE for the value of `--robust`."""
    found: list[str] = []
    waiting = list(arguments)
    while waiting:
        word, *waiting = waiting
        following = waiting[0] if waiting else ""
        if word == "--start" and re.match(r"-[\d.]", following):
            word, waiting = f"{word}={following}", waiting[1:]
        elif word == "--robust" and not re.fullmatch(r"[\d.eE+-]+", following):
            word = "--robust="
        found.append(word)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `snakejax`; the exit status. No failure shows a traceback, unless SNAKEJAX_DEBUG is set."""
    try:
        with persistent_interrupt():
            options = parser().parse_args(prepared(sys.argv[1:] if arguments is None else arguments))
            return options.run(options)
    except SystemExit as done:
        return int(done.code or DONE)
    except InputError as error:
        return complain(error, WRONG)
    except KeyboardInterrupt:
        status = complain("Interrupted, what was finished is kept: run it again for the rest", INTERRUPTED)
        if arguments is None:
            # The program ends here: a computation may still run, and must not find the interpreter half taken down.
            sys.stdout.flush()
            os._exit(status)
        return status
    except BrokenPipeError:
        # The reader of our output went away; what Python still holds for it must not raise once more at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        return complain(unexpected(error), FAILED)


def complain(error: object, status: int) -> int:
    """Say what is wrong on standard error, in one line; `status`."""
    if os.environ.get("SNAKEJAX_DEBUG") and isinstance(error, BaseException):
        traceback.print_exception(error)
    print(f"snakejax: error: {' '.join(str(error).split())}", file=sys.stderr)
    return status


def unexpected(error: Exception, where: str = "this command") -> str:
    """What to say of an error that nobody foresaw."""
    if os.environ.get("SNAKEJAX_DEBUG"):
        traceback.print_exception(error)
    first = (str(error).strip().splitlines() or [""])[0][:200]
    return f"{type(error).__name__}: {first}, {where}: a fault of snakejax; set SNAKEJAX_DEBUG=1 to see where"
