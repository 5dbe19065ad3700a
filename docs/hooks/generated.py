"""Parts of the documentation that the code itself writes: its commands, its effects, its public names."""

import argparse
import re

import snakejax
from snakejax._cli._main import parser
from snakejax._units import own_parameters
from snakejax.effects import LIBRARY


def on_page_markdown(markdown: str, **_: object) -> str:
    """Put what the code writes in the place of `{{ name }}`."""
    return re.sub(r"\{\{ (\w+) \}\}", lambda found: PARTS[found[1]](), markdown)


def commands() -> str:
    """The help of every command, as a terminal shows it."""
    (choices,) = (a.choices for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    parts = {name: command.format_help().rstrip() for name, command in choices.items()}
    return "\n".join(f"## {name}\n\n```text\n{text}\n```\n" for name, text in parts.items())


def effects() -> str:
    """Every built-in effect: its parameters with their units, and what it is."""
    rows = ["| effect | parameters | what it is |", "|---|---|---|"]
    for name, kind in LIBRARY.items():
        parts = ", ".join(f"`{field}` [{p.domain.unit}]" for field, p in own_parameters(kind()))
        rows.append(f"| `{name}` | {parts} | {kind.sentence} |")
    return "\n".join(rows)


def names() -> str:
    """Every public name with the first sentence of its documentation."""
    rows = ["| name | what it is |", "|---|---|"]
    for name in snakejax.__all__:
        told = " ".join((getattr(snakejax, name).__doc__ or "").split("\n\n")[0].split())
        rows.append(f"| `{name}` | {told.replace('|', chr(92) + '|')} |")
    return "\n".join(rows)


PARTS = {"commands": commands, "effects": effects, "names": names}
