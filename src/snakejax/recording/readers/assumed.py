"""Units that neither a file nor a user states: SI where that can be, degrees and epochs where the numbers show them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError

SI = {"length": "m", "angle": "rad", "time": "s"}
EPOCHS = {"s": (1e9, 1e10), "ms": (1e12, 1e13), "us": (1e15, 1e16), "ns": (1e18, 1e19)}
"""What clocks that count from 1970 show, in each unit, between 2001 and 2286."""
STEPS = (1e-5, 1.0)
"""Cameras take no fewer than a frame a second, and no more than 100 000."""
FARTHEST = 100.0
"""A laboratory is smaller [m], and its origin is in it."""
TURNS, JUMP = 4 * np.pi, 300.0
"""A heading within two turns is one in radians; a jump [deg] that is none of them."""
FASTEST = 30.0
"""Nothing on wheels turns faster [rad/s]."""
_OPTION = "in case.toml, or option --units"


def unit_of_time(times: Float[np.ndarray, " n"], where: str) -> str:
    """The unit of a clock. **Raises:** `InputError` where it can be no clock in seconds, and is none from 1970."""
    present = np.unique(times[np.isfinite(times)])
    if present.size < 2:
        return SI["time"]
    for unit, (first, last) in EPOCHS.items():
        if first <= present[0] and present[-1] < last:
            return unit
    step = float(np.median(np.diff(present)))
    if STEPS[0] < step < STEPS[1]:
        return SI["time"]
    what = f"The time has no unit, and as seconds its steps would be of {step:.3g} s"
    remedy = f'write units = {{time = "ms"}}, or {{time = "0.01 s"}} where it counts hundredths, {_OPTION}'
    raise InputError(what, where, remedy)


def unit_of_length(coordinates: Sequence[Float[np.ndarray, " n"]], where: str) -> str:
    """The unit of the coordinates of one table. **Raises:** `InputError` where they are no metres."""
    values = np.abs(np.concatenate([c[np.isfinite(c)] for c in coordinates] or [np.zeros(0)]))
    if not values.size or (far := float(np.quantile(values, 0.99))) < FARTHEST:
        return SI["length"]
    what = f"The lengths have no unit, and as metres they would go to {far:.4g} m"
    raise InputError(what, where, f'write units = {{length = "mm"}}, or cm, in, ft, or m, {_OPTION}')


def unit_of_angle(heading: Float[np.ndarray, " n"], times: Float[np.ndarray, " n"], where: str) -> str:
    """The unit of a heading over `times` [s]: degrees where it jumps by a whole turn of them, or turns too fast.

    **Raises:** `InputError` where it goes beyond two turns of radians, and may be either.
    """
    present = np.isfinite(heading)
    angle, clock = heading[present], times[present]
    if angle.size < 2 or np.abs(angle).max() <= TURNS:
        return SI["angle"]
    steps = np.abs(np.diff(angle))
    if ((steps > JUMP) & (steps < 361)).any() and np.abs(angle).max() <= 361:
        return "deg"
    pace = np.diff(clock)
    smooth = (pace > 0) & (steps < JUMP)
    if smooth.any() and np.quantile(steps[smooth] / pace[smooth], 0.99) > FASTEST:
        return "deg"
    what = f"The heading has no unit and goes from {angle.min():.4g} to {angle.max():.4g}, in radians or in degrees"
    raise InputError(what, where, f'write units = {{angle = "deg"}} or {{angle = "rad"}} {_OPTION}')
