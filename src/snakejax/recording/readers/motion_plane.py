"""The plane in which something moves: which way is up, and how far off an axis of the cameras that is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .rotations import AXES

ARM = 0.2
FLATTEST = 0.2
FAR = 9.0
"""Places farther from the plane than this many times the median distance are no part of it: 6 sd of a normal one."""
MOST = 20_000
LEAST_FAR = 1e-6
TRIES, SOME, MOST_SHARE = 300, 3000, 0.8
LOOSE, LOOSE_SHARE, MOST_PAIRS = 0.005, 0.02, 200
"""Markers of a rigid body keep their distances to so much [m], or to such a share of them."""


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
    values, vectors = _principal_axes(moved, _least_quantile(moved))
    for _ in range(2):
        values, vectors = _principal_axes(moved, vectors[2])
    if values[1] == 0 or values[2] > FLATTEST * values[1]:
        return None
    axis = max(("x", "y", "z"), key=lambda name: abs(float(AXES[name] @ vectors[2])))
    up = vectors[2] * np.sign(AXES[axis] @ vectors[2])
    return Ground(up, axis, float(np.arccos(min(1.0, float(up @ AXES[axis])))))


def _principal_axes(
    moved: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Singular values and axes, the longest first, of what is near the plane across `normal`."""
    off = moved @ normal
    near = np.abs(off - np.median(off))
    kept = moved[near <= max(FAR * float(np.median(near)), LEAST_FAR)]
    values, vectors = np.linalg.svd(kept - kept.mean(axis=0), full_matrices=False)[1:]
    return values, vectors


def is_rigid(points: Float[np.ndarray, "n m 3"]) -> bool:
    """Whether the markers keep their distances: three quarters of the pairs do, in most frames. One is no body."""
    n, m = points.shape[:2]
    if m < 2:
        return False
    one, other = np.triu_indices(m, 1)
    step = -(-len(one) // MOST_PAIRS)
    some = points[:: max(1, n // SOME)]
    apart = np.linalg.norm(some[:, one[::step]] - some[:, other[::step]], axis=2)
    apart = apart[:, np.isfinite(apart).sum(axis=0) > len(some) // 10]
    if not apart.size:
        return False
    usual = np.nanmedian(apart, axis=0)
    spread = np.nanmedian(np.abs(apart - usual), axis=0)
    return bool(np.mean(spread <= np.maximum(LOOSE, LOOSE_SHARE * usual)) >= 0.75)


def arms(position: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4 3"]:
    """A body's origin and the ends of three arms along its axes: points that move as it does, turning included."""
    v, w = rotation[:, :3], rotation[:, 3:]
    ends = [position]
    for axis in ARM * np.eye(3):
        # a + 2 w (v x a) + 2 v x (v x a)
        across = np.cross(v, axis)
        ends.append(position + axis + 2 * w * across + 2 * np.cross(v, across))
    return np.stack(ends, axis=1)


def _least_quantile(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Of normals across random pairs of points the one for which most points are nearest to one plane.

    Three points far away can turn a plane of least squares as they like; they cannot turn this one.
    """
    random = np.random.default_rng(0)
    some = points[random.permutation(len(points))[:SOME]]
    one, other = (some[random.integers(len(some), size=TRIES)] for _ in range(2))
    across = np.cross(one, other)
    length = np.linalg.norm(across, axis=1)
    if not length.any():
        return np.array([0.0, 0.0, 1.0])
    normals = across[length > 0] / length[length > 0, None]
    off = some @ normals.T
    return normals[np.quantile(np.abs(off - np.median(off, axis=0)), MOST_SHARE, axis=0).argmin()]
