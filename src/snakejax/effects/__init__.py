"""Library of physical effects, by name."""

import functools
import types
from collections import OrderedDict

from snakejax.dynamics.ports import Effect
from snakejax.dynamics.vehicle import AbstractVehicle

from .driving import CombinedSlip as CombinedSlip
from .driving import DriveFriction as DriveFriction
from .driving import InertiaFactor as InertiaFactor
from .driving import LoadTransfer as LoadTransfer
from .driving import SpeedResistance as SpeedResistance
from .driving import SteeringDrag as SteeringDrag
from .ground import ComOffset as ComOffset
from .ground import GroundSlope as GroundSlope
from .input_effects import InputAsymmetry as InputAsymmetry
from .input_effects import InputCurvature as InputCurvature
from .input_effects import InputEffect as InputEffect
from .input_effects import InputFading as InputFading
from .input_effects import InputGain as InputGain
from .input_effects import InputLag as InputLag
from .input_effects import InputOffset as InputOffset
from .inputs import RotorGain as RotorGain
from .inputs import RotorLag as RotorLag
from .inputs import SteeringBacklash as SteeringBacklash
from .inputs import SteeringCrab as SteeringCrab
from .inputs import SteeringGain as SteeringGain
from .inputs import SteeringLag as SteeringLag
from .inputs import SteeringOffset as SteeringOffset
from .resistance import BodyDrag as BodyDrag
from .resistance import LongitudinalSlip as LongitudinalSlip
from .resistance import QuadraticDrag as QuadraticDrag
from .resistance import RollingResistance as RollingResistance
from .resistance import YawBias as YawBias
from .resistance import YawDamping as YawDamping
from .resistance import YawFriction as YawFriction
from .sensors import ClockOffset as ClockOffset
from .sensors import HeadingOffset as HeadingOffset
from .sensors import MarkerOffset as MarkerOffset
from .tyres import GripGradient as GripGradient
from .tyres import GripSplit as GripSplit
from .tyres import StribeckGrip as StribeckGrip
from .tyres import TyreOffset as TyreOffset
from .tyres import TyreRelaxation as TyreRelaxation

LIBRARY: OrderedDict[str, type[Effect]] = OrderedDict(
    longitudinal_slip=LongitudinalSlip,
    rolling_resistance=RollingResistance,
    body_drag=BodyDrag,
    quadratic_drag=QuadraticDrag,
    yaw_damping=YawDamping,
    yaw_friction=YawFriction,
    yaw_bias=YawBias,
    ground_slope=GroundSlope,
    steering_offset=SteeringOffset,
    steering_crab=SteeringCrab,
    steering_lag=SteeringLag,
    rotor_lag=RotorLag,
    steering_gain=SteeringGain,
    rotor_gain=RotorGain,
    steering_backlash=SteeringBacklash,
    grip_split=GripSplit,
    com_offset=ComOffset,
    tyre_relaxation=TyreRelaxation,
    tyre_offset=TyreOffset,
    stribeck_grip=StribeckGrip,
    grip_gradient=GripGradient,
    marker_offset=MarkerOffset,
    heading_offset=HeadingOffset,
    clock_offset=ClockOffset,
)
"""All effects; `lateral_skid`, the change of structure from `coupled` to `free`, is a switch."""

_OF_EVERY_VEHICLE = (
    "rolling_resistance",
    "body_drag",
    "quadratic_drag",
    "yaw_damping",
    "yaw_friction",
    "yaw_bias",
    "ground_slope",
    "grip_split",
    "com_offset",
    "tyre_relaxation",
    "stribeck_grip",
    "grip_gradient",
    "marker_offset",
    "heading_offset",
    "clock_offset",
)
_OF_DRIVEN_WHEELS = {
    "speed_resistance": SpeedResistance,
    "drive_friction": DriveFriction,
    "load_transfer": LoadTransfer,
    "combined_slip": CombinedSlip,
}
_OF_INPUTS = {
    "angle": (
        ("lag", InputLag),
        ("offset", InputOffset),
        ("gain", InputGain),
        ("asymmetry", InputAsymmetry),
        ("curvature", InputCurvature),
    ),
    "speed": (("lag", InputLag), ("gain", InputGain)),
    "torque": (("lag", InputLag), ("gain", InputGain), ("fading", InputFading)),
    "command": (("lag", InputLag), ("gain", InputGain), ("fading", InputFading)),
}
"""The effects on an input of each kind: NAME_lag and so on, NAME the label of the input."""


def library(vehicle: AbstractVehicle) -> OrderedDict[str, type[Effect]]:
    """All effects of `vehicle` by name: `LIBRARY` for a snakeboard.

    For another one, those that any vehicle may have, those of its inputs, named by their labels (`steering_lag`), and
    of driven and of steered wheels. Each refuses a model on which it cannot act (`Effect.inapplicable_because`).
    """
    return LIBRARY if {"phi", "psi"} <= {given.name for given in vehicle.inputs} else _built(type(vehicle))


@functools.cache
def _built(kind: type[AbstractVehicle]) -> OrderedDict[str, type[Effect]]:
    effects: OrderedDict[str, type[Effect]] = OrderedDict((name, LIBRARY[name]) for name in _OF_EVERY_VEHICLE)
    if kind.drive is not AbstractVehicle.drive:
        effects.update(_OF_DRIVEN_WHEELS)
    if any(given.kind == "angle" for given in kind.inputs):
        effects["steering_drag"] = SteeringDrag
    effects["inertia_factor"] = InertiaFactor
    for given in kind.inputs:
        for word, effect in _OF_INPUTS[given.kind]:
            name = f"{given.label}_{word}"
            about = effect.description.replace("The input", f"The {given.label.replace('_', ' ')}")
            effects[name] = _of_input(f"{name}_{kind.__name__}", effect, given.name, about)
    return effects


def _of_input(name: str, effect: type[InputEffect], given: str, description: str) -> type[Effect]:
    """The `effect` on the input `given`, as a class of its own."""
    bases: tuple[type, ...] = (effect,)
    own = {"input": given, "description": description, "__doc__": effect.__doc__, "__module__": effect.__module__}
    return types.new_class(name, bases, exec_body=lambda namespace: namespace.update(own))
