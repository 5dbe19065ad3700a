"""A made-up linear problem in place of recordings: residual = data - columns @ values, noise of variance one.

It has the attributes of a `CandidateSet` that the decisions of the selection look at, and its fits are `lstsq`.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.estimation.linearisation import Linearised
from snakejax.estimation.problem import Solution


class LinearProblem(NamedTuple):
    """`columns` (R, 3 n, P) of the parameters `names`, `starts` (R, 3 n, S) of the start states, `data` (R, 3 n)."""

    names: tuple[str, ...]
    columns: np.ndarray
    starts: np.ndarray
    data: np.ndarray
    base: tuple[str, ...] = ("tyre.D",)

    @property
    def candidate_set(self) -> CandidateSet:
        """What a decision is given."""
        effects = {name.split(".")[1]: (name,) for name in self.names if name not in self.base}
        batch = SimpleNamespace(free_start=np.ones((len(self.data), self.starts.shape[-1])))
        problem = SimpleNamespace(batch=batch, width=len(self.names))
        made: dict[str, Any] = {"problem": problem, "train": list(range(len(self.data))), "candidates": effects}
        return SimpleNamespace(**made, criteria=CRITERIA, tyre=self.base, free=self.free, probes=dict)  # type: ignore

    def free(self, effects: Sequence[str]) -> list[str]:
        """The parameters of a model with `effects`."""
        return [*self.base, *(f"effects.{effect}.p" for effect in effects)]

    def fit(self, effects: Sequence[str]) -> CandidateFit:
        """Least squares with `effects`, each run with start states of its own."""
        free = self.free(effects)
        (R, N), P, S = self.data.shape, len(free), self.starts.shape[-1]
        X = self.columns[..., [self.names.index(name) for name in free]]
        whole = np.zeros((R, N, P + R * S))
        whole[..., :P] = X
        for k in range(R):
            whole[k, :, P + k * S : P + (k + 1) * S] = self.starts[k]
        flat = whole.reshape(R * N, -1)
        best = np.linalg.lstsq(flat, self.data.ravel(), rcond=None)[0]
        residual = (self.data.ravel() - flat @ best).reshape(R, N)
        jacobian = np.zeros((R, N, len(self.names) + S))
        jacobian[..., :P], jacobian[..., len(self.names) :] = -X, -self.starts
        linearised = Linearised(residual.reshape(R, -1, 3), jacobian.reshape(R, -1, 3, jacobian.shape[-1]))
        values = dict.fromkeys(self.names, 0.0) | dict(zip(free, best[:P], strict=True))
        covariance = np.linalg.inv(flat.T @ flat)[:P, :P]
        misfit, start = float(np.mean(residual**2)), best[P:].reshape(R, S)
        return CandidateFit(
            tuple(effects),
            Solution(values, tuple(free), (), start, linearised, covariance, misfit, residual.size, 1, True),
        )


def linear_problem(truth: dict[str, float], runs: int = 3, rows: int = 120, seed: int = 0) -> LinearProblem:
    """A base column and four candidates a, b, c, d; c is nearly a + b. `truth`: their values."""
    draw = np.random.default_rng(seed)
    names = ("tyre.D", "effects.a.p", "effects.b.p", "effects.c.p", "effects.d.p")
    columns = draw.normal(size=(runs, rows, 5))
    columns[..., 3] = (columns[..., 1] + columns[..., 2] + 0.5 * columns[..., 3]) / 1.5
    values = np.array([truth.get(name.split(".")[1], 0.0) for name in names])
    starts = draw.normal(size=(runs, rows, 2))
    data = columns @ values + starts @ draw.normal(size=2) + draw.normal(size=(runs, rows))
    return LinearProblem(names, columns, starts, data)
