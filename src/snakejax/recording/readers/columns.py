"""Which column of a plain table holds what: by the user's map, or by its name, and in which unit."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, instead_of
from snakejax.core.tabular import first_few

from .assumed import SI, unit_of_angle, unit_of_length, unit_of_time
from .capture import ANGLE, LENGTH, TIME, Body, Capture, FileAnnotations, Source, lost_together
from .cells import shown
from .names import Named, named, without_unit
from .rotations import about_z, require_unit

PLACE = ("x", "y", "z")
TURN = ("qx", "qy", "qz", "qw")
ROLES = ("time", *PLACE, "heading", *TURN, "object")
FRACTION = "fraction of the second"
"""The role of a second clock beside one that shows whole seconds, as ROS writes sec and nanosec."""
QUANTITY = {"time": "time", FRACTION: "time", "x": "length", "y": "length", "z": "length", "heading": "angle"}
UNITS = {"length": LENGTH, "angle": ANGLE, "time": TIME}
PLURAL = {"time": "time", "length": "lengths", "angle": "angles"}
LOST = frozenset(("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None"))
ROW = "row"
COUNTED = -1
"""Where no column is a clock, but rows follow each other evenly."""
MOST_LISTED = 8
SAME_TIME = 0.3
"""Two objects, one after the other, share the time in half of the rows; a clock that stutters does so in fewer."""
_EXAMPLE = 'columns = {time = "name", x = "name", y = "name", heading = "name"}'


class Column(NamedTuple):
    """One column in use: what it holds of which object, its index in the table, and its unit, empty if nobody says."""

    object: str
    role: str
    column_index: int
    unit: str

    @property
    def quantity(self) -> str | None:
        """What is measured: length, angle or time."""
        return QUANTITY.get(self.role)


def columns_of(names: Sequence[str], units: Sequence[str], hints: FileAnnotations, where: str) -> list[Column]:
    """The columns in use among those called `names`, with `units` where the file states them: those that the user's map
    names, and where it does not say time, x and y, those that say so by their names.

    **Raises:** `InputError` where the map names a column that is not there, or the names do not do.
    """
    require_units(hints.units or {}, where)
    mapped = _mapped(names, units, hints.columns or {}, hints.units or {}, where)
    roles = {column.role for column in mapped}
    if {"x", "y", "time"} <= roles:
        return mapped
    if ("x" in roles) != ("y" in roles):
        lacks = "y" if "x" in roles else "x"
        raise InputError(f"The map of columns lacks {lacks}", where, f"write {_EXAMPLE}")
    by_name = _named(names, units, hints.units or {}, {column.column_index for column in mapped}, "qx" not in roles)
    clocks = {c.object: c for c in (*by_name, *mapped) if c.role == "time"}
    more = [] if "x" in roles else [c for c in by_name if c.role != "time" and (c.object or c.role not in roles)]
    used = [*(c for c in mapped if c.role != "time"), *(c for c in more if c.role != FRACTION)]
    placed = {c.object for c in used if c.role == "x"} & {c.object for c in used if c.role == "y"}
    clock = clocks.get("") or (next(iter(clocks.values())) if len(clocks) == 1 else None)
    if clock is None or not placed:
        raise _unclear(names, clock is not None, bool(placed), where)
    turned = [c.object for c in used if c.role in TURN]
    # What is named as a part of a quaternion is not used without the other parts: it may be another angle.
    whole = {name for name in turned if turned.count(name) == len(TURN)}
    used = [c for c in used if (c.object in placed or c.role == "object") and (c.role not in TURN or c.object in whole)]
    fraction = [c for c in by_name if (c.object, c.role) == (clock.object, FRACTION) and clock.unit == "s"]
    return [clock._replace(object=""), *fraction, *used]


def _unclear(names: Sequence[str], clock: bool, placed: bool, where: str) -> InputError:
    listed = ", ".join(shown(name or str(i + 1), 20) for i, name in enumerate(names[:10]))
    lacks = "x and y" if clock else "the time" if placed else "time, x and y"
    what = f"The names of the columns do not show {lacks}: {listed}{', ...' if len(names) > 10 else ''}"
    remedy = f"say which they are: {_EXAMPLE} in case.toml, or option --columns"
    if placed:
        remedy += f'; time = "{ROW}" with units = {{time = "0.01 s"}} where rows come every 0.01 s'
    return InputError(what, where, remedy)


def _named(
    names: Sequence[str], units: Sequence[str], unit_hints: Mapping[str, str], taken: set[int], may_turn: bool
) -> list[Column]:
    """The columns whose names say what they hold, with the unit that the user, the name or the file states, in this
    order. x, y, z beside w, and beside another place, are a quaternion."""
    parsed = {i: words for i, name in enumerate(names) if i not in taken and (words := named(name))}
    if not any(p.role == "heading" or p.role in TURN for p in parsed.values()):
        # An angle beside a place, where nothing else says how the object is turned.
        for i, (text, unit) in enumerate(map(without_unit, names)):
            if text.lower() == "angle" and i not in taken:
                parsed[i] = Named("", "heading", False, unit)
    turned = {p.object for p in parsed.values() if may_turn and p.role == "qw" and p.plain}
    turned -= {p.object for p in parsed.values() if p.role == "qx"}
    columns: dict[tuple[str, str], Column] = {}
    for i, p in parsed.items():
        role = f"q{p.role}" if p.object in turned and p.plain and p.role in PLACE else p.role
        role = FRACTION if (p.object, role) in columns and role == "time" and p.unit in ("ms", "us", "ns") else role
        quantity = QUANTITY.get(role)
        stated = units[i] if i < len(units) else ""
        hint = "" if role == FRACTION else unit_hints.get(quantity or "", "")
        unit = (hint or p.unit or stated) if quantity else ""
        if not unit or _factor(unit, quantity) is not None:
            columns.setdefault((p.object, role), Column(p.object, role, i, unit))
    return [*columns.values()]


def _mapped(
    names: Sequence[str], units: Sequence[str], columns: Mapping[str, str], unit_hints: Mapping[str, str], where: str
) -> list[Column]:
    mapped = []
    for role, name in columns.items():
        if role not in ROLES:
            raise InputError(f'Unknown key "{shown(role)}" in columns', where, instead_of(role, ROLES))
        i, quantity = _index(names, role, name, where), QUANTITY.get(role)
        words = named(names[i]) if i >= 0 else None
        unit_in_name = words.unit if words and words.unit in UNITS.get(quantity or "", ()) else ""
        ending = _ending(names[i], quantity) if i >= 0 else ""
        stated = units[i] if 0 <= i < len(units) else ""
        unit = (unit_hints.get(quantity or "") or unit_in_name or stated or ending) if quantity else ""
        if unit and _factor(unit, quantity) is None:
            known = " or ".join(UNITS[quantity or "length"])
            raise InputError(f'Unknown unit "{shown(unit)}" of column {shown(name)}', where, f"write {known} in units")
        if i == COUNTED and not unit:
            remedy = 'write units = {time = "0.01 s"}, or the actual time between two rows'
            raise InputError("The rows are the clock, but the time between two rows is not given", where, remedy)
        mapped.append(Column("", role, i, unit))
    return mapped


def _index(names: Sequence[str], role: str, name: str, where: str) -> int:
    """The column called `name`, or the `name`-th, from 1; a clock may count the rows."""
    if name in names:
        return names.index(name)
    if name.isdecimal() and 1 <= int(name) <= len(names):
        return int(name) - 1
    if role == "time" and name == ROW:
        return COUNTED
    close = [shown(known or str(i + 1)) for i, known in enumerate(names[:30])]
    raise InputError(f'There is no column "{shown(name)}"', where, instead_of(name, close))


def _ending(name: str, quantity: str | None) -> str:
    """The unit with which a name ends that says nothing else, as of "robot easting (mm)"."""
    words = named(f"x {name}")
    return words.unit if words and words.unit in UNITS.get(quantity or "", ()) else ""


def require_units(units: Mapping[str, str], where: str) -> None:
    """Check the units that a user states. **Raises:** `InputError` for an unknown quantity or unit."""
    for quantity, unit in units.items():
        if quantity not in UNITS:
            raise InputError(f'Unknown key "{shown(quantity)}" in units', where, instead_of(quantity, tuple(UNITS)))
        if _factor(unit, quantity) is None:
            known = " or ".join(UNITS[quantity])
            raise InputError(f'Unknown unit "{shown(unit)}" of {quantity}', where, f"write {known}")


def _factor(unit: str, quantity: str | None) -> float | None:
    """What makes SI of `unit`, such as "mm", or "0.01 s" where a column counts hundredths."""
    if quantity is None:
        return 1.0
    count, _, name = unit.rpartition(" ")
    try:
        factor = float(count or 1.0) * UNITS[quantity][name]
    except (ValueError, KeyError):
        return None
    return factor if math.isfinite(factor) and factor > 0 else None


def capture_of(
    format: str,
    source: Source,
    where: str,
    names: Sequence[str],
    columns: Sequence[Column],
    values: Mapping[int, Float[np.ndarray, " n"]],
    labels: Sequence[str] | np.ndarray | None = None,
) -> Capture:
    """The bodies and markers of a table: `values` of its `columns` by index, and the object that each row is of.

    **Raises:** `InputError` where a row has no time, a quaternion is none, or a unit is missing that cannot be SI.
    """
    n = next((len(column) for index, column in values.items() if index != COUNTED), 0)
    by_index = {**values, COUNTED: np.arange(n, dtype=float)}
    clock = next(c for c in columns if c.role == "time")
    if (blank := np.flatnonzero(~np.isfinite(by_index[clock.column_index]))).size:
        raise InputError(f"The time in row {int(blank[0]) + 1} of the data is blank", where, "fill or remove the row")
    columns, assumed = _with_units(columns, by_index, where)
    times, columns = _times(columns, by_index)
    by_object: dict[str, dict[str, Float[np.ndarray, " n"]]] = {}
    for c in columns:
        if c.role not in ("time", FRACTION, "object"):
            by_object.setdefault(c.object, {})[c.role] = by_index[c.column_index] * (_factor(c.unit, c.quantity) or 1.0)
    bodies: dict[str, Body] = {}
    markers: dict[str, np.ndarray] = {}
    if labels is not None:
        if len(by_object) != 1:
            what = (
                f"The columns are of several objects ({', '.join(map(shown, by_object))}), beside a column of objects"
            )
            raise InputError(what, where, f"say which columns to read: {_EXAMPLE}")
        (parts,) = by_object.values()
        objects, of = np.unique(np.asarray(labels), return_inverse=True)
        for i, name in enumerate(objects):
            object_parts = {role: column[of == i] for role, column in parts.items()}
            if (body := _body(object_parts, times[of == i], str(name), where)) is None:
                raise InputError("The objects have no heading and no quaternion", where, "map those columns too")
            bodies[str(name)] = body
    else:
        _require_one_object(times, by_object, where)
        for name, parts in by_object.items():
            if (body := _body(parts, times, name, where)) is not None:
                bodies[name] = body
            else:
                markers[name] = lost_together(_stacked(parts, PLACE, len(times)))
    units = ", ".join(dict.fromkeys(c.unit for c in columns if c.unit))
    notes = [*assumed, *_unused(names, columns)]
    if "" in markers:
        notes.append(
            "a position without heading or quaternion is not a pose of a board; name their columns with --columns"
        )
    return Capture(format, source.path, where, None, units, bodies, markers, times, notes=notes, assumed=assumed)


def _times(
    columns: Sequence[Column], values: Mapping[int, Float[np.ndarray, " n"]]
) -> tuple[Float[np.ndarray, " n"], list[Column]]:
    """The times [s] of the rows, and the columns without a second clock that is no fraction of whole seconds."""
    clock = next(c for c in columns if c.role == "time")
    times = values[clock.column_index] * (_factor(clock.unit, "time") or 1.0)
    for c in columns:
        if c.role == FRACTION:
            fraction = values[c.column_index] * (_factor(c.unit, "time") or 1.0)
            if (times == np.floor(times)).all() and ((fraction >= 0) & (fraction < 1)).all():
                return times + fraction, list(columns)
    return times, [c for c in columns if c.role != FRACTION]


def _require_one_object(
    times: Float[np.ndarray, " n"], by_object: Mapping[str, Mapping[str, np.ndarray]], where: str
) -> None:
    """Refuse a table where most rows show the time of the row before at another place: its rows are of several objects,
    or its clock is too coarse. Rows that repeat both are doubled frames, which the inspection finds.

    **Raises:** `InputError`.
    """
    moved = np.zeros(max(len(times) - 1, 0), bool)
    for parts in by_object.values():
        for role in PLACE:
            moved |= np.abs(np.diff(parts.get(role, np.zeros(len(times))))) > 0
    same = (np.diff(times) == 0) & moved
    if same.sum() > SAME_TIME * len(times):
        what = f"{int(same.sum()) + 1} of {len(times)} rows show the time of another row, but another place"
        remedy = 'where each row is of one of several objects, write columns = {object = "name of the column"}; '
        raise InputError(what, where, f'{remedy}where the clock is too coarse, name another, or time = "{ROW}"')


def _with_units(
    columns: Sequence[Column], values: Mapping[int, Float[np.ndarray, " n"]], where: str
) -> tuple[list[Column], list[str]]:
    """The columns with units where nobody states them, and what is to be said of that."""
    unstated = [c for c in columns if c.quantity and not c.unit]
    if not unstated:
        return list(columns), []
    assumed: dict[Column, str] = {}
    for c in unstated:
        if c.role == "time":
            assumed[c] = unit_of_time(values[c.column_index], where)
    lengths = [c for c in unstated if c.quantity == "length"]
    assumed |= dict.fromkeys(lengths, unit_of_length([values[c.column_index] for c in lengths], where))
    clock = next(c for c in columns if c.role == "time")
    times = values[clock.column_index] * (_factor(clock.unit or assumed[clock], "time") or 1.0)
    for c in unstated:
        if c.role == "heading":
            assumed[c] = unit_of_angle(values[c.column_index], times, where)
    assumed_units = {
        quantity: dict.fromkeys(unit for c, unit in assumed.items() if c.quantity == quantity) for quantity in SI
    }
    phrases = [
        f"the {PLURAL[quantity]} (read in {' and '.join(units)})" for quantity, units in assumed_units.items() if units
    ]
    note = f"no unit is stated for {', '.join(phrases)}; --units changes this"
    return [c._replace(unit=assumed.get(c, c.unit)) for c in columns], [note]


def _unused(names: Sequence[str], columns: Sequence[Column]) -> list[str]:
    used = {c.column_index for c in columns}
    left = [shown(name or str(i + 1), 30) for i, name in enumerate(names) if i not in used]
    return [f"columns that are not used: {first_few(left, MOST_LISTED)}"] if left else []


def _stacked(parts: Mapping[str, Float[np.ndarray, " n"]], roles: Sequence[str], n: int) -> Float[np.ndarray, "n k"]:
    return np.stack([parts.get(role, np.zeros(n)) for role in roles], axis=1)


def _body(parts: Mapping[str, np.ndarray], times: np.ndarray, name: str, where: str) -> Body | None:
    if "heading" in parts:
        table = lost_together(_stacked(parts, (*PLACE, "heading"), len(times)))
        return Body(times, table[:, :3], about_z(table[:, 3]), where, table[:, 3])
    if all(role in parts for role in TURN):
        table = lost_together(_stacked(parts, (*PLACE, *TURN), len(times)))
        require_unit(table[:, 3:], name, where)
        return Body(times, table[:, :3], table[:, 3:], where)
    return None
