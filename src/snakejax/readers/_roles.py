"""Which column of a plain table holds what: by the user's map, or by names that carry their unit, as `x_mm`."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, instead_of
from ._capture import ANGLE, LENGTH, TIME, Body, Capture, Hints, Source, lost_together
from ._text import shown
from ._turn import about_z, require_unit

PLACE = ("x", "y", "z")
TURN = ("qx", "qy", "qz", "qw")
ROLES = ("time", *PLACE, "heading", *TURN, "object")
QUANTITY = {"time": "time", "x": "length", "y": "length", "z": "length", "heading": "angle"}
UNITS = {"length": LENGTH, "angle": ANGLE, "time": TIME}
SI = {"length": "m", "angle": "rad", "time": "s"}
LOST = frozenset(("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None"))
_ALSO = {"t": "time", "timestamp": "time", "tx": "x", "ty": "y", "tz": "z", "yaw": "heading", "theta": "heading"}
_NAME = re.compile(
    r"(?:(?P<object>.+)\.)?(?P<role>[A-Za-z]+)(?:[ _]?[\[(]?(?P<unit>mm|cm|m|in|ft|rad|deg|s|ms|us|ns)[\])]?)?"
)
_EXAMPLE = 'columns = {time = "name", x = "name", y = "name", heading = "name"}'


class Column(NamedTuple):
    """One column in use: what it holds of which object, its index in the table, and the factor that makes it SI."""

    object: str
    role: str
    index: int
    factor: float


def columns_of(names: Sequence[str], units: Sequence[str], hints: Hints, where: str) -> tuple[list[Column], list[str]]:
    """The columns in use among those called `names`, with `units` where the file states them, and the units found.

    **Raises:** `InputError` where the map names a column that is not there, or there is no map and the names do not do.
    """
    if hints.columns is not None:
        return _mapped(names, units, hints.columns, hints.units or {}, where)
    found: dict[tuple[str, str], Column] = {}
    used: dict[str, None] = {}
    for i, name in enumerate(names):
        match = _NAME.fullmatch(name)
        role = _ALSO.get(match["role"].lower(), match["role"].lower()) if match else ""
        if match is None or role not in ROLES or role == "object":
            continue
        quantity = QUANTITY.get(role)
        unit = match["unit"] or (units[i] if i < len(units) else "") or (hints.units or {}).get(quantity or "", "")
        factor = _factor(unit, quantity)
        if factor is not None:
            found.setdefault((match["object"] or "", role), Column(match["object"] or "", role, i, factor))
            used |= {unit: None} if quantity else {}
    placed = {object for object, role in found if (object, "x") in found and (object, "y") in found}
    if ("", "time") not in found or not placed:
        listed = ", ".join(shown(name, 20) for name in names[:10]) + (", ..." if len(names) > 10 else "")
        what = f"The names of the columns do not tell time, x, y and their units: {listed}"
        raise InputError(what, where, f"say which they are: {_EXAMPLE} in case.toml, or option --columns")
    return [c for (object, role), c in found.items() if object in placed or role == "time"], [*used]


def _mapped(
    names: Sequence[str], units: Sequence[str], columns: Mapping[str, str], said: Mapping[str, str], where: str
) -> tuple[list[Column], list[str]]:
    found, used = [], {}
    for role, name in columns.items():
        if role not in ROLES:
            raise InputError(f'Unknown key "{shown(role)}" in columns', where, instead_of(role, ROLES))
        if name not in names:
            close = [shown(known) for known in names[:30]]
            raise InputError(f'There is no column "{shown(name)}"', where, instead_of(name, close))
        i, quantity = names.index(name), QUANTITY.get(role)
        match = re.search(r"[ _]?[\[(]?([a-z]+)[\])]?$", name)
        named = match[1] if match and match[1] in UNITS.get(quantity or "", ()) else ""
        stated = units[i] if i < len(units) else ""
        unit = said.get(quantity or "") or stated or named or SI.get(quantity or "", "")
        factor = _factor(unit, quantity)
        if factor is None:
            known = " or ".join(UNITS[quantity or "length"])
            raise InputError(f'Unknown unit "{shown(unit)}" of column {shown(name)}', where, f"write {known} in units")
        found.append(Column("", role, i, factor))
        used |= {unit: None} if quantity else {}
    for role in ("time", "x", "y"):
        if role not in columns:
            raise InputError(f"The map of columns lacks {role}", where, f"write {_EXAMPLE}")
    return found, [*used]


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
    columns: Sequence[Column],
    units: Sequence[str],
    values: Mapping[int, Float[np.ndarray, " n"]],
    labels: Sequence[str] | np.ndarray | None = None,
) -> Capture:
    """The bodies and markers of a table: `values` of its columns by index, and the object that each row is of.

    **Raises:** `InputError` where a row has no time, or a quaternion is none.
    """
    clock = next(c for c in columns if c.role == "time")
    times = values[clock.index] * clock.factor
    if (blank := np.flatnonzero(~np.isfinite(times))).size:
        raise InputError(f"The time in row {int(blank[0]) + 1} of the data is blank", where, "fill or remove the row")
    by_object: dict[str, dict[str, Float[np.ndarray, " n"]]] = {}
    for c in columns:
        if c.role not in ("time", "object"):
            by_object.setdefault(c.object, {})[c.role] = values[c.index] * c.factor
    bodies: dict[str, Body] = {}
    markers: dict[str, np.ndarray] = {}
    if labels is not None:
        parts = by_object[""]
        names, of = np.unique(np.asarray(labels), return_inverse=True)
        for i, name in enumerate(names):
            mine = {role: column[of == i] for role, column in parts.items()}
            if (body := _body(mine, times[of == i], str(name), where)) is None:
                raise InputError("The objects have no heading and no quaternion", where, "map those columns too")
            bodies[str(name)] = body
    else:
        for name, parts in by_object.items():
            if (body := _body(parts, times, name, where)) is not None:
                bodies[name] = body
            else:
                markers[name] = lost_together(_stacked(parts, PLACE, len(times)))
    return Capture(format, source.path, where, None, ", ".join(units), bodies, markers, times)


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
