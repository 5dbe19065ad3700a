"""Jackknife over runs: errors of an incomplete model are correlated over longer times than any block of samples."""

import numpy as np
from jaxtyping import Float, Int

OPEN = 1e-9
"""Relative cutoff of eigenvalues: directions that the remaining runs do not determine are left out."""


def left_out(
    columns: Float[np.ndarray, "N P"], residual: Float[np.ndarray, " N"], run: Int[np.ndarray, " N"]
) -> Float[np.ndarray, "G P"]:
    """Change (G, P) of least squares estimates when each of G runs is left out, times sqrt((G - 1) / G).

    The sum of its squares over the runs is the jackknife variance (Efron and Stein 1981, about the estimate of all
    runs). With J_k, r_k the rows of run k at the optimum, J^T r = 0, leaving run k out moves the values by
    d_k = (J^T J - J_k^T J_k)^-1 J_k^T r_k in the linear model. No assumption is made on correlations within a run.
    With a single run the result is empty, (0, P).
    """
    numbers = np.unique(run)
    if len(numbers) < 2:
        return np.zeros((0, columns.shape[1]))
    size = np.sqrt((columns**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    parts = [(columns[run == k] / size, residual[run == k]) for k in numbers]
    normals = [J.T @ J for J, _ in parts]
    others = [sum(normals) - normal for normal in normals]
    shifts = [np.linalg.pinv(N, OPEN, hermitian=True) @ (J.T @ r) for N, (J, r) in zip(others, parts, strict=True)]
    return np.array(shifts) / size * np.sqrt((len(numbers) - 1) / len(numbers))


def left_out_sd(
    columns: Float[np.ndarray, "N P"], residual: Float[np.ndarray, " N"], run: Int[np.ndarray, " N"]
) -> Float[np.ndarray, " P"]:
    """Standard errors (P,) of least squares estimates by the jackknife over the runs; zero for a single run."""
    return np.sqrt((left_out(columns, residual, run) ** 2).sum(axis=0))
