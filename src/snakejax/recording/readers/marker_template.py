"""The shape that markers keep among themselves, and the board's own axes in it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .rigid_body import kabsch, limit_of

MOST_FRAMES = 2000
"""Frames from which the shape is averaged, evenly spaced."""
LEAST_APART = 0.01
"""Front and back [m] nearer to each other than this are one place."""


def shape_of(points: Float[np.ndarray, "n m 3"]) -> Float[np.ndarray, "m 3"] | None:
    """The rigid shape that the markers keep, its centroid at the origin, turned anyhow; None where they were too few.

    From the median distance of each two markers by classical scaling, mirrored if that fits the frames better. Medians
    do not mind that in some frames labels are swapped or missing.
    """
    present = np.isfinite(points).all(axis=2)
    chosen = np.flatnonzero(present.sum(axis=1) >= min(3, points.shape[1]))
    if not chosen.size:
        return None
    few = points[chosen[np.linspace(0, chosen.size - 1, min(chosen.size, MOST_FRAMES)).astype(int)]]
    apart = np.linalg.norm(few[:, :, None] - few[:, None], axis=3)
    together = np.asarray(np.isfinite(apart).any(axis=0))
    if not together.all():
        return None
    D = np.nanmedian(apart, axis=0) ** 2
    centre = np.eye(len(D)) - 1 / len(D)
    values, vectors = np.linalg.eigh(-0.5 * centre @ D @ centre)
    shape = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0.0))
    shape = np.pad(shape, ((0, 0), (0, 3 - shape.shape[1])))
    mirrored = shape * np.array([1.0, 1.0, -1.0])
    off = [float(np.nanmedian(_residual(s, few))) for s in (shape, mirrored)]
    shape = shape if off[0] <= off[1] else mirrored
    # The mean over the frames that fit is sharper than medians of distances.
    R, t, residual = kabsch(_lying(shape), few, np.zeros(3))
    with np.errstate(invalid="ignore"):
        good = residual <= limit_of(residual)
    back = np.einsum("nij,nmi->nmj", R[good], few[good] - t[good, None])
    if not np.isfinite(back).any(axis=0).all():
        return shape
    shape = np.nanmean(back, axis=0)
    return shape - shape.mean(axis=0)


def _lying(shape: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3"]:
    """`shape` turned so that its markers are apart as seen from above."""
    wide = np.linalg.svd(shape, full_matrices=True)[2]
    if np.linalg.det(wide) < 0:
        wide[2] *= -1
    return shape @ wide.T


def _residual(shape: np.ndarray, points: np.ndarray) -> np.ndarray:
    return kabsch(_lying(shape), points, np.zeros(3))[2]


def board_places(
    points: Float[np.ndarray, "n m 3"],
    shape: Float[np.ndarray, "m 3"],
    up: Float[np.ndarray, "3"],
    front: Sequence[int],
    back: Sequence[int],
) -> Float[np.ndarray, "m 3"] | None:
    """Where the markers of `shape` sit on the board: x from the middle of those at the `back` to that of those at the
    `front`, z up on average over the frames, from the point midway between the two; None where the two are one place.
    """
    shape = _lying(shape)
    step = max(1, len(points) // MOST_FRAMES)
    R, _, residual = kabsch(shape, points[::step], np.zeros(3))
    with np.errstate(invalid="ignore"):
        good = residual <= limit_of(residual)
    z = np.einsum("nij,i->nj", R[good], up).mean(axis=0)
    z /= np.linalg.norm(z)
    ends = [shape[list(end)].mean(axis=0) for end in (front, back)]
    x = ends[0] - ends[1]
    x -= (x @ z) * z
    if np.linalg.norm(x) < LEAST_APART:
        return None
    x /= np.linalg.norm(x)
    return (shape - (ends[0] + ends[1]) / 2) @ np.stack([x, np.cross(z, x), z], axis=1)
