"""Parts of the documentation that the code itself writes: its commands, its effects, its public names."""

import argparse
import inspect
import re
from types import ModuleType

import snakejax
from snakejax.cli.main import parser
from snakejax.core.parameter import own_parameters
from snakejax.effects import LIBRARY


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replace each `{{ name }}` by the part of that name."""
    return re.sub(r"\{\{ (\w+) \}\}", lambda match: PARTS[match[1]](), markdown)


def commands() -> str:
    """The help of every command, as a terminal shows it."""
    (choices,) = (a.choices for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    parts = {name: command.format_help().rstrip() for name, command in choices.items()}
    return "\n".join(f"## {name}\n\n```text\n{text}\n```\n" for name, text in parts.items())


def effects() -> str:
    """Every built-in effect: its parameters with their units, what it is, and its documentation with the signs."""
    rows = ["| effect | parameters | what it is | definition |", "|---|---|---|---|"]
    for name, kind in LIBRARY.items():
        parts = ", ".join(f"`{field}` [{p.domain.unit}]" for field, p in own_parameters(kind()))
        rows.append(f"| `{name}` | {parts} | {kind.description} | {cell(' '.join((kind.__doc__ or '').split()))} |")
    return "\n".join(rows)


def names() -> str:
    """Every name of `snakejax` itself, with the first paragraph of its documentation and a link to the whole."""
    packages = {n: part for n in snakejax.__all__ if isinstance(part := getattr(snakejax, n), ModuleType)}
    rows = ["| name | what it is |", "|---|---|"]
    for name in snakejax.__all__:
        if name not in packages:
            room = next(room for room, part in packages.items() if name in getattr(part, "__all__", ()))
            rows.append(row(name, getattr(snakejax, name), f"api/{room}.md#snakejax.{room}.{name}"))
    return "\n".join(rows)


def row(name: str, part: object, target: str) -> str:
    """A line of the table of names, linked to `target`; functions with the names of their arguments."""
    arguments = f"({', '.join(inspect.signature(part).parameters)})" if inspect.isfunction(part) else ""
    return f"| [`{name}{arguments}`]({target}) | {cell(first_paragraph(part))} |"


def first_paragraph(part: object) -> str:
    """The first paragraph of a documentation; none for data, whose documentation is that of its class."""
    own = isinstance(part, type | ModuleType) or inspect.isroutine(part)
    return " ".join((part.__doc__ or "").split("\n\n")[0].split()) if own else ""


def cell(text: str) -> str:
    """`text` for a cell of a table: bars outside of code would end the cell."""
    return "`".join(t if k % 2 else t.replace("|", r"\|") for k, t in enumerate(text.split("`")))


PARTS = {"commands": commands, "effects": effects, "names": names}
