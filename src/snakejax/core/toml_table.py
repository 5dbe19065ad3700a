"""TOML tables with their line numbers, so that an error about a key names its line."""

import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from .errors import InputError, at_line, instead_of
from .parameter import Domain
from .text_files import read_text

TO_FILL_IN = "?"
"""Placeholder in a template for a value that the user has to write."""
_UNFILLED = re.compile(r"""([\w-]+)['"]?\s*=\s*["']\?["']""")
_COMMENT = re.compile(r"""#(?=(?:[^"']|"[^"]*"|'[^']*')*$).*""")
_HEADER = re.compile(r"""\s*\[\[?\s*(["'A-Za-z_][^\]]*?)\s*\]""")


class Table(NamedTuple):
    """A table of a TOML file, named `label` in errors, in the lines `first` to `last` (counted from 1) of `lines`."""

    values: dict[str, Any]
    label: str
    path: Path
    lines: list[str]
    first: int
    last: int

    def where(self, key: str) -> str:
        """The file and line of `key`, or of this table if the key is missing."""
        return at_line(self.path, self._line(key) or self.first)

    def _line(self, key: str) -> int | None:
        pattern = re.compile(rf"""(^|[\s{{,.\['"]){re.escape(key)}['"]?\s*[=.\]]""")
        for line in range(self.first, self.last + 1):
            if pattern.search(self.lines[line - 1].split("#")[0]):
                return line
        return None

    def error(self, key: str, what: str, remedy: str) -> InputError:
        """The error "`key` in ... `what`", with `what` such as `must be a string`."""
        return InputError(f"{key} in {self.label} {what}", self.where(key), remedy)

    def require_known(self, known: Iterable[str]) -> None:
        """Check the keys. **Raises:** `InputError` with the most similar known key if this table has an unknown one."""
        for key in self.values:
            if key not in known:
                raise InputError(f'Unknown key "{key}" in {self.label}', self.where(key), instead_of(key, known))

    def get(self, key: str, example: str) -> Any:
        """The value of `key`; `example` shows how to write it. **Raises:** `InputError` if it is missing."""
        if key not in self.values:
            raise InputError(f"Missing key {key} in {self.label}", at_line(self.path, self.first), f"add {example}")
        return self.values[key]

    def text(self, key: str, example: str) -> str:
        """The nonempty string at `key`. **Raises:** `InputError` if it is missing or not a string."""
        value = self.get(key, example)
        if not isinstance(value, str) or not value:
            raise self.error(key, "must be a string", f"write {example}")
        return value

    def texts(self, key: str, example: str) -> dict[str, str]:
        """The table of strings at `key`. **Raises:** `InputError` if it is missing or has another value."""
        table = self.table(key, example)
        return {name: table.text(name, f'{name} = "..."') for name in table.values}

    def choice(self, key: str, options: tuple[str, ...]) -> str:
        """The string at `key`. **Raises:** `InputError` if it is missing or not one of `options`."""
        value = self.get(key, f'{key} = "{options[0]}"')
        if value not in options:
            raise self.error(key, f"cannot be {value!r}", instead_of(str(value), options))
        return value

    def number(self, key: str, domain: Domain) -> float:
        """The number at `key`. **Raises:** `InputError` if it is missing, not a number, or outside `domain`."""
        value = self.get(key, f"{key} = a number in {domain.unit}")
        if not _is_number(value):
            raise self.error(key, "must be a number", f"write it in {domain.unit}, without quotes")
        if why := domain.complaint(float(value)):
            raise self.error(key, f"{why}, but is {value:g}", f"write the value in {domain.unit}")
        return float(value)

    def numbers(self, key: str, columns: int, example: str) -> list[list[float]]:
        """The list of rows of `columns` finite numbers at `key`. **Raises:** `InputError` if it is anything else."""
        rows = self.get(key, example)
        if not (isinstance(rows, list) and all(_is_vector(row, columns) for row in rows)):
            raise self.error(key, f"must be a list of lists of {columns} finite numbers", f"write {example}")
        return rows

    def vector(self, key: str, length: int, example: str) -> list[float]:
        """The list of `length` finite numbers at `key`. **Raises:** `InputError` if it is anything else."""
        row = self.get(key, example)
        if not _is_vector(row, length):
            raise self.error(key, f"must be a list of {length} finite numbers", f"write {example}")
        return row

    def table(self, key: str, example: str) -> "Table":
        """The table at `key`. **Raises:** `InputError` if it is missing or not a table."""
        value = self.get(key, example)
        if not isinstance(value, dict):
            raise self.error(key, "must be a table", f"write {example}")
        if self.label != "the case":
            line = self._line(key) or self.first
            return Table(value, f"{key} of {self.label}", self.path, self.lines, line, self.last)
        return self._below(value, f"[{key}]", key, 0)

    def tables(self, key: str, example: str) -> list["Table"]:
        """The tables of the array at `key`. **Raises:** `InputError` if it is not an array of at least one table."""
        values = self.get(key, example)
        if not isinstance(values, list) or not values or not all(isinstance(value, dict) for value in values):
            raise self.error(key, "must be an array of tables", f"write {example}")
        return [self._below(value, f"[[{key}]] {i + 1}", key, i) for i, value in enumerate(values)]

    def _below(self, values: dict[str, Any], label: str, key: str, index: int) -> "Table":
        """The `index`-th table with the header `key`, up to the next header; all lines if it has no header."""
        headers = [(n, m[1]) for n, line in enumerate(self.lines, start=1) if (m := _HEADER.match(line))]
        starts = [n for n, name in headers if name == key]
        if index >= len(starts):
            return Table(values, label, self.path, self.lines, self._line(key) or 1, len(self.lines))
        after = [n for n, name in headers if n > starts[index] and not name.startswith(f"{key}.")]
        return Table(values, label, self.path, self.lines, starts[index], min([*after, len(self.lines) + 1]) - 1)


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1e300)


def _is_vector(value: Any, length: int) -> bool:
    return isinstance(value, list) and len(value) == length and all(_is_number(x) and math.isfinite(x) for x in value)


def to_fill_in(lines: Iterable[str]) -> list[tuple[int, str]]:
    """(line, key) of each value that is still "?" in the `lines` of a TOML file."""
    return [(n, key) for n, line in enumerate(lines, 1) for key in _UNFILLED.findall(_COMMENT.sub("", line))]


def require_filled_in(table: Table) -> None:
    """Check the file of `table`. **Raises:** `InputError` that lists every value that is still "?"."""
    if left := to_fill_in(table.lines):
        listed = ", ".join(f"{key} (line {n})" for n, key in left)
        what = f'{listed} {"is" if len(left) == 1 else "are"} still "?"'
        remedy = "write each value in its place, without quotes; the comment on its line says what it is"
        raise InputError(what, at_line(table.path, left[0][0]), remedy)


def read_toml(path: Path) -> Table:
    """The TOML file at `path`.

    **Raises:** `InputError` with the line if the file cannot be read or parsed.
    """
    text = read_text(path)
    lines = text.split("\n")
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"at line (\d+)", str(error))
        line = int(place[1]) if place else len(text.rstrip().split("\n"))
        what = re.sub(r"\s*\(at .*\)$", "", str(error))
        raise InputError(f"Not valid TOML ({what})", at_line(path, line), "correct the syntax of this line") from None
    return Table(values, "the case", path, lines, 1, len(lines))
