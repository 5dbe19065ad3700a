"""How strong an effect is: its usual size, and how far it moves the board beside the noise."""

from collections.abc import Mapping, Sequence

import numpy as np
from hidden import Run
from layout import EFFECTS, PLACE
from noise import Noise

USUAL = {
    "longitudinal_slip.k": 0.6,
    "rolling_resistance.f": 0.08,
    "body_drag.c": 0.5,
    "quadratic_drag.c": 3.0,
    "yaw_damping.c": 0.025,
    "yaw_friction.t": 0.0075,
    "yaw_bias.t": 0.01,
    "ground_slope.sx": 0.003,
    "ground_slope.sy": 0.002,
    "steering_offset.o": 0.01,
    "steering_crab.o": 0.04,
    "steering_lag.T": 0.04,
    "rotor_lag.T": 0.04,
    "steering_gain.g": 0.05,
    "rotor_gain.g": 0.05,
    "steering_backlash.b": 0.03,
    "grip_split.s": 0.2,
    "com_offset.a": 0.0125,
    "tyre_relaxation.sigma": 0.04,
    "tyre_offset.dSh": 0.01,
    "stribeck_grip.s": 0.3,
    "grip_gradient.g": 0.25,
    "marker_offset.mx": 0.01,
    "marker_offset.my": 0.006,
    "heading_offset.h": 0.02,
    "clock_offset.T": 0.05,
}
"""Usual sizes on a board of 7 kg, in SI units: those of the recordings a to o, where one of them holds the effect."""

STRANGE_USUAL = {
    "washboard.f": 0.25,
    "spin_grip.s": 0.4,
    "magnus_force.c": 6.0,
    "cable.c": 0.1,
    "bump.h": 0.005,
    "spring.k": 0.15,
    "turning_wind.f": 0.2,
    "dead_spot.s": 0.5,
}
"""Sizes of the strange effects that anyone would see: board-d, board-j, and 25 times those of the boards l to o."""

ONE_SIDED = (
    "longitudinal_slip",
    "rolling_resistance",
    "body_drag",
    "quadratic_drag",
    "yaw_damping",
    "yaw_friction",
    "steering_lag",
    "rotor_lag",
    "steering_backlash",
    "tyre_relaxation",
    "clock_offset",
)
"""Effects whose parameter is not below zero."""

UNITS = {
    "longitudinal_slip.k": (1, 0),
    "rolling_resistance.f": (1, 1),
    "body_drag.c": (1, 0),
    "quadratic_drag.c": (1, -1),
    "yaw_damping.c": (1, 2),
    "yaw_friction.t": (1, 2),
    "yaw_bias.t": (1, 2),
    "ground_slope.sx": (0, 1),
    "ground_slope.sy": (0, 1),
    "com_offset.a": (0, 1),
    "tyre_relaxation.sigma": (0, 1),
    "grip_gradient.g": (0, -1),
    "marker_offset.mx": (0, 1),
    "marker_offset.my": (0, 1),
    "washboard.f": (1, 1),
    "magnus_force.c": (1, 0),
    "cable.c": (1, 0),
    "bump.h": (0, 2),
    "spring.k": (1, 0),
    "turning_wind.f": (1, 1),
    "m": (1, 0),
    "I": (1, 2),
    "Jr": (1, 2),
    "Jw": (1, 2),
    "L": (0, 1),
    "creep": (0, 1),
    "D": (1, 1),
    "bump.x": (0, 1),
    "bump.y": (0, 1),
    "bump.width": (0, 1),
    "spring.x": (0, 1),
    "spring.y": (0, 1),
}
"""Powers of mass and of length in a number, with time as it is; a slope is an acceleration. Others have none."""


def scaled(values: Mapping[str, float], mass: float, length: float) -> dict[str, float]:
    """The numbers of a vehicle `mass` times as heavy and `length` times as long that does the same in the same time."""
    powers = {name: UNITS.get(name, (0, 0)) for name in values}
    return {name: value * mass ** powers[name][0] * length ** powers[name][1] for name, value in values.items()}


def sized(effect: str, rng: np.random.Generator, share: float) -> dict[str, float]:
    """Parameters of `effect` at `share` of the usual size, with signs by chance where both are possible.

    Of `tyre_offset` there is the angle alone, as on board-o.
    """
    found = {}
    for name in EFFECTS[effect]:
        usual = USUAL.get(f"{effect}.{name}")
        if usual is not None:
            sign = 1.0 if effect in ONE_SIDED else rng.choice([-1.0, 1.0])
            found[f"{effect}.{name}"] = float(sign * share * usual)
    return found


def visible(values: Mapping[str, float], without: Mapping[str, float], runs: Sequence[Run], noise: Noise) -> float:
    """How far the paths with `values` are from those with `without`: root mean square, in units of the noise.

    The start pose of each run is free: what a small rigid motion of the whole path makes of it does not count.
    """
    squares = []
    for run in runs:
        squares.append(np.mean(np.square(rigidly_apart(run.path(values), run.path(without), noise))))
    return float(np.sqrt(np.mean(squares)))


def rigidly_apart(path: np.ndarray, other: np.ndarray, noise: Noise) -> np.ndarray:
    """Difference of two paths (n, 3) over the noise's standard deviations, less its part along shifts and a turn."""
    columns = np.zeros((*path.shape, 3))
    columns[:, 0, 0] = columns[:, 1, 1] = columns[:, 2, 2] = 1.0
    columns[:, 0, 2] = -(other[:, 1] - other[0, 1])
    columns[:, 1, 2] = other[:, 0] - other[0, 0]
    apart = ((path - other) / noise.scale).ravel()
    columns = (columns / noise.scale[:, None]).reshape(-1, 3)
    return (apart - columns @ np.linalg.lstsq(columns, apart, rcond=None)[0]).reshape(path.shape)


def calibrated(effect: dict, others: Mapping, runs: Sequence[Run], noise: Noise, low: float, high: float) -> dict:
    """The parameters of `effect` beside `others`, made smaller or larger until they are `visible` by `low` to `high`.

    Paths are nearly straight lines in small effects: two steps of the rule of three do. Raises ArithmeticError where
    they do not.
    """
    scaled_ones = [name for name in effect if name in USUAL or name in STRANGE_USUAL]
    for _ in range(4):
        seen = visible({**others, **effect}, others, runs, noise)
        if low <= seen <= high:
            return effect
        goal = 1.1 * low if seen < low else 0.9 * high
        effect = effect | {name: effect[name] * goal / seen for name in scaled_ones}
    raise ArithmeticError(f"{', '.join(scaled_ones)} cannot be made visible by {low} to {high}.")


assert all(name in PLACE for name in (*USUAL, *STRANGE_USUAL)), "A usual size belongs to no effect."
