"""The vehicles by the name that `kind` has in case.toml."""

import importlib
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from snakejax.dynamics.vehicle import AbstractVehicle


class _Entry(NamedTuple):
    """Where the class of a vehicle stands, and the constant with the values of an example."""

    module: str
    name: str
    example: str


_REGISTRY = {
    "snakeboard": _Entry("snakeboard.board", "Board", "TABLE_II"),
    "car": _Entry("car", "Car", "DART"),
    "skid_steer": _Entry("skid_steer", "SkidSteer", "HUSKY"),
    "sleigh": _Entry("sleigh", "Sleigh", "ICE_SLEIGH"),
    "roller_racer": _Entry("roller_racer", "RollerRacer", "ROLLER_RACER"),
}
VEHICLES = tuple(_REGISTRY)
"""Names of all vehicles."""


def vehicle_class(kind: str) -> "type[AbstractVehicle]":
    """The class of the vehicle `kind`, one of `VEHICLES`."""
    entry = _REGISTRY[kind]
    return getattr(importlib.import_module(f"{__package__}.{entry.module}"), entry.name)


def example_values(kind: str) -> dict[str, float]:
    """The constants of the example of the vehicle `kind`, by field."""
    entry = _REGISTRY[kind]
    return dict(getattr(importlib.import_module(f"{__package__}.{entry.module}"), entry.example))
