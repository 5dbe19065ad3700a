"""Parts of the documentation that the code itself writes: its commands, its effects, its public names."""

import argparse
import inspect
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

from effect_pictures import picture
from joint_pictures import joints
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from notebook_pages import notebook_pages

import snakejax
from snakejax.commands.cli.main import parser
from snakejax.core.parameter import Domain, own_parameters
from snakejax.dynamics.ports import Effect
from snakejax.effects import LIBRARY


def on_startup(**_: object) -> None:
    """Calculate in double precision, as the program does."""
    snakejax.prepare_jax()


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pictures that are drawn from the code at every build, and the pages of the notebooks."""
    for name in LIBRARY:
        files.append(File.generated(config, f"effects/{name}.svg", content=picture(name)))
    files.append(File.generated(config, "joints.svg", content=joints()))
    for page in notebook_pages(config):
        files.append(page)


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replace each `{{ name }}` by the part of that name."""
    return re.sub(r"\{\{ (\w+) \}\}", lambda match: PARTS[match[1]](), markdown)


def commands() -> str:
    """The help of every command, as a terminal shows it."""
    (choices,) = (a.choices for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    parts = {name: command.format_help().rstrip() for name, command in choices.items()}
    return "\n".join(f"## {name}\n\n```text\n{text}\n```\n" for name, text in parts.items())


def effects() -> str:
    """Every built-in effect: what it is, its formula and sign, its parameters with their units, and its picture."""
    return "\n".join(section(name, kind) for name, kind in LIBRARY.items())


def section(name: str, kind: type[Effect]) -> str:
    """The part of the page of effects about one of them."""
    rows = "".join(
        f"| `{field}` | {p.domain.unit} | {domain(p.domain)} | {float(p.value):g} |\n"
        for field, p in own_parameters(kind())
    )
    table = f"| parameter | unit | domain | neutral |\n|---|---|---|---|\n{rows}"
    shown = f"![What {name} changes, drawn from its code.](effects/{name}.svg)"
    return f"### `{name}`\n\n{kind.description}\n\n{inspect.getdoc(kind)}\n\n{table}\n{shown}\n"


def domain(of: Domain) -> str:
    """The values that a parameter may have."""
    low, high = (f"{end:g}" for end in (of.low, of.high))
    return {("-inf", "inf"): "any", ("0", "inf"): "0 or more"}.get((low, high)) or (
        f"{low} or more" if high == "inf" else f"{low} to {high}"
    )


MEASURES = {
    "mass_kg": ("mass of the whole board, with rotor, wheelsets, battery and cable", "scales"),
    "inertia_kgm2": ("yaw inertia of the whole board", "a pendulum"),
    "rotor_inertia_kgm2": ("inertia of the rotor about its axis", "a pendulum"),
    "half_length_m": ("half the distance between the pivots of the wheelsets", "calliper or ruler"),
    "wheelset_inertia_kgm2": ("inertia of one wheelset about its pivot", "the drawing"),
}


def measures() -> str:
    """What to measure on the board, and the error of a fit with a wrong measure, from `fit/measures.py`."""
    study = json.loads((Path(__file__).parents[1] / "measures.json").read_text(encoding="utf-8"))
    percent = f"{100 * study['error']:g}%"
    rows = ["| key | what | how | train runs | held-out runs |", "|---|---|---|---|---|"]
    for key, (what, how) in MEASURES.items():
        rows.append(f"| `{key}` | {what} | {how} | {left(study['measures'][key])} |")
    right, together = study["measures"]["none"], study["measures"]["mass and both inertias"]
    ratio = together["tyre"]["D"]["value"] / right["tyre"]["D"]["value"] - 1
    rows += [f"| none of them | | | {left(right)} |", f"| mass and both inertias | | | {left(together)} |"]
    return "\n".join(rows) + (
        f"\n\nThe last two columns show the error of a fit to `data/{study['case']}` in which this measure is {percent}"
        " too large, in multiples of the noise; `fit/measures.py` computes them."
        f" In the last row `D` is {100 * ratio:.1f}% larger."
    )


def left(row: dict[str, Any]) -> str:
    """The errors that a fit leaves on train and held-out runs, as two cells."""
    return " | ".join(f"{row[role]['misfit'] ** 0.5:.2f}" for role in ("train", "heldout"))


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


PARTS = {"commands": commands, "effects": effects, "measures": measures, "names": names}
