"""The command line parser; every failure is reported in one line."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

from snakejax.core.errors import InputError, instead_of

from . import check, compare, completion, design, diagnose, explain, fit, importing, new, predict, simulate, sweep, tune
from .exit_status import DONE, FAILED, INTERRUPTED, WRONG, complain, unexpected
from .interrupt import PersistentInterrupt
from .options import Formatter, add_command

COMMANDS = (check, new, importing, fit, compare, diagnose, explain, predict, simulate, sweep, tune, design, completion)

_EXAMPLES = """\
examples:
  snakejax check data/level-board
  snakejax fit data/level-board --out out
  snakejax simulate paper-rotate --csv out
"""


RENAMED = {"separate": "design"}
"""Commands under the name that they, or their objective, once had."""


def _no_command(name: str, known: Iterable[str]) -> InputError:
    remedy = f'write "{RENAMED[name]}"' if name in RENAMED else instead_of(name, known)
    return InputError(f"There is no command `{name}`", "argument COMMAND", remedy)


def _no_option(command: str, word: str, known: Sequence[str]) -> InputError:
    if word.startswith("--"):
        remedy = instead_of(word, [option for option in known if option.startswith("--")])
    else:  # A letter is like no word: the first option that begins with it.
        letter = word[1].lower()
        remedy = instead_of(next((o for o in known if o.lstrip("-").lower().startswith(letter)), ""), known)
    return InputError(f"`{command}` has no option `{word}`", "command line", remedy)


class _Parser(argparse.ArgumentParser):
    """A parser that reports errors as `InputError`."""

    def error(self, message: str) -> NoReturn:
        missing = re.fullmatch(r"the following arguments are required: (.+)", message)
        if missing:
            names = missing[1].replace(", ", " ")
            what, remedy = f"`{self.prog}` was called without {names}", f"write `{self.prog} {names}`, see its --help"
            raise InputError(what, "command line", remedy)
        raise InputError(message, "command line", f"see `{self.prog} --help`")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """As argparse does. **Raises:** `InputError` for an unknown value, with the one that was meant."""
        if action.choices is None or value in action.choices:
            return
        if isinstance(action, argparse._SubParsersAction):
            raise _no_command(str(value), action.choices)
        name = "/".join(action.option_strings) or str(action.metavar or action.dest).upper()
        where = f"{'option' if action.option_strings else 'argument'} {name}"
        raise InputError(f"`{value}` is not a value of {name}", where, instead_of(str(value), map(str, action.choices)))

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[override]
        """As argparse does. **Raises:** `InputError` for an unknown option, with the one that was meant."""
        known, rest = super().parse_known_args(args, namespace)
        unknown = next((word.partition("=")[0] for word in rest if word.startswith("-") and word != "-"), None)
        if unknown is not None:
            shown = (action for action in self._actions if action.help is not argparse.SUPPRESS)
            raise _no_option(self.prog, unknown, [option for action in shown for option in action.option_strings])
        return known, rest


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    top = _Parser(
        prog="snakejax",
        description="Simulate wheeled vehicles that skid, such as the snakeboard, fit their tyre\n"
        "parameters to recordings, and find where model and recordings disagree.",
        epilog=_EXAMPLES,
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    top.add_argument("-V", "--version", action=_Version, nargs=0, help="print the version and exit")
    commands = top.add_subparsers(title="commands", dest="command", metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    commands.choices["completion"].set_defaults(program=top)
    top.set_defaults(run=_overview(top))
    _add_help(commands, top)
    return top


def _overview(top: argparse.ArgumentParser) -> Callable[[argparse.Namespace], int]:
    def run(_: argparse.Namespace) -> int:
        top.print_help()
        return DONE

    return run


def _add_help(commands: Any, top: argparse.ArgumentParser) -> None:
    """`help`, which prints the help of another command."""
    others = dict(commands.choices)

    def run(options: argparse.Namespace) -> int:
        name = options.about
        if name is not None and name not in others:
            raise _no_command(name, others)
        (top if name is None else others[name]).print_help()
        return DONE

    command = add_command(
        commands, "help", run, "print the help of a command", "Print the help of a command.", "snakejax help fit"
    )
    command.add_argument("about", nargs="?", metavar="COMMAND", help="the command (default: all of them)")


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        import importlib.metadata

        print(f"snakejax {importlib.metadata.version('snakejax')}")
        parser.exit()


def prepared(arguments: Sequence[str]) -> list[str]:
    """`arguments` with `--start` and `--robust` joined to their values.

    argparse would read `-1,0,0` as an option, and a CASE after `--robust` as its value.
    """
    words: list[str] = []
    waiting = list(arguments)
    while waiting:
        word, *waiting = waiting
        following = waiting[0] if waiting else ""
        if word == "--start" and re.match(r"-[\d.]", following):
            word, waiting = f"{word}={following}", waiting[1:]
        elif word == "--robust" and not _is_number(following):
            word = "--robust="
        words.append(word)
    return words


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `snakejax` and return the exit status. Tracebacks are shown only where SNAKEJAX_DEBUG is set."""
    interrupt = PersistentInterrupt()
    try:
        with interrupt:
            options = parser().parse_args(prepared(sys.argv[1:] if arguments is None else arguments))
            return options.run(options)
    except SystemExit as done:
        return int(done.code or DONE)
    except InputError as error:
        return complain(error, WRONG)
    except KeyboardInterrupt:
        return _interrupted(arguments is None)
    except BrokenPipeError:
        # The reader closed the pipe; flushing the rest at exit must not raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        # A library that is being imported makes an ImportError of an interrupt.
        if interrupt.requested:
            return _interrupted(arguments is None)
        return complain(unexpected(error), FAILED)


def _interrupted(at_once: bool) -> int:
    """The line about an interrupt. `at_once` ends the process: a computation that still runs in a thread would fail
    during the interpreter's shutdown."""
    status = complain(
        "Interrupted. `explain` and `sweep` with --out keep their finished parts: run the same command again to compute"
        " the rest",
        INTERRUPTED,
    )
    if at_once:
        sys.stdout.flush()
        os._exit(status)
    return status
