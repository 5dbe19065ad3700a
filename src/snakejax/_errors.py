"""What can go wrong: the one sentence form for every complaint about a user's input, and fits that cannot succeed."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """An input that cannot be used: `WHAT is wrong, WHERE: how to mend it`, on one line of printable signs.

    **Arguments:** `what` is wrong; `where`: the file and line, the run, or the option; `remedy`: how to mend it.
    """

    def __init__(self, what: str, where: str, remedy: str) -> None:
        super().__init__(what, where, remedy)
        self.what, self.where, self.remedy = what, where, remedy

    def __str__(self) -> str:
        # A damaged file may hold what a terminal would obey.
        line = " ".join(f"{self.what}, {self.where}: {self.remedy}".split())
        return "".join(sign if sign.isprintable() else "?" for sign in line)


class FitError(RuntimeError):
    """A fit that cannot succeed: which parameter or run, and why. One line."""


def at_line(path: object, line: int) -> str:
    """`FILE line N`, as complaints name a place."""
    return f"{path} line {line}"


def instead_of(word: str, known: Iterable[str]) -> str:
    """The remedy for an unknown `word`: the nearest known one where something is near, and all of them."""
    known = list(known)
    close = difflib.get_close_matches(word, known, 1, cutoff=0.5)
    listed = f"known: {', '.join(known) or 'none'}"
    return f'write "{close[0]}" ({listed})' if close else f"remove it or write one that is known ({listed})"
