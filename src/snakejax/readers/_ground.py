"""The plane in which something moves: which way is up, and how far off an axis of the cameras that is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._turn import AXES

ARM = 0.2
FLATTEST = 0.2
FAR = 6.0
MAD_TO_SD = 1.4826
MOST = 20_000


class Ground(NamedTuple):
    """The unit vector `up` across the plane of motion, its nearest `axis`, and the angle [rad] between them."""

    up: Float[np.ndarray, "3"]
    axis: str
    tilt: float


def ground_of(trajectories: Float[np.ndarray, "n k 3"]) -> Ground | None:
    """The plane in which k points of a rigid body move; None where they move along a line, or not in a plane.

    Each point's way is taken from its own middle, so that where it sits on the body does not matter. What is far off
    the plane is left out and the plane found again.
    """
    step = max(1, len(trajectories) // MOST)
    moved = trajectories[::step]
    moved = moved[np.isfinite(moved).all(axis=(1, 2))]
    if len(moved) < 3:
        return None
    moved = (moved - np.median(moved, axis=0)).reshape(-1, 3)
    for _ in range(3):
        values, vectors = np.linalg.svd(moved - moved.mean(axis=0), full_matrices=False)[1:]
        off = moved @ vectors[2]
        limit = FAR * MAD_TO_SD * np.median(np.abs(off - np.median(off)))
        moved = moved[np.abs(off - np.median(off)) <= max(limit, 1e-9)]
    if values[1] == 0 or values[2] > FLATTEST * values[1]:
        return None
    axis = max(("x", "y", "z"), key=lambda name: abs(float(AXES[name] @ vectors[2])))
    up = vectors[2] * np.sign(AXES[axis] @ vectors[2])
    return Ground(up, axis, float(np.arccos(min(1.0, float(up @ AXES[axis])))))


def arms(position: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4 3"]:
    """A body's origin and the ends of three arms along its axes: points that move as it does, turning included."""
    v, w = rotation[:, :3], rotation[:, 3:]
    ends = [position]
    for axis in ARM * np.eye(3):
        # a + 2 w (v x a) + 2 v x (v x a)
        across = np.cross(v, axis)
        ends.append(position + axis + 2 * w * across + 2 * np.cross(v, across))
    return np.stack(ends, axis=1)
