"""What a fit minimises."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import huber

from snakejax.estimation.problem import Problem


@pytest.mark.parametrize("threshold", [0.5, 2.0, np.inf])
def test_the_cost_is_twice_that_of_scipy(threshold: float) -> None:
    residual = np.random.default_rng(0).normal(size=(3, 50, 3)) * 2
    solution: Any = SimpleNamespace(linearised=SimpleNamespace(residual=residual))
    problem: Any = SimpleNamespace(threshold=threshold)
    expected = 2 * huber(min(threshold, 1e6), residual[[0, 2]]).sum()
    assert Problem.cost(problem, solution, [0, 2]) == pytest.approx(expected, rel=1e-12)
