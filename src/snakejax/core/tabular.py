"""Results that show themselves: one short line or two as text, a table in a notebook, a data frame for computing."""

import abc
import html
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import islice
from math import isfinite
from typing import TYPE_CHECKING, Any

from .errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

MOST_ROWS = 40
"""Rows of a table in a notebook; the data frame has them all."""


class Tabular(abc.ABC):
    """A result that is a table beside its other data."""

    @abc.abstractmethod
    def headline(self) -> str:
        """The result in a line or two."""

    @abc.abstractmethod
    def columns(self) -> Mapping[str, Sequence[Any]]:
        """The table: its columns by name, with their unit where they have one, all of one length."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {self.headline()}"

    def _repr_html_(self) -> str:
        """The headline and the table, for a notebook."""
        columns = self.columns()
        heads = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
        rows = list(zip(*columns.values(), strict=True))
        body = "".join(
            f"<tr>{''.join(f'<td>{html.escape(cell_text(cell))}</td>' for cell in row)}</tr>"
            for row in islice(rows, MOST_ROWS)
        )
        more = f"<p>{len(rows) - MOST_ROWS} more rows: to_dataframe()</p>" if len(rows) > MOST_ROWS else ""
        headline = html.escape(repr(self)).replace("\n", "<br>")
        return f"<p>{headline}</p><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>{more}"

    def to_dataframe(self) -> "DataFrame":
        """The table as a pandas data frame. **Raises:** `InputError` where pandas is not installed."""
        try:
            pandas = import_module("pandas")
        except ImportError:
            what = f"The table of a {type(self).__name__} needs pandas, which is not installed"
            raise InputError(what, "to_dataframe()", "pip install pandas") from None
        return pandas.DataFrame({name: list(column) for name, column in self.columns().items()})

    def to_xarray(self) -> "Dataset":
        """The table as an xarray Dataset with the dimension `row`. **Raises:** as `to_dataframe`."""
        return self.to_dataframe().rename_axis("row").to_xarray()


def cell_text(value: Any) -> str:
    """One cell of a table: four digits of a number, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def three_digits(value: float | None) -> str:
    """`value` to three digits, as a whole number from a thousand on, with an exponent from a million on."""
    if value is None:
        return ""
    if not isfinite(value):
        return "not finite"
    if abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    return f"{value:.0f}" if abs(value) < 999999.5 else f"{value:.1e}".replace("e+0", "e").replace("e+", "e")


def listed(names: Sequence[str], word: str = "and") -> str:
    """`a, b and c`."""
    *others, last = names
    return f"{', '.join(others)} {word} {last}" if others else last


def first_few(names: Sequence[str], most: int, comma: bool = False) -> str:
    """`a, b and 3 more` of at most `most` names; with `comma`, `a, b, and 3 more`."""
    more = f"{',' if comma else ''} and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, what: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
