"""What all text readers share: decoding, separators, and single cells."""

import math
import re

from snakejax.core.errors import InputError
from snakejax.core.text_files import LARGEST

_SEPARATOR = re.compile(r"sep=[,;\t]?", re.IGNORECASE)


def separator_of(text: str) -> tuple[str, str]:
    """What divides the cells of a table, and its decimal mark: in a table divided by `;` a comma is one too."""
    head = text[:200_000]
    counts = {mark: head.count(mark) for mark in ",;\t"}
    if counts["\t"] > max(counts[","] // 2, counts[";"]):
        # With tabs, commas are decimal marks wherever one stands between two digits.
        return "\t", "," if re.search(r"[\t\n]-?\d+,\d", head) else "."
    return (";", ",") if counts[";"] > counts[","] // 2 else (",", ".")


def split(line: str, separator: str) -> list[str]:
    """The cells of a line, without spaces or quotes around them."""
    return [cell.strip(' \t"') for cell in line.split(separator)]


def is_blank(line: str) -> bool:
    """Whether no cell of the line holds anything."""
    return not line.strip(' \t,;"')


def is_comment(line: str) -> bool:
    """Whether no table begins with `line`: it is blank, or a comment, or tells Excel the separator, as `sep=;` does."""
    return is_blank(line) or line.startswith("#") or bool(_SEPARATOR.fullmatch(line.strip(' "')))


def number(cell: str, name: str, where: str, decimal: str = ".") -> float:
    """The finite number in a cell, or NaN for a blank one.

    **Raises:** `InputError` for anything else, "nan" and "inf" among it, and numbers that no recording can hold.
    """
    if not cell:
        return math.nan
    try:
        value = float(cell.replace(decimal, ".").replace("_", "?"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        remedy = "write a finite number, or leave the cells of a lost frame blank"
        raise InputError(f'"{shown(cell)}" for {shown(name)} is not a finite number', where, remedy)
    if abs(value) > LARGEST:
        raise InputError(f'"{shown(cell)}" for {shown(name)} is too large', where, "correct it, or leave it blank")
    return value


def shown(text: str, length: int = 40) -> str:
    """`text` cut short for a complaint."""
    return text if len(text) <= length else f"{text[:length]}..."
