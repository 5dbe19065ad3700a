"""The Gaussian process of a free force: its size and duration, and the most probable force with its error."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from .piecewise_force import SPACING

PIECE = 200
"""Knots of a run at most that the prior correlates: the force of a longer run is independent in pieces of 20 s, many
times its longest correlation time, so that the work grows in proportion to the length of a run."""


class Window(NamedTuple):
    """What one window says, its start state projected out: r = H f + G g + B p + noise, f and g at its own knots.

    `data` (N,) is the residual of a board without the free force; `back` gives the start from what is left over.
    """

    data: np.ndarray
    force: np.ndarray
    grip: np.ndarray
    parameters: np.ndarray
    back: tuple[np.ndarray, np.ndarray, np.ndarray]


class Normal(NamedTuple):
    """The normal equations of one run in its force knots, channel after channel, and the parameters."""

    A: np.ndarray
    b: np.ndarray
    B: np.ndarray
    PP: np.ndarray
    p: np.ndarray


class Prior(NamedTuple):
    """The Gaussian process: standard deviation (3,) of X, Y, N, and their correlation time [s]."""

    sd: np.ndarray
    time: float

    def near(self, other: "Prior") -> bool:
        """Whether the two differ by less than a tenth in every part that is not negligible."""
        ratio = np.log([*self.sd, self.time]) - np.log([*other.sd, other.time])
        small = np.array([*(np.maximum(self.sd, other.sd) < 1e-3), False])
        return bool((np.abs(ratio)[~small] < 0.1).all())

    def root(self, count: int) -> np.ndarray:
        """Cholesky factor (count, count) of the Matérn-3/2 correlation between knots."""
        lag = np.sqrt(3.0) * SPACING * np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / self.time
        # The small constant keeps far knots from correlations so tiny that arithmetic with them is slow.
        return np.linalg.cholesky((1 + lag) * np.exp(-lag) + 1e-6 + 1e-8 * np.eye(count))

    def distance(self, force: np.ndarray) -> float:
        """The square of the `force` (count, 3) of a run in standard deviations: f^T C^-1 f."""
        parts = [linalg.solve_triangular(self.root(len(f)), f, lower=True) for f in _pieces(force / self.sd)]
        return float(sum((part**2).sum() for part in parts))

    def factor(self, count: int) -> np.ndarray:
        """Cholesky factor (3 count, 3 count) of the covariance of X, Y, N at knots, channel after channel."""
        return np.kron(np.diag(self.sd), self.root(count))


FIRST = Prior(np.array([0.3, 0.3, 0.05]), 0.5)
"""Start of the search for the prior: standard deviations of X, Y [N] and N [N m], and a time constant [s]."""


class Posterior(NamedTuple):
    """Parameter step (P,) with its covariance, and the knots (Kr, 3) of each run with their variance."""

    step: np.ndarray
    covariance: np.ndarray
    force: list[np.ndarray]
    variance: list[np.ndarray]


def observable_components(normal: Sequence[Normal]) -> np.ndarray:
    """Which of X, Y, N (3,) the board feels at all."""
    size = np.sum([np.diag(part.A).reshape(3, -1).sum(axis=1) for part in normal], axis=0)
    return size > 1e-9 * size.max()


def _pieces(values: np.ndarray) -> list[np.ndarray]:
    """`values` (count, ...) at the knots of a run in equal pieces of at most `PIECE`."""
    return np.array_split(values, -(-len(values) // PIECE))


class _Whitened:
    """I + L^T A L of one run and its block Cholesky factor: L is block diagonal, a block a piece of the run, and A has
    entries within pieces and between neighbours alone, because no window is longer than a piece."""

    def __init__(self, A: np.ndarray, prior: Prior) -> None:
        count = len(A) // 3
        knots = _pieces(np.arange(count))
        self.places = [(np.arange(3)[:, None] * count + piece).reshape(-1) for piece in knots]
        self.roots = [prior.factor(len(piece)) for piece in knots]
        self.diagonal: list[np.ndarray] = []
        self.below: list[np.ndarray] = []
        for j, (place, L) in enumerate(zip(self.places, self.roots, strict=True)):
            M = np.eye(len(place)) + L.T @ (A[np.ix_(place, place)] @ L)
            if j > 0:
                beside = L.T @ (A[np.ix_(place, self.places[j - 1])] @ self.roots[j - 1])
                self.below.append(linalg.solve_triangular(self.diagonal[-1], beside.T, lower=True).T)
                M -= self.below[-1] @ self.below[-1].T
            self.diagonal.append(np.linalg.cholesky(M))

    def forward(self, columns: np.ndarray) -> list[np.ndarray]:
        """The inverse of the factor times L^T `columns`, piece by piece."""
        right = [L.T @ columns[place] for L, place in zip(self.roots, self.places, strict=True)]
        return self._solved(right, 0)

    def _solved(self, right: list[np.ndarray], first: int) -> list[np.ndarray]:
        """The inverse of the factor times `right`, the rows from piece `first` on; those before are zero."""
        done: list[np.ndarray] = []
        for j, rows in enumerate(right, first):
            rest = rows - self.below[j - 1] @ done[-1] if done else rows
            done.append(linalg.solve_triangular(self.diagonal[j], rest, lower=True))
        return done

    def force(self, rows: list[np.ndarray]) -> np.ndarray:
        """L times the inverse of the transposed factor times `rows`: the knots, channel after channel."""
        knots, after = np.zeros(sum(map(len, self.places))), None
        for j in reversed(range(len(rows))):
            rest = rows[j] if after is None else rows[j] - self.below[j].T @ after
            after = linalg.solve_triangular(self.diagonal[j].T, rest)
            knots[self.places[j]] = self.roots[j] @ after
        return knots

    def variance(self, Z: list[np.ndarray], factor: tuple[np.ndarray, bool]) -> np.ndarray:
        """The variance of the knots, for known parameters and with their covariance, the inverse of `factor`."""
        own = np.zeros(sum(map(len, self.places)))
        for j, (place, L) in enumerate(zip(self.places, self.roots, strict=True)):
            zero = [np.zeros((len(other), len(place))) for other in self.places[j + 1 :]]
            spread = np.concatenate(self._solved([L.T, *zero], j))
            carried = spread.T @ np.concatenate([rows[:, 1:] for rows in Z[j:]])
            own[place] = (spread**2).sum(axis=0)
            own[place] += np.einsum("kp,pk->k", carried, linalg.cho_solve(factor, carried.T))
        return own


def posterior(
    normal: Sequence[Normal], prior: Prior, typical: tuple[np.ndarray, np.ndarray], sd: bool = False
) -> Posterior:
    """Force and parameters given the data: with f = L w the normal equations are I + L^T A L, w standard normal.

    `typical`: the step of the parameters to what is typical, and one over its variance.
    """
    pull, precision = typical
    N, v, parts = np.diag(precision + 1e-9), precision * pull, []
    for part in normal:
        whitened = _Whitened(part.A, prior)
        Z = whitened.forward(np.column_stack([part.b, part.B]))
        N = N + part.PP - sum(rows[:, 1:].T @ rows[:, 1:] for rows in Z)
        v = v + part.p - sum(rows[:, 1:].T @ rows[:, 0] for rows in Z)
        parts.append((whitened, Z))
    factor = linalg.cho_factor(N)
    step = linalg.cho_solve(factor, v)
    force, variance = [], []
    for whitened, Z in parts:
        force.append(whitened.force([rows[:, 0] - rows[:, 1:] @ step for rows in Z]).reshape(3, -1).T)
        if sd:
            variance.append(whitened.variance(Z, factor).reshape(3, -1).T)
    return Posterior(step, linalg.cho_solve(factor, np.eye(len(pull))), force, variance)


def fitted_prior(
    windows: Sequence[Window], observable: np.ndarray, prior: Prior, typical: tuple[np.ndarray, np.ndarray]
) -> Prior:
    """The prior under which the windows are most probable, each with a force of its own:

    -2 log evidence = log|I + L^T A L| + log|N| + y^2 - b^T (C^-1 + A)^-1 b - (the fall by the parameters)
    """
    pull, precision = typical
    K, P = windows[0].force.shape[1] // 3, len(pull)
    order = (np.arange(K)[None, :] * 3 + np.arange(3)[:, None]).reshape(-1)
    A, right = np.zeros((len(windows), 3 * K, 3 * K)), np.zeros((len(windows), 3 * K, 1 + P))
    PP, p = np.zeros((P, P)), np.zeros(P)
    for k, window in enumerate(windows):
        H, other = window.force[:, order], np.column_stack([window.data, window.parameters])
        A[k], right[k] = H.T @ H, H.T @ other
        PP, p = PP + window.parameters.T @ window.parameters, p + window.parameters.T @ window.data

    def unpacked(z: np.ndarray) -> Prior:
        sd = np.full(3, np.exp(np.clip(z[:-1], -12.0, 7.0)).max())
        sd[observable] = np.exp(np.clip(z[:-1], -12.0, 7.0))
        return Prior(sd, float(np.exp(np.clip(z[-1], np.log(0.15), np.log(5.0)))))

    def cost(z: np.ndarray) -> float:
        trial = unpacked(z)
        L = trial.factor(K)
        M = np.eye(3 * K) + L.T @ A @ L
        Z = np.linalg.solve(M, L.T @ right)
        inner = np.einsum("wki,wkj->ij", L.T @ right, Z)
        N, v = np.diag(precision + 1e-9) + PP - inner[1:, 1:], precision * pull + p - inner[1:, 0]
        size = np.linalg.slogdet(M)[1].sum() + np.linalg.slogdet(N)[1]
        far = float(((z - np.clip(z, -12.0, 7.0)) ** 2).sum())
        return float(size - inner[0, 0] - v @ np.linalg.solve(N, v)) + far

    start = np.log([*prior.sd[observable], prior.time])
    simplex = np.concatenate([start[None], start + 1.0 * np.eye(start.size)])
    options = {"initial_simplex": simplex, "xatol": 0.1, "fatol": 0.5, "maxfev": 120}
    return unpacked(optimize.minimize(cost, start, method="Nelder-Mead", options=options).x)
