"""Texts of options, as the command line and Python functions take them. This module does not need JAX."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from snakejax.core.errors import InputError

USUAL_THRESHOLD = 3.0
"""Threshold of Huber's loss in standard deviations: of normal noise 0.3% of the samples lie beyond it."""


class EffectSpec(NamedTuple):
    """One effect of an option; `source` is its file and class, None for a built-in effect."""

    name: str
    source: tuple[Path, str] | None
    values: dict[str, float]


def effect_spec(text: str, option: str = "option --effect") -> EffectSpec:
    """`NAME`, `NAME:p=v,...`, `FILE.py:Class` or `FILE.py:Class:p=v,...`."""
    own = re.fullmatch(r"(?P<file>.+\.py):(?P<name>\w+)(:(?P<values>.*))?", text)
    if own is not None:
        values = assignments(own["values"] or "", option)
        return EffectSpec(snake_case(own["name"]), (Path(own["file"]), own["name"]), values)
    if text.endswith(".py"):
        raise InputError(f"`{text}` does not name a class", option, f"write {text}:Class")
    name, _, values = text.partition(":")
    return EffectSpec(name, None, assignments(values, option))


def snake_case(name: str) -> str:
    """The name of an effect from that of its class: `CableSpring` gives `cable_spring`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def assignments(text: str, where: str) -> dict[str, float]:
    """`B=6,C=1.4` as a dictionary. **Raises:** `InputError`."""
    values: dict[str, float] = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals):
            raise InputError(f"`{part}` is not NAME=NUMBER", where, "write NAME=NUMBER, as in B=6,C=1.4")
        if name in values:
            raise InputError(f"`{name}` is given twice", where, "give it once")
        values[name] = finite(value, where, f"`{part}`")
    return values


def finite(text: str, where: str, what: str) -> float:
    """A finite number. **Raises:** `InputError`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{what} does not contain a finite number", where, "write a number such as 0.25")
    return value


def numbers_by_name(given: Mapping[str, float] | str | Sequence[str] | None, where: str) -> dict[str, float]:
    """`{"B": 6.0}`, `"B=6,C=1.4"` or a list of such texts as a dictionary. **Raises:** `InputError`."""
    if isinstance(given, Mapping):
        return {name: finite(str(value), where, f"`{name}={value}`") for name, value in given.items()}
    return assignments(given if isinstance(given, str) else ",".join(given or ()), where)


def names(given: str | Sequence[str] | None) -> list[str] | None:
    """`"B,C"` or `["B", "C"]` as a list."""
    if given is None:
        return None
    return [name.strip() for name in given.split(",") if name.strip()] if isinstance(given, str) else [*given]


def threshold(given: str | float | bool | None) -> float:
    """The threshold of `robust` in standard deviations of the noise: inf where it is not given, 3 for True or ""."""
    if given is None or given is False:
        return math.inf
    usual = given is True or given == ""
    value = USUAL_THRESHOLD if usual else finite(str(given), "option --robust", f"`{given}`")
    if value <= 0:
        raise InputError(
            f"The threshold {value:g} is not positive", "option --robust", "give a number above 0, such as 3"
        )
    return value
