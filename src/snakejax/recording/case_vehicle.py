"""The vehicle of a case: the table [vehicle], or [board] for a snakeboard."""

import dataclasses
import math
from typing import NamedTuple

from snakejax.core.errors import InputError
from snakejax.core.parameter import Domain
from snakejax.core.toml_table import Table
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.vehicles.registry import VEHICLES, vehicle_class
from snakejax.vehicles.snakeboard.board import Board

UNIT_SUFFIXES = {"-": "", "kg m^2": "kgm2", "m/s": "mps", "N s/m": "Nspm", "N m": "Nm"}
"""How a unit is written at the end of a key, where that differs from the unit."""
ESTIMATE = "estimate"
BOARD_EXAMPLE = "[board] with mass_kg and the other measures"


class VehicleTable(NamedTuple):
    """The vehicle, and the standard deviations [SI] of its constants that are stated, by field."""

    vehicle: AbstractVehicle
    constant_sd: dict[str, float]


def key_of(field: str, unit: str) -> str:
    """The key of a constant in case.toml: `mass` in kg is mass_kg."""
    suffix = UNIT_SUFFIXES.get(unit, unit)
    return f"{field}_{suffix}" if suffix else field


def fields_of(kind: type[AbstractVehicle]) -> dict[str, dataclasses.Field]:
    """The constants of a vehicle by their keys."""
    fields = [f for f in dataclasses.fields(kind) if "domain" in f.metadata]  # type: ignore[arg-type]
    return {key_of(f.name, f.metadata["domain"].unit): f for f in fields if f.name != "offset" or kind is not Board}


def sd_keys_of(kind: type[AbstractVehicle]) -> dict[str, str]:
    """The keys of standard deviations of constants, with the fields."""
    known = fields_of(kind).values()
    stated = {f.name: f.metadata["domain"].unit for f in known if f.name in kind.stated_sd}
    return {key_of(f"{name}_sd", unit): name for name, unit in stated.items()}


def read_vehicle(table: Table) -> VehicleTable:
    """The vehicle of the case `table`. **Raises:** `InputError` where it is described wrongly."""
    if "vehicle" not in table.values:
        return _read(table.table("board", BOARD_EXAMPLE), Board)
    if "board" in table.values:
        raise table.error("board", "stands beside [vehicle]", "keep one of the two tables")
    own = table.table("vehicle", f'[vehicle] with kind = "{VEHICLES[1]}" and its measures')
    return _read(own, vehicle_class(own.choice("kind", VEHICLES)))


def _read(table: Table, kind: type[AbstractVehicle]) -> VehicleTable:
    fields, sd_keys = fields_of(kind), sd_keys_of(kind)
    table.require_known(["kind", *fields, *sd_keys] if "kind" in table.values else [*fields, *sd_keys])
    values, unknown = {}, []
    # A board's creep_speed is asked for, as ever.
    for key, field in fields.items():
        optional = field.default is not dataclasses.MISSING and not (kind is Board and field.name == "creep_speed")
        if _to_estimate(table, key):
            if not optional or "unknown" not in {f.name for f in dataclasses.fields(kind)}:  # type: ignore[arg-type]
                raise table.error(key, "cannot be estimated", "write its value: a fit needs it")
            unknown.append(field.name)
            if isinstance(table.values[key], dict):
                first = table.table(key, f"{key} = {{estimate = 1.0}}")
                first.require_known([ESTIMATE])
                values[field.name] = first.number(ESTIMATE, field.metadata["domain"])
        elif key in table.values or not optional:
            values[field.name] = table.number(key, field.metadata["domain"])
    if unknown:
        values["unknown"] = tuple(unknown)
    try:
        vehicle = kind(**values)
    except ValueError as error:
        raise InputError(str(error).rstrip("."), table.where("kind"), "correct the value") from None
    if isinstance(vehicle, Board):
        _require_inertia(table, vehicle)
    domains = {f.name: f.metadata["domain"] for f in fields.values()}
    sd = {
        name: table.number(key, Domain(domains[name].unit, 0.0, math.inf, True, True))
        for key, name in sd_keys.items()
        if key in table.values
    }
    return VehicleTable(vehicle, sd)


def _to_estimate(table: Table, key: str) -> bool:
    """Whether a fit shall estimate a constant: `"estimate"`, or `{estimate = 1.0}` with a first guess."""
    value = table.values.get(key)
    return value == ESTIMATE or isinstance(value, dict)


def _require_inertia(table: Table, board: Board) -> None:
    joints = float(board.rotor_inertia + 2 * board.wheelset_inertia)
    if float(board.total_inertia) <= joints:
        key = "inertia_kgm2" if board.inertia is not None else "half_length_m"
        what = f"makes the total inertia {float(board.total_inertia):g} kg m^2, not above {joints:g} of the joints"
        raise table.error(key, what, "give inertia_kgm2 with the rotor and the wheelsets in it")
