"""The rotation nearest to a matrix, as Kabsch's alignment of two sets of points needs it."""

import numpy as np
from jaxtyping import Float


def nearest_rotations(H: Float[np.ndarray, "n d d"]) -> Float[np.ndarray, "n d d"]:
    """The rotations R (n, d, d) with the largest trace of R H (Kabsch 1976; Umeyama 1991).

    With H = U S V^T, R = V diag(1, ..., 1, det(V U^T)) U^T. For H = sum_j a_j p_j^T, R a_j is nearest to p_j.
    """
    U, _, Vt = np.linalg.svd(H)
    U[:, :, -1] *= (np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return np.einsum("nij,njk->nki", U, Vt)
