"""Errors: the one-line form of errors in a user's input, and fits that fail."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """An unusable input, reported as `WHAT is wrong, WHERE: remedy` on one line of printable characters.

    **Arguments:** `what`: the fault; `where`: the file and line, the run, or the option; `remedy`: how to correct it.
    """

    def __init__(self, what: str, where: str, remedy: str) -> None:
        super().__init__(what, where, remedy)
        self.what, self.where, self.remedy = what, where, remedy

    def __str__(self) -> str:
        # Text from a damaged file may contain control sequences of a terminal.
        line = " ".join(f"{self.what}, {self.where}: {self.remedy}".split())
        return "".join(sign if sign.isprintable() else "?" for sign in line)


class FitError(RuntimeError):
    """A fit that fails: one line with the parameter or run and the reason."""


def at_line(path: object, line: int) -> str:
    """`FILE line N`, the form in which errors name a place."""
    return f"{path} line {line}"


def instead_of(word: str, known: Iterable[str]) -> str:
    """The remedy for an unknown `word`: the most similar of the `known` ones, if any, and a list of all."""
    known = list(known)
    close = difflib.get_close_matches(word, known, 1, cutoff=0.5)
    listed = f"known: {', '.join(known) or 'none'}"
    return f'write "{close[0]}" ({listed})' if close else f"remove it or write one that is known ({listed})"
