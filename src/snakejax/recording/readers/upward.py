"""Which way is up where a file does not say: markers lie above the floor, and what rolls stays in a plane.

The origin of a laboratory is on its floor. Along the axis that points up, nothing is below it, and the lowest marker
stays near it; along any other axis that would be chance. People are taller than wide. A rigid body that moves in a
plane moves on the floor.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .motion_plane import ground_of, is_rigid

BELOW = 0.03
"""So far [m] below the floor markers may seem to be: a floor is no better than this."""
MOST_BELOW = 0.01
"""The share of places that may be anywhere: ghosts."""
NEAR = 0.5
"""The lowest of what is on a floor is no higher [m]."""
BOUNCE = 0.15
"""By so much [m] the lowest marker may rise and sink: that of a person who walks, not of one who passes by."""
TALLER = 2.0
"""A person is so many times taller than wide."""
MOST_TILT = np.deg2rad(10.0)
"""Tilt of a plane of motion above which it is not the floor."""
MOST_FRAMES, MOST_MARKERS = 2000, 200
"""Frames and markers from which the floor is found, evenly spaced."""
AXES = ("x", "y", "z")


class Upward(NamedTuple):
    """The axis that points `up`, and the `reason`; `open` where nothing did and it is a mere guess."""

    up: str
    reason: str
    open: bool = False


def upward(markers: Mapping[str, Float[np.ndarray, "n 3"]], usual: str, why: str) -> Upward:
    """Which way is up by what the markers do; `usual`, because of `why`, where they do not show it."""
    points = _some(markers)
    directions = [direction for direction in _possible_directions(points) if _steady(points, direction)]
    floor = ground_of(points) if points.shape[1] and is_rigid(points) else None
    if floor is not None and floor.tilt < MOST_TILT:
        # A plane has two sides, and what rolls in it lies on one of them.
        sign = "-" if f"-{floor.axis}" in directions else ""
        return Upward(sign + floor.axis, "the plane in which its markers move is perpendicular to it")
    if len(directions) > 1 and not is_rigid(points):
        tall = {direction: _extent(points, direction) for direction in AXES}
        directions = [
            direction
            for direction in directions
            if all(tall[direction[-1]] > TALLER * tall[axis] for axis in AXES if axis != direction[-1])
        ]
    if len(directions) == 1:
        return Upward(directions[0], "its markers lie above the floor that way")
    return Upward(usual, why, open=True)


def side_of(markers: Mapping[str, Float[np.ndarray, "n 3"]], axis: str) -> str | None:
    """`axis`, or `-axis` where that points up, by the side of the floor where the markers lie; None if on neither."""
    return next((direction for direction in _possible_directions(_some(markers)) if direction[-1] == axis), None)


def _some(markers: Mapping[str, Float[np.ndarray, "n 3"]]) -> Float[np.ndarray, "n m 3"]:
    names = [*markers]
    chosen = names[:: max(1, -(-len(names) // MOST_MARKERS))]
    if not chosen:
        return np.zeros((0, 0, 3))
    points = np.stack([markers[name][:: max(1, len(markers[name]) // MOST_FRAMES)] for name in chosen], axis=1)
    return points[np.isfinite(points).all(axis=2).any(axis=1)]


def _along(points: Float[np.ndarray, "n m 3"], direction: str) -> Float[np.ndarray, "n m"]:
    return points[..., AXES.index(direction[-1])] * (-1 if direction[0] == "-" else 1)


def _possible_directions(points: Float[np.ndarray, "n m 3"]) -> list[str]:
    """The directions that may be up: nothing is below the floor, and something is near it."""
    directions = []
    for direction in (*AXES, *(f"-{axis}" for axis in AXES)):
        height = _along(points, direction)
        height = height[np.isfinite(height)]
        if not height.size:
            continue
        lowest, middle = np.quantile(height, [MOST_BELOW, 0.5])
        if -BELOW < lowest < NEAR and middle > BELOW:
            directions.append(direction)
    return directions


def _steady(points: Float[np.ndarray, "n m 3"], direction: str) -> bool:
    lowest = np.nanmin(_along(points, direction), axis=1)
    return bool(np.subtract(*np.quantile(lowest, [0.95, 0.05])) < BOUNCE)


def _extent(points: Float[np.ndarray, "n m 3"], axis: str) -> float:
    return float(np.median(np.nanstd(_along(points, axis), axis=1)))
