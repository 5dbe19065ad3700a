"""Joint logs: a CSV of the joint angles over time, commanded or measured."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, at_line, instead_of
from ._text import number, read_text, rows_of

REQUIRED = ("time_s", "phi_rad", "psi_rad")
OPTIONAL = ("phi_back_rad",)
FEWEST_ROWS = 4


class JointLog(NamedTuple):
    """`times` [s] (n,) from the start of the run, increasing, and the angles [rad] (n,) of the joints."""

    times: Float[np.ndarray, " n"]
    phi: Float[np.ndarray, " n"]
    psi: Float[np.ndarray, " n"]
    phi_back: Float[np.ndarray, " n"] | None


def read_joint_log(path: Path | str) -> JointLog:
    """The log at `path`, with columns time_s, phi_rad, psi_rad and, where the back is steered by itself, phi_back_rad.

    **Raises:** `InputError` with file, line and remedy.
    """
    path = Path(path)
    rows, decimal = rows_of(read_text(path))
    columns = _columns(rows[0], path)
    lines = [line for line, cells in enumerate(rows[1:], start=2) if any(cells)]
    if len(lines) < FEWEST_ROWS:
        what = f"The joint log has {len(lines)} rows, but at least {FEWEST_ROWS} are needed"
        raise InputError(what, at_line(path, len(lines) + 1), "log the joints for the whole run")
    table = np.array([_row(rows[line - 1], columns, at_line(path, line), decimal) for line in lines])
    for before, after, line in zip(table[:-1, 0], table[1:, 0], lines[1:], strict=True):
        if after <= before:
            what = f"Time goes from {before:g} s to {after:g} s: it runs backwards or stands still"
            raise InputError(what, at_line(path, line), "sort the rows by time and keep one row for each")
    return JointLog(table[:, 0], table[:, 1], table[:, 2], table[:, 3] if len(columns) > 3 else None)


def _columns(header: list[str], path: Path) -> list[str]:
    for i, name in enumerate(header):
        if name not in REQUIRED + OPTIONAL or name in header[:i]:
            remedy = "remove it" if name in header[:i] else instead_of(name, REQUIRED + OPTIONAL)
            raise InputError(f'Extra column "{name}"', at_line(path, 1), remedy)
    for name in REQUIRED:
        if name not in header:
            raise InputError(f"Missing column {name}", at_line(path, 1), f"the first row is {','.join(REQUIRED)}")
    return header


def _row(cells: list[str], columns: list[str], where: str, decimal: str) -> list[float]:
    if len(cells) != len(columns):
        what = f"The row has {len(cells)} cells, but there are {len(columns)} columns"
        raise InputError(what, where, "complete the row")
    values = {name: number(cell, name, where, decimal) for name, cell in zip(columns, cells, strict=True)}
    for name, value in values.items():
        if np.isnan(value):
            raise InputError(f"The cell of {name} is blank", where, "a joint log has no gaps: fill or remove the row")
    return [values[name] for name in REQUIRED + OPTIONAL if name in values]
