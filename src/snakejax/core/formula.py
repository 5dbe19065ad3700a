"""Formulas written as text: arithmetic of named numbers, read once and evaluated with NumPy or JAX."""

import ast
import functools
import math
from collections.abc import Mapping
from typing import Any

from .errors import InputError
from .smooth_functions import spline, surface

FUNCTIONS = ("sin", "cos", "tanh", "exp", "log", "abs", "sign", "sqrt", "clip")
"""The functions of a library of arrays that a formula may call; `clip(v, low, high)`."""
SMOOTH_FUNCTIONS = {"spline": spline, "surface": surface}
"""The smooth functions through values at knots that it may call, see `core.smooth_functions`."""

_OPERATORS = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


@functools.cache
def parsed(text: str) -> ast.expr:
    """The tree of one formula such as `-k * (x - x0)`, in Python's notation; the same tree for the same text.

    **Raises:** `InputError` for anything but names, numbers, + - * / **, and calls of `FUNCTIONS` and
    `SMOOTH_FUNCTIONS`.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(f"`{text}` is no formula", "expression", "write it as in `-k * (x - x0)`") from None
    for node in ast.walk(tree):
        if not _admissible(node):
            what = f"`{text}` has a part that no formula may have: {type(node).__name__}"
            raise InputError(
                what, "expression", f"use names, numbers, + - * / ** and {', '.join((*FUNCTIONS, *SMOOTH_FUNCTIONS))}"
            )
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            node.text = ast.unparse(node)  # type: ignore[attr-defined]
    return tree


def _admissible(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and not node.keywords and _callable(node.func.id, len(node.args))
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.BinOp):
        # A power of a variable number would be NaN for negative bases.
        return type(node.op) in _OPERATORS and not (
            isinstance(node.op, ast.Pow) and not isinstance(node.right, ast.Constant)
        )
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.USub)
    return isinstance(node, ast.Name | ast.Load | ast.operator | ast.unaryop)


def _callable(name: str, arguments: int) -> bool:
    """Whether a formula may call a function with so many arguments."""
    if name == "spline":
        return arguments >= 5
    if name == "surface":
        return arguments >= 10 and math.isqrt(arguments - 6) ** 2 == arguments - 6
    return name in FUNCTIONS


def names_in(tree: ast.expr) -> tuple[str, ...]:
    """The names of the numbers in a formula, in the order in which they first stand there."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called]
    return tuple(dict.fromkeys(node.id for node in sorted(nodes, key=lambda node: (node.lineno, node.col_offset))))


def evaluated(tree: ast.expr, values: Mapping[str, Any], library: Any, known: dict[str, Any] | None = None) -> Any:
    """The value of a formula at `values`, with the functions of `library`, which is `numpy` or `jax.numpy`.

    `known`: calls of functions at these values by their text, which other formulas have evaluated; new ones are added.
    """
    if isinstance(tree, ast.Constant):
        return float(tree.value)  # type: ignore[arg-type]
    if isinstance(tree, ast.Name):
        return values[tree.id]
    if isinstance(tree, ast.UnaryOp):
        return -evaluated(tree.operand, values, library, known)
    if isinstance(tree, ast.Call):
        if known is None:
            return _called(tree, values, library, None)
        text: str = tree.text  # type: ignore[attr-defined]
        if text not in known:
            known[text] = _called(tree, values, library, known)
        return known[text]
    assert isinstance(tree, ast.BinOp)
    left = evaluated(tree.left, values, library, known)
    if isinstance(tree.op, ast.Pow):
        power = evaluated(tree.right, values, library, known)
        return left ** (int(power) if power == int(power) else power)
    return _OPERATORS[type(tree.op)](left, evaluated(tree.right, values, library, known))


def _called(tree: ast.Call, values: Mapping[str, Any], library: Any, known: dict[str, Any] | None) -> Any:
    """The value of a function."""
    given = [evaluated(part, values, library, known) for part in tree.args]
    name: str = tree.func.id  # type: ignore[attr-defined]
    smooth = SMOOTH_FUNCTIONS.get(name)
    return getattr(library, name)(*given) if smooth is None else smooth(*given, library=library)
