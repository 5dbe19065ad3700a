"""Logs of inputs: a CSV of joint angles, speeds or commands over time, commanded or measured."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, at_line, instead_of
from snakejax.core.text_files import read_text
from snakejax.dynamics.vehicle_input import Input

from .cells import is_blank, separator_of, shown, split
from .numeric_table import Rows, numbers

SUFFIX = {"angle": "_rad", "speed": "_mps", "torque": "_Nm", "command": ""}
"""What a column's name adds to that of an input, by its kind; the bare name is as good."""
JOINTS = (Input("phi", "angle", "steering"), Input("psi", "angle", "rotor"), Input("phi_back", "angle", "back", "-phi"))
FEWEST_ROWS = 4
"""A cubic spline needs four knots."""


class InputLog(NamedTuple):
    """`times` [s] (n,) from the start of the run, increasing, and the `values` (n,) of the inputs by name."""

    times: Float[np.ndarray, " n"]
    values: dict[str, Float[np.ndarray, " n"]]


class JointLog(NamedTuple):
    """`times` [s] (n,) from the start of the run, increasing, and the angles [rad] (n,) of a snakeboard's joints."""

    times: Float[np.ndarray, " n"]
    phi: Float[np.ndarray, " n"]
    psi: Float[np.ndarray, " n"]
    phi_back: Float[np.ndarray, " n"] | None


def read_joint_log(path: Path | str) -> JointLog:
    """The log at `path`, with columns time_s, phi_rad, psi_rad and, where the back is steered by itself, phi_back_rad.

    **Raises:** `InputError` with file, line and remedy.
    """
    log = read_input_log(path, JOINTS)
    return JointLog(log.times, log.values["phi"], log.values["psi"], log.values.get("phi_back"))


def read_input_log(path: Path | str, inputs: Sequence[Input]) -> InputLog:
    """The log at `path` with the column time_s and one for each of `inputs`, such as steer_rad, left_mps or drive.

    An input that follows another may be left out.
    **Raises:** `InputError` with file, line and remedy.
    """
    path = Path(path)
    text = read_text(path)
    separator, decimal = separator_of(text)
    lines = text.split("\n")
    columns = _columns(split(lines[0], separator), path, inputs)
    filled = [line for line, cells in enumerate(lines[1:], start=2) if not is_blank(cells)]
    if len(filled) < FEWEST_ROWS:
        what = f"The joint log has {len(filled)} rows, but at least {FEWEST_ROWS} are needed"
        raise InputError(what, at_line(path, len(filled) + 1), "log the joints for the whole run")
    table = np.empty((len(filled), len(columns)))
    # Rows between two blank lines are read together; there are rarely any such lines.
    breaks = [0, *(np.flatnonzero(np.diff(filled) > 1) + 1).tolist(), len(filled)]
    for start, stop in itertools.pairwise(breaks):
        part = lines[filled[start] - 1 : filled[stop - 1]]
        table[start:stop] = numbers(Rows(path, part, filled[start], separator, decimal), columns)
    if (blank := np.argwhere(np.isnan(table))).size:
        row, column = blank[0]
        what = f"The cell of {columns[column]} is blank"
        raise InputError(what, at_line(path, filled[row]), "a joint log has no gaps: fill or remove the row")
    by_name = dict(zip(columns, table.T, strict=True))
    times = by_name["time_s"]
    if (backwards := np.flatnonzero(np.diff(times) <= 0)).size:
        row = int(backwards[0])
        what = f"Time goes from {times[row]:g} s to {times[row + 1]:g} s: it runs backwards or stands still"
        raise InputError(what, at_line(path, filled[row + 1]), "sort the rows by time and keep one row for each")
    values = {one.name: by_name[column] for one in inputs for column in _names(one) if column in by_name}
    return InputLog(times, values)


def _names(one: Input) -> tuple[str, ...]:
    """The names that the column of an input may have, the usual one first."""
    return tuple(dict.fromkeys((one.name + SUFFIX[one.kind], one.name)))


def _columns(header: list[str], path: Path, inputs: Sequence[Input]) -> list[str]:
    required = ["time_s", *(_names(one)[0] for one in inputs if one.follows is None)]
    known = ["time_s", *(name for one in inputs for name in _names(one))]
    usual = ["time_s", *(_names(one)[0] for one in inputs)]
    for i, name in enumerate(header):
        if name not in known or name in header[:i]:
            remedy = "remove it" if name in header[:i] else instead_of(name, usual)
            raise InputError(f'Extra column "{shown(name)}"', at_line(path, 1), remedy)
    for one in inputs:
        if one.follows is None and not set(_names(one)) & set(header):
            what = f"Missing column {_names(one)[0]}"
            raise InputError(what, at_line(path, 1), f"the first row is {','.join(required)}")
    if "time_s" not in header:
        raise InputError("Missing column time_s", at_line(path, 1), f"the first row is {','.join(required)}")
    return header
