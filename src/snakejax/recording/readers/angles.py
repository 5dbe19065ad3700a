"""Whether three angles of a body are a rotation vector or Euler angles: the reading in which the body swings least.

A board stays level: some direction b of the body keeps pointing along one direction n of the room. Read rightly, the
angle between R b and n stays small; read wrongly, it grows with the turn. A rotation vector (Vicon's "helical") may be
as long as 2 pi, and is then nothing like Euler angles.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .rotations import from_euler, from_rotation_vector, heading_of

HELICAL = "helical"
EULER = {"xyz": "Euler angles about the fixed axes x, y, z", "XYZ": "Euler angles about the turning axes X, Y, Z"}
ANGLES = (HELICAL, *EULER)
VECTOR = "a rotation vector (helical)"
SAME = 1e-5
"""Two readings are the same where their headings differ by less [rad]: a tenth of the noise of the best cameras."""
LEAST_RATIO = math.pi / 2
"""The noise of a level body's tilt differs so much between two readings by itself: 2 sin(a/2) / a, up to a = pi."""
MOST_SWING = math.radians(10.0)
"""A board on a floor tilts less; a reading with more swing is wrong."""
MOST_FRAMES, ROUNDS = 20_000, 6
"""Frames that are compared, and rounds of the reweighting."""
_NO_NOISE = 1e-9
"""Lower limit [rad] of the angle in a weight."""


class Reading(NamedTuple):
    """How the angles of one body are read, one of `ANGLES`, and a sentence that says so and why."""

    angles: str
    description: str

    @staticmethod
    def given(angles: str) -> "Reading":
        """What the user states."""
        return Reading(angles, f"{EULER.get(angles, VECTOR)}, as given")


def rotation_by(angles: str, values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """The quaternions of `values` [rad] read as `angles`; NaN stays NaN."""
    return from_rotation_vector(values) if angles == HELICAL else from_euler(angles, values)


def reading_of(values: Float[np.ndarray, "n 3"]) -> Reading:
    """How to read the three angles [rad] of a body: by the data, and as a rotation vector where they do not tell.

    Where both readings give the same heading to within `SAME`, it is the third angle itself.
    """
    some = values[:: max(1, len(values) // MOST_FRAMES)]
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some):
        return Reading(HELICAL, f"{VECTOR}, the default of Tracker: the body was never tracked")
    read = {angles: rotation_by(angles, some) for angles in ANGLES}
    headings = [heading_of(read[angles], np.eye(3)) for angles in (HELICAL, "xyz")]
    if np.abs(_wrapped(headings[0] - headings[1])).max() < SAME:
        return Reading("xyz", f"{VECTOR} or Euler angles, the heading is the same")
    off = {angles: _off(rotation) for angles, rotation in read.items()}
    # A frame that no reading makes level was mistracked.
    level = np.min([*off.values()], axis=0) < MOST_SWING
    swing = {angles: max(SAME, _root_mean_square(angle[level])) for angles, angle in off.items()}
    # Constant RX and RY are an object's axes tilted on its board, or turning axes on a tilted floor: rather the first.
    euler = "XYZ" if swing["XYZ"] * LEAST_RATIO < swing["xyz"] else "xyz"
    shown = {angles: f"{math.degrees(size):.2g} degrees" for angles, size in swing.items()}
    if swing[euler] * LEAST_RATIO < swing[HELICAL] and swing[euler] < MOST_SWING:
        description = (
            f"{EULER[euler]}: the normal of the body then swings by {shown[euler]}; as {VECTOR}, by {shown[HELICAL]}"
        )
        return Reading(euler, description)
    if swing[HELICAL] * LEAST_RATIO < swing[euler] and swing[HELICAL] < MOST_SWING:
        description = (
            f"{VECTOR}: the normal of the body then swings by {shown[HELICAL]}; as Euler angles, by {shown[euler]}"
        )
        return Reading(HELICAL, description)
    long = float(np.linalg.norm(some, axis=1).max())
    if long > math.pi:
        why = f"it is up to {math.degrees(long):.0f} degrees long"
    else:
        why = "the default of Tracker; the motion does not show it"
    return Reading(HELICAL, f"{VECTOR}, {why}")


def _off(rotation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " n"]:
    """The angle [rad] between R b and n, for the b and n between which the weighted mean of R is largest.

    They are its first singular vectors; weights of one over the angle keep single frames from turning them.
    """
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(rotation).as_matrix()
    weights, angle = np.ones(len(R)), np.zeros(len(R))
    for _ in range(ROUNDS):
        U, _, Vt = np.linalg.svd(np.einsum("n,nij->ij", weights, R))
        pointing, n = R @ Vt[0], U[:, 0]
        angle = np.arctan2(np.linalg.norm(np.cross(pointing, n), axis=1), pointing @ n)
        weights = 1.0 / np.maximum(angle, max(float(np.median(angle)), _NO_NOISE))
    return angle


def _root_mean_square(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else math.inf


def _wrapped(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.arctan2(np.sin(angle), np.cos(angle))
