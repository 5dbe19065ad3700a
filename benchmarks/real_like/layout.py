"""The numbers that describe one run of the plant, their places in one vector, and the names of effects.md for them."""

from collections.abc import Mapping

import numpy as np

BOARD = {"m": 7.0, "I": 0.4375, "Jr": 0.0238, "L": 0.25, "creep": 0.01, "kp": 100.0, "kd": 10.0}
"""Mass in kg, yaw inertia of all parts and that of the rotor in kg m^2, half length in m, creep speed in m/s, gains."""

TYRE = {"B": 8.0, "C": 1.4, "D": 6.0, "E": 0.2}

EFFECTS = {
    "longitudinal_slip": ("k",),
    "rolling_resistance": ("f",),
    "body_drag": ("c",),
    "quadratic_drag": ("c",),
    "yaw_damping": ("c",),
    "yaw_friction": ("t",),
    "yaw_bias": ("t",),
    "ground_slope": ("sx", "sy"),
    "steering_offset": ("o",),
    "steering_crab": ("o",),
    "steering_lag": ("T",),
    "rotor_lag": ("T",),
    "steering_gain": ("g",),
    "rotor_gain": ("g",),
    "steering_backlash": ("b",),
    "grip_split": ("s",),
    "com_offset": ("a",),
    "tyre_relaxation": ("sigma",),
    "tyre_offset": ("dSh", "dSv"),
    "stribeck_grip": ("s",),
    "grip_gradient": ("g",),
    "marker_offset": ("mx", "my"),
    "heading_offset": ("h",),
    "clock_offset": ("T",),
}
"""Effects of effects.md with parameters; `lateral_skid` is the structure itself: that `free` is 1."""

STRANGE = {
    "washboard": ("f",),
    "spin_grip": ("s",),
    "magnus_force": ("c",),
    "cable": ("c",),
    "bump": ("h", "x", "y", "width"),
    "spring": ("k", "x", "y"),
    "turning_wind": ("f",),
    "dead_spot": ("s",),
}
"""Effects that no library holds; `plant.py` says what each does."""

SHAPES = {
    "washboard.k": 9.0,
    "spin_grip.rate": 4.0,
    "cable.speed": 0.02,
    "turning_wind.period": 20.0,
    "dead_spot.width": 0.3,
}
"""Numbers of the strange effects that are the same on all boards, in 1/m, rad/s, m/s, s and rad."""

NAMES = (
    *BOARD,
    *TYRE,
    "free",
    *(f"{effect}.{name}" for effect, names in (EFFECTS | STRANGE).items() for name in names),
    *SHAPES,
)
PLACE = {name: k for k, name in enumerate(NAMES)}
NEUTRAL = BOARD | TYRE | SHAPES | {"free": 1.0, "bump.width": 0.15}


def vector(values: Mapping[str, float]) -> np.ndarray:
    """All numbers of a run: those of `values` by the names in `NAMES`, the others as in `NEUTRAL` or zero."""
    unknown = set(values) - set(NAMES)
    if unknown:
        raise KeyError(f"The plant knows nothing of {', '.join(sorted(unknown))}.")
    known = NEUTRAL | dict(values)
    return np.array([float(known.get(name, 0.0)) for name in NAMES])


def effects_of(values: Mapping[str, float]) -> list[str]:
    """The effects of effects.md that are not neutral in `values`."""
    return [effect for effect, names in EFFECTS.items() if any(values.get(f"{effect}.{name}", 0.0) for name in names)]
