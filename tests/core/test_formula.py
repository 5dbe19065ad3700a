"""Formulas as text: what they may hold, and their values."""

import numpy as np
import pytest

from snakejax import InputError
from snakejax.core.formula import evaluated, names_in, parsed


def test_a_formula_has_the_value_of_python() -> None:
    text = "-k * (x - x0) + a * tanh((v / s) ** 2) / 3 + clip(x, -1, 1) ** 3"
    values = {"k": 0.3, "x": 1.2, "x0": 0.5, "a": -2.0, "v": 0.7, "s": 0.4}
    expected = -0.3 * (1.2 - 0.5) - 2.0 * np.tanh((0.7 / 0.4) ** 2) / 3 + 1.0
    assert evaluated(parsed(text), values, np) == pytest.approx(expected, rel=1e-14)


def test_the_names_of_a_formula_stand_in_their_order_without_its_functions() -> None:
    assert names_in(parsed("b * sin(k * x) + a * x")) == ("b", "k", "x", "a")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a +",
        "__import__('os')",
        "a.real",
        "a if b else c",
        "[a]",
        "a ** b",
        "open(a)",
        "spline(a, 0, 1, b)",
        "surface(a, 0, 1, b, 0, 1, c, c, c)",
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="formula"):
        parsed(text)
