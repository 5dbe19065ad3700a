"""The nearest rotation, against scipy's alignment of vectors and by its defining property."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from snakejax.core.rotations import nearest_rotations


def test_it_is_the_rotation_that_aligns_two_sets_of_points() -> None:
    draw = np.random.default_rng(0)
    points, turns = draw.normal(size=(5, 6, 3)), Rotation.random(5, random_state=1)
    turned = np.stack([turn.apply(set_) for turn, set_ in zip(turns, points, strict=True)])
    noisy = turned + 0.05 * draw.normal(size=points.shape)
    found = nearest_rotations(np.einsum("nmi,nmj->nij", points, noisy))
    for k in range(5):
        best, _ = Rotation.align_vectors(noisy[k], points[k])
        np.testing.assert_allclose(found[k], best.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_reflection_is_answered_by_a_rotation(dimensions: int) -> None:
    """Points that a mirror image would fit: the answer is a rotation all the same, and no other fits better."""
    draw = np.random.default_rng(2)
    points = draw.normal(size=(8, dimensions))
    mirrored = points * np.array([-1.0, *[1.0] * (dimensions - 1)])
    R = nearest_rotations((points.T @ mirrored)[None])[0]
    np.testing.assert_allclose(R @ R.T, np.eye(dimensions), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    left = ((points @ R.T - mirrored) ** 2).sum()
    for _ in range(200):
        skew = 0.3 * draw.normal(size=(dimensions, dimensions))
        near = nearest_rotations((np.eye(dimensions) + skew - skew.T)[None])[0] @ R
        assert ((points @ near.T - mirrored) ** 2).sum() >= left - 1e-9
