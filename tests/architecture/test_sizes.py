"""Functions that one reads at a glance: at most 60 lines and 8 arguments."""

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "snakejax"
MOST_LINES, MOST_ARGUMENTS = 60, 8

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions_of(text: str) -> list[Function]:
    return [node for node in ast.walk(ast.parse(text)) if isinstance(node, Function)]


def lines_of(function: Function) -> int:
    """The lines of the body without its docstring."""
    body = function.body[ast.get_docstring(function) is not None :]
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def arguments_of(function: Function) -> int:
    """The arguments but for `self`; `*` and `**` count one each."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]
    return sum(argument.arg not in ("self", "cls") for argument in every)


def test_functions_are_small() -> None:
    large = {
        f"{file.relative_to(SOURCE)}:{function.lineno} {function.name}": (lines_of(function), arguments_of(function))
        for file in sorted(SOURCE.rglob("*.py"))
        for function in functions_of(file.read_text(encoding="utf-8"))
        if lines_of(function) > MOST_LINES or arguments_of(function) > MOST_ARGUMENTS
    }
    assert large == {}, "(lines, arguments) of functions that should be taken apart"


def test_what_is_counted() -> None:
    text = "class A:\n    def f(self, a, /, b, *c, d=1, **e):\n        'Says so.'\n        x = 1\n\n        return x"
    (function,) = functions_of(text)
    assert lines_of(function) == 3 and arguments_of(function) == 5
    assert lines_of(functions_of("def f():\n    'Nothing else.'")[0]) == 0
