"""What is found in many runs, told once."""

from collections.abc import Hashable, Sequence
from typing import Protocol, Self, TypeVar

ALIKE = 3
"""What is found in more runs than these is told once."""


class Told(Protocol):
    """Something found in `run`: `what` says it, and `alike` is what it has in common with what is told together."""

    @property
    def run(self) -> str | None: ...

    @property
    def what(self) -> str: ...

    @property
    def alike(self) -> Hashable: ...

    def _replace(self, *, what: str) -> Self: ...


One = TypeVar("One", bound=Told)


def in_brief(entries: Sequence[One]) -> list[One]:
    """Of what is alike in more than `ALIKE` runs the first, with the number of the runs; all else as it is."""
    groups: dict[Hashable, list[One]] = {}
    for one in entries:
        groups.setdefault(one.alike, []).append(one)
    brief = []
    for one in entries:
        group = groups[one.alike]
        runs = len({other.run for other in group})
        if runs <= ALIKE:
            brief.append(one)
        elif one is group[0]:
            brief.append(one._replace(what=f"{one.what}; alike in {runs - 1} more runs"))
    return brief
