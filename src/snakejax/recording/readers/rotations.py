"""Rotations: from Euler angles and matrices to quaternions, and from a quaternion to the heading about the axis up."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError

# What turns the axes of a file to ones of which z points up.
UPRIGHT = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}
AXES = {name: np.array(turn[2], float) for name, turn in UPRIGHT.items()}
UNIT_LENGTH = 0.01
"""Deviation of the length of a quaternion from 1 that rounding to three digits may cause."""


def upright(up: str | Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The rotation to axes of which z points up, where `up` is an axis or the components of what points up.

    The axis nearest to the vector is turned onto it the short way first.
    """
    if isinstance(up, str):
        return np.array(UPRIGHT[up], float)
    vector = np.asarray(up, float) / np.linalg.norm(up)
    nearest = max(AXES, key=lambda name: float(AXES[name] @ vector))
    axis = AXES[nearest]
    # Rodrigues' rotation from a to b: I + K + K^2 / (1 + a.b), K the cross product with a x b.
    x, y, z = np.cross(vector, axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.array(UPRIGHT[nearest], float) @ (np.eye(3) + K + K @ K / (1 + axis @ vector))


def heading_of(rotation: Float[np.ndarray, "n 4"], turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " n"]:
    """The angle [rad] about the axis up, after `turn` has made that z: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))."""
    x, y, z = turn @ rotation[:, :3].T
    w = rotation[:, 3]
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))


def about_z(heading: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4"]:
    """The quaternion of a turn by `heading` about z."""
    zero = np.zeros_like(heading)
    return np.stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)], axis=1)


def from_euler(order: str, angles: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """The quaternions of Euler angles [rad]; axes in capitals turn with the body, as in scipy. NaN stays NaN."""
    from scipy.spatial.transform import Rotation

    quaternions = np.full((len(angles), 4), np.nan)
    present = np.isfinite(angles).all(axis=1)
    if present.any():
        quaternions[present] = Rotation.from_euler(order, angles[present]).as_quat()
    return quaternions


def from_rotation_vector(vector: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """The quaternions of turns about the axis of `vector` by its length a [rad]: (sin(a/2) axis, cos(a/2))."""
    half = 0.5 * np.linalg.norm(vector, axis=1, keepdims=True)
    # np.sinc(x) is sin(pi x) / (pi x).
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=1)


def from_matrix(matrix: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    """The quaternions of rotation matrices; NaN stays NaN, and what is no rotation becomes NaN."""
    from scipy.spatial.transform import Rotation

    quaternions = np.full((len(matrix), 4), np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        valid = np.abs(np.linalg.det(matrix) - 1) < 3 * UNIT_LENGTH
    if valid.any():
        quaternions[valid] = Rotation.from_matrix(matrix[valid]).as_quat()
    return quaternions


def first_unlike_one(rotation: Float[np.ndarray, "n 4"]) -> int | None:
    """The first row whose quaternion is not of length 1, or None."""
    with np.errstate(over="ignore"):
        wrong = np.flatnonzero(np.abs(np.sqrt((rotation**2).sum(axis=1)) - 1) > UNIT_LENGTH)
    return int(wrong[0]) if wrong.size else None


def require_unit(rotation: Float[np.ndarray, "n 4"], name: str, where: str) -> None:
    """**Raises:** `InputError` where a quaternion is not of length 1."""
    if (row := first_unlike_one(rotation)) is not None:
        what = f'The quaternion of "{name}" is not of length 1 in row {row + 1} of its data'
        raise InputError(what, where, "check the order x, y, z, w of its columns")


def unwrapped(heading: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """`heading` [rad] without jumps of 2 pi from one present (not NaN) sample to the next."""
    heading = heading.copy()
    present = np.isfinite(heading)
    heading[present] = np.unwrap(heading[present])
    return heading
