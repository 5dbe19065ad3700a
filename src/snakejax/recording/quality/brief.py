"""Messages that are alike in many runs are shortened to one."""

from collections.abc import Hashable, Sequence
from typing import Protocol, Self, TypeVar

ALIKE = 3
"""Messages that are alike in more runs than these are shortened to one."""


class RunMessage(Protocol):
    """The message `what` about `run`; messages with the same `alike` are shortened to one."""

    @property
    def run(self) -> str | None: ...

    @property
    def what(self) -> str: ...

    @property
    def alike(self) -> Hashable: ...

    def _replace(self, *, what: str) -> Self: ...


One = TypeVar("One", bound=RunMessage)


def in_brief(entries: Sequence[One]) -> list[One]:
    """`entries`, but of those that are alike in more than `ALIKE` runs only the first, with the number of runs."""
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
