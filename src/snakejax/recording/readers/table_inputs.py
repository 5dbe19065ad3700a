"""Inputs that stand in the same table as the poses, as loggers of robots write them: one row for each frame.

    time,x,y,heading,stamp,steering,throttle,safety      the columns of the inputs repeat until the next message

A message counts once, at the stamp of its sender plus one offset for the file. A row arrives late by what the network
takes, so that offset is nearly the least difference between arrival and stamp.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line, instead_of
from snakejax.core.text_files import read_text
from snakejax.dynamics.vehicle_input import Input

from .cells import is_blank, is_comment, separator_of, split
from .input_log import SUFFIX
from .numeric_table import Rows, columns_at_once, numbers

STAMP, ENABLE = "stamp", "enable"
ALIASES = {"drive": ("throttle",), STAMP: ("elapsed time sensors",), ENABLE: ("safety_value", "safety")}
"""Further names that the column of an input may have."""
OFFSET_QUANTILE = 0.05
"""The offset of the clocks is this quantile of arrival less stamp: a message whose stamp is wrong does not count."""
LATE = 0.03
"""Messages later than the offset by more than this [s] are reported."""
FEWEST_MESSAGES = 4
DISABLED = ("command", "torque")
"""Kinds of inputs that are zero where the safety is off; a steering still acts."""


class TableInputs(NamedTuple):
    """The messages in a table: `times` [s] (m,) on the clock of the poses and `values` (m,) of the inputs by name;
    `enabled` (m,); `notes` on what was found."""

    times: Float[np.ndarray, " m"]
    values: dict[str, Float[np.ndarray, " m"]]
    enabled: np.ndarray
    notes: tuple[str, ...]


class InputTable(NamedTuple):
    """A table as text: the names of its columns, which are in line `line`, counted from 1, and its `rows`."""

    header: list[str]
    line: int
    rows: Rows

    @property
    def where(self) -> str:
        """The file and the line of the names."""
        return at_line(self.rows.path, self.line)

    def columns(self, wanted: Sequence[str]) -> dict[str, Float[np.ndarray, " n"]]:
        """The columns `wanted`; others may hold anything.

        **Raises:** `InputError` where one is not there, or has a cell that is blank or no number.
        """
        for name in wanted:
            if name not in self.header:
                raise InputError(f'There is no column "{name}"', self.where, instead_of(name, self.header))
        names = list(dict.fromkeys(wanted))
        indices = [self.header.index(name) for name in names]
        table = columns_at_once(self.rows, len(self.header), indices)
        if table is None:
            table = self._row_by_row(names, indices)
        for column, name in enumerate(names):
            if (blank := np.flatnonzero(np.isnan(table[:, column]))).size:
                where = self.rows.where(int(blank[0]))
                raise InputError(f"The cell of {name} is blank", where, "fill it, or remove the row")
        return dict(zip(names, table.T, strict=True))

    def _row_by_row(self, names: Sequence[str], indices: Sequence[int]) -> Float[np.ndarray, "n c"]:
        kept = []
        for row in range(len(self.rows.lines)):
            cells = self.rows.cells(row)
            if len(cells) <= max(indices):
                what = f"The row has {len(cells)} cells, but there are {len(self.header)} columns"
                raise InputError(what, self.rows.where(row), "complete the row, or remove it")
            kept.append("\t".join(cells[i] for i in indices))
        return numbers(self.rows._replace(lines=kept, separator="\t"), names)


def read_table(path: Path) -> InputTable:
    """The table at `path`, whose first row that is no comment has the names. **Raises:** `InputError`."""
    text = read_text(path)
    separator, decimal = separator_of(text[:100_000])
    lines = text.split("\n")
    while len(lines) > 1 and is_blank(lines[-1]):
        lines.pop()
    first = next((i for i, line in enumerate(lines) if not is_comment(line)), 0)
    table = InputTable(
        split(lines[first], separator), first + 1, Rows(path, lines[first + 1 :], first + 2, separator, decimal)
    )
    if not table.rows.lines:
        raise InputError("The table ends before its first row", table.where, "export the file again")
    return table


def input_columns(table: InputTable, named_columns: Mapping[str, str], inputs: Sequence[Input]) -> dict[str, str]:
    """The column of each input, of the stamp and of the safety, by what `named_columns` says or by its name.

    **Raises:** `InputError` where an input that must be given has none.
    """
    header, columns = table.header, dict(named_columns)
    for one in inputs:
        known = (one.name + SUFFIX[one.kind], one.name, one.label, *ALIASES.get(one.name, ()))
        column = next((name for name in known if name in header), None)
        if one.name not in columns and column is not None:
            columns[one.name] = column
        if one.name not in columns and one.follows is None:
            remedy = f'write inputs = {{{one.name} = "its column"}}'
            raise InputError(f"No column holds the input {one.name}", table.where, remedy)
    for role in (STAMP, ENABLE):
        column = next((name for name in ALIASES[role] if name in header), None)
        if role not in columns and column is not None:
            columns[role] = column
    return columns


def table_inputs(
    table: Mapping[str, Float[np.ndarray, " n"]],
    columns: Mapping[str, str],
    arrival: np.ndarray,
    kinds: Sequence[Input],
) -> TableInputs:
    """The messages in the rows of `table`, which arrived at the times `arrival` [s] (n,) of the poses.

    **Raises:** `ValueError` where there are fewer than four messages.
    """
    notes = []
    if STAMP in columns:
        stamp = table[columns[STAMP]]
        waiting = int(np.argmax(stamp != 0)) if (stamp != 0).any() else len(stamp)
        new = np.concatenate([[True], np.diff(stamp) != 0]) & (np.arange(len(stamp)) >= waiting)
        times, late = _on_clock(stamp[new], arrival[new])
        if waiting:
            notes.append(f"the first {waiting} rows have no inputs yet")
        if late > LATE:
            notes.append(f"messages arrive up to {late:.2f} s late; they count at the stamp of their sender")
    else:
        new, times = np.ones(len(arrival), bool), arrival
    rows = np.flatnonzero(new)
    later = np.concatenate([[True], np.diff(np.maximum.accumulate(times)) > 0]) if len(times) else np.zeros(0, bool)
    rows, times = rows[later], times[later]
    if len(rows) < FEWEST_MESSAGES:
        raise ValueError(f"has {len(rows)} messages with inputs, but at least {FEWEST_MESSAGES} are needed")
    enabled = table[columns[ENABLE]][rows] > 0.5 if ENABLE in columns else np.ones(len(rows), bool)
    if not enabled.all():
        notes.append(f"the safety is off in {np.mean(~enabled):.0%} of the messages: there the drive is zero")
    values = {}
    for one in kinds:
        if one.name in columns:
            value = table[columns[one.name]][rows]
            values[one.name] = np.where(enabled, value, 0.0) if one.kind in DISABLED else value
    return TableInputs(times, values, enabled, tuple(notes))


def _on_clock(stamp: np.ndarray, arrival: np.ndarray) -> tuple[np.ndarray, float]:
    """The `stamp` on the clock of `arrival`, and the largest delay of a message [s]."""
    if not len(stamp):
        return stamp, 0.0
    offset = float(np.quantile((arrival - stamp)[-max(len(stamp) - 1, 1) :], OFFSET_QUANTILE))
    # The first row may have come in the middle of its message.
    return stamp + offset, float((arrival - stamp)[1:].max(initial=offset) - offset)
