"""Library of physical effects, by name."""

from collections import OrderedDict

from snakejax.dynamics.ports import Effect

from .ground import ComOffset as ComOffset
from .ground import GroundSlope as GroundSlope
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
