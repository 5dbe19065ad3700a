"""Smooth functions through values at knots: natural cubic splines of one variable, and their products of two."""

import functools
from typing import Any

import numpy as np


@functools.cache
def _weights(n: int) -> np.ndarray:
    """W (n + 2, n): the natural cubic spline that is 1 at knot j of 0, 1, .. n - 1 and 0 at the others is
    W[0, j] + W[1, j] t + sum_k W[2 + k, j] |t - k|^3; it goes on along a line beyond the first and the last knot."""
    k = np.arange(float(n))
    polynomial = np.stack([np.ones(n), k])
    # Interpolation at the knots; without the last two rows the spline would be curved beyond its ends.
    matrix = np.block([[polynomial.T, np.abs(k[:, None] - k) ** 3], [np.zeros((2, 2)), polynomial]])
    return np.linalg.solve(matrix, np.eye(n + 2, n))


def _basis(v: Any, low: Any, high: Any, n: int, library: Any) -> Any:
    """The cardinal splines (..., n) at `v` of any shape; the first knot is at `low`, the last one at `high`."""
    t = library.asarray((v - low) / (high - low) * (n - 1))
    W = _weights(n)
    return W[0] + t[..., None] * W[1] + library.abs(t[..., None] - np.arange(float(n))) ** 3 @ W[2:]


def spline(v: Any, low: Any, high: Any, *values: Any, library: Any = np) -> Any:
    """The natural cubic spline through `values` at evenly spaced knots from `low` to `high`, at `v` of any shape.

    Beyond the knots it is a straight line. `library` is `numpy` or `jax.numpy`; in the latter all is differentiable.
    """
    basis = _basis(v, low, high, len(values), library)
    return sum(basis[..., j] * value for j, value in enumerate(values))


def surface(v: Any, v_low: Any, v_high: Any, w: Any, w_low: Any, w_high: Any, *values: Any, library: Any = np) -> Any:
    """The smooth function of two variables through n^2 `values` on a grid, at `v` and `w`, whose shapes broadcast.

    sum_ij B_i(v) c_ij B_j(w) with the splines B of `spline`; value i n + j is c_ij, at knot i of v and j of w.
    """
    n = round(len(values) ** 0.5)
    of_v, of_w = _basis(v, v_low, v_high, n, library), _basis(w, w_low, w_high, n, library)
    return sum(of_v[..., k // n] * of_w[..., k % n] * value for k, value in enumerate(values))
