"""Taylor series of a model: the traced equations of motion as expressions of heyoka, with derivatives of any order.

A trace of the rates is split by what its quantities depend on. What depends on parameters alone is computed once for
each member, by JAX; what depends on time or state becomes an expression. A branch on parameters or on time is decided
before the integration; it is part of the expressions. A series does not extend across a branch on the state: such a
model is refused with the reason.
"""

import enum
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jax.extend.source_info_util import summarize

from snakejax.core.fast_math import ARCTAN, SINE_COSINE, arctan, sine_cosine
from snakejax.dynamics.contact import SLIP_ANGLE, slip_angle


class NoTaylorSeries(ValueError):
    """The reason why a model has no Taylor series along its whole run."""


class Level(enum.IntEnum):
    """What a quantity depends on: on nothing that varies, on the parameters of a member, on time, or on the state."""

    CONSTANT, MEMBER, TIME, STATE = range(4)


class Operation(NamedTuple):
    """One operation of a trace, and the numbers of the quantities that it takes and gives.

    `sources` are the places in the code of the functions that call it, the innermost last.
    """

    name: str
    equation: jex.JaxprEqn
    takes: tuple[int, ...]
    gives: tuple[int, ...]
    sources: tuple[Any, ...]

    def refused(self, what: str) -> NoTaylorSeries:
        """The error for this operation, with the line of the code."""
        lines = [line for line in map(summarize, self.sources) if line]
        place = lines[-1].rsplit("/", 1)[-1] if lines else "an unknown line"
        return NoTaylorSeries(f"{what}: `{self.name}` at {place}")


_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr"}
_CALLS |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "custom_vjp_call_jaxpr": "fun_jaxpr"}
"""Primitives that call a function, and the parameter that holds it; the function is inlined."""
_OWN = {SINE_COSINE: sine_cosine, ARCTAN: arctan, SLIP_ANGLE: slip_angle}
"""Functions of the package that are operations of their own."""
_CHOICES = {
    "select_n": lambda which, *cases: which.astype(int),
    "abs": lambda x: (x < 0).astype(int),
    "sign": lambda x: jnp.sign(x).astype(int),
    "max": lambda a, b: (a < b).astype(int),
    "min": lambda a, b: (a > b).astype(int),
    "clamp": lambda low, x, high: (x > high).astype(int) - (x < low).astype(int),
}
"""Primitives with branches: which branch is taken."""


class Trace:
    """A function of time, state and parameters as a list of operations without calls.

    `function(t, state, *leaves)` returns a list of scalars, `state` is a list of scalars; `varied[i]` says whether
    leaf i differs between members. `levels` says what each quantity depends on; `constants` are the known quantities.
    """

    def __init__(self, function: Callable, states: int, leaves: Sequence[np.ndarray], varied: Sequence[bool]) -> None:
        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
        number = jax.ShapeDtypeStruct((), np.float64)
        jaxpr = jax.make_jaxpr(function)(number, [number] * states, *shapes)
        self.operations: list[Operation] = []
        self.constants: dict[int, np.ndarray] = {}
        self.shapes: dict[int, tuple[int, ...]] = {}
        self._count = itertools.count()
        levels = [Level.TIME, *[Level.STATE] * states, *(Level.MEMBER if v else Level.CONSTANT for v in varied)]
        self.inputs = [next(self._count) for _ in levels]
        self.levels = dict(zip(self.inputs, levels, strict=True))
        self.shapes |= {k: tuple(var.aval.shape) for k, var in zip(self.inputs, jaxpr.jaxpr.invars, strict=True)}
        self.outputs = self._inlined(jaxpr, self.inputs)

    def _known(self, value: Any) -> int:
        number = next(self._count)
        self.constants[number], self.levels[number] = np.asarray(value), Level.CONSTANT
        self.shapes[number] = self.constants[number].shape
        return number

    def _inlined(self, closed: jex.ClosedJaxpr, arguments: Sequence[int], sources: tuple[Any, ...] = ()) -> list[int]:
        """Append the operations of `closed`; the numbers of its results."""
        jaxpr = closed.jaxpr
        numbers = dict(zip(jaxpr.invars, arguments, strict=True))
        numbers |= {var: self._known(value) for var, value in zip(jaxpr.constvars, closed.consts, strict=True)}

        def number(atom: Any) -> int:
            return self._known(atom.val) if isinstance(atom, jex.Literal) else numbers[atom]

        for equation in jaxpr.eqns:
            takes, primitive = [number(atom) for atom in equation.invars], equation.primitive.name
            own, called_by = equation.params.get("name"), (*sources, equation.source_info)
            if primitive in _CALLS and own not in _OWN:
                gives = self._inlined(equation.params[_CALLS[primitive]], takes, called_by)
            else:
                gives = [next(self._count) for _ in equation.outvars]
                name = own if own in _OWN else primitive
                self.operations.append(Operation(name, equation, tuple(takes), tuple(gives), called_by))
                level = max((self.levels[k] for k in takes), default=Level.CONSTANT)
                self.levels |= dict.fromkeys(gives, level)
                self.shapes |= {k: tuple(var.aval.shape) for k, var in zip(gives, equation.outvars, strict=True)}
            numbers |= dict(zip(equation.outvars, gives, strict=True))
        return [number(atom) for atom in jaxpr.outvars]

    def level(self, operation: Operation) -> Level:
        """What the results of `operation` depend on."""
        return self.levels[operation.gives[0]]

    def choice_level(self, operation: Operation) -> Level:
        """What decides the branch of `operation`."""
        deciding = operation.takes[:1] if operation.name == "select_n" else operation.takes
        return max(self.levels[k] for k in deciding)

    def needed(self, choices: Mapping[int, np.ndarray] | None = None) -> list[Operation]:
        """The operations on time or state that the outputs need; `choices` of a selection rule out the other cases."""
        wanted, kept = set(self.outputs), []
        for operation in reversed(self.operations):
            if not wanted.intersection(operation.gives) or self.level(operation) < Level.TIME:
                continue
            kept.append(operation)
            which = None if choices is None else choices.get(operation.gives[0])
            if operation.name == "select_n" and which is not None:
                wanted |= {operation.takes[1 + int(k)] for k in np.unique(which)}
            else:
                wanted |= set(operation.takes)
        return kept[::-1]

    def decisions(self) -> list[Operation]:
        """The branches on parameters and time among the operations on time or state."""
        return [op for op in self.needed() if op.name in _CHOICES and self.choice_level(op) < Level.STATE]

    def residuals(self) -> list[int]:
        """The quantities without time and state on which the others depend."""
        takes = [k for operation in self.needed() for k in operation.takes] + self.outputs
        return [k for k in dict.fromkeys(takes) if self.levels[k] < Level.TIME and k not in self.constants]

    def evaluated(self, wanted: Iterable[int], time: Any, leaves: Sequence[Any]) -> dict[int, Any]:
        """The quantities `wanted`, which do not depend on the state, by JAX at a `time` (None: without time)."""
        states = len(self.inputs) - 1 - len(leaves)
        values: dict[int, Any] = dict(self.constants) | {self.inputs[0]: time}
        values |= dict(zip(self.inputs[1 + states :], leaves, strict=True))
        most = Level.MEMBER if time is None else Level.TIME
        for operation in self.operations:
            if self.level(operation) <= most:
                primitive = operation.equation.primitive
                given = [jnp.asarray(values[k]) for k in operation.takes]
                own = _OWN.get(operation.name)
                results = own(*given) if own else primitive.bind(*given, **operation.equation.params)
                values |= dict(zip(operation.gives, results if len(operation.gives) > 1 else [results], strict=True))
        return {k: values[k] for k in wanted}

    def decided(self, time: Any, leaves: Sequence[Any]) -> list[Any]:
        """The branch of each of `decisions` at a `time`, by JAX."""
        operations = self.decisions()
        values = self.evaluated({k for op in operations for k in _deciding(op)}, time, leaves)
        return [_CHOICES[op.name](*(jnp.asarray(values[k]) for k in _deciding(op))) for op in operations]


def _deciding(operation: Operation) -> tuple[int, ...]:
    return operation.takes[:1] if operation.name == "select_n" else operation.takes


class Equations(NamedTuple):
    """Rates as expressions of heyoka in the variables `y0, y1, ...`, time and parameters.

    `parameters` lists (quantity, element) of each parameter: the residuals that differ between members.
    """

    system: list[tuple[Any, Any]]
    parameters: list[tuple[int, int]]


def equations(trace: Trace, constants: Mapping[int, np.ndarray], choices: Sequence[np.ndarray]) -> Equations:
    """The rates of `trace` with the values of its constant residuals and the branch of each of its decisions.

    **Raises:** `NoTaylorSeries` for a branch on the state, or an operation whose series is unknown.
    """
    import heyoka as hy

    states = [k for k in trace.inputs if trace.levels[k] == Level.STATE]
    variables = [hy.expression(f"y{k}") for k in range(len(states))]
    parameters: dict[tuple[int, int], int] = {}
    values = {k: _boxed(hy, value) for k, value in (trace.constants | dict(constants)).items()}
    values |= {k: _boxed(hy, v) for k, v in zip([trace.inputs[0], *states], [hy.time, *variables], strict=True)}

    def value(number: int) -> np.ndarray:
        if number not in values:
            shape = trace.shapes[number]
            elements = [(number, k) for k in range(int(np.prod(shape)))]
            values[number] = _boxed(hy, [hy.par[parameters.setdefault(e, len(parameters))] for e in elements], shape)
        return values[number]

    chosen = {op.gives[0]: np.asarray(w) for op, w in zip(trace.decisions(), choices, strict=True)}
    known_sines: dict[Any, tuple[Any, Any]] = {}
    for operation in trace.needed(chosen):
        which = chosen.get(operation.gives[0])
        if which is None:
            results = _smooth(hy, operation, [value(k) for k in operation.takes], known_sines)
        else:
            results = [_branch(operation, which, value)]
        values |= dict(zip(operation.gives, results, strict=True))
    rates = [value(k).item() for k in trace.outputs]
    return Equations(list(zip(variables, rates, strict=True)), list(parameters))


def _boxed(hy: Any, value: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """Expressions of heyoka as an array of objects."""
    items = [value] if isinstance(value, hy.expression) else value if isinstance(value, list) else np.ravel(value)
    boxed = np.empty(len(items), object)
    boxed[:] = [item if isinstance(item, hy.expression) else hy.expression(float(item)) for item in items]
    return boxed.reshape(shape if shape is not None else () if isinstance(value, hy.expression) else np.shape(value))


def _branch(operation: Operation, which: np.ndarray, value: Callable[[int], np.ndarray]) -> np.ndarray:
    """The result of an operation with branches where `which` says the branch of each element."""
    if operation.name in ("abs", "sign"):
        x = value(operation.takes[0])
        if operation.name == "sign":
            return _mapped(lambda item, k: 0.0 * item + float(k), [x, which])
        return _mapped(lambda item, k: -item if k else item, [x, which])
    if operation.name == "clamp":
        which = which + 1
    cases = operation.takes[1:] if operation.name == "select_n" else operation.takes
    used = {int(k): value(cases[int(k)]) for k in np.unique(which)}
    shape = next(iter(used.values())).shape if operation.name != "clamp" else np.shape(which)
    result = np.empty(shape, object)
    for at, k in np.ndenumerate(np.broadcast_to(which, shape)):
        case = used[int(k)]
        result[at] = case[at] if case.shape else case.item()
    return result


_FUNCTIONS = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")
_FUNCTIONS += ("exp", "expm1", "log", "log1p", "sqrt", "erf")
"""Functions that have the same name in JAX and in heyoka."""
_ELEMENTWISE: dict[str, Callable] = {
    "add": lambda hy, a, b: a + b,
    "add_any": lambda hy, a, b: a + b,
    "sub": lambda hy, a, b: a - b,
    "mul": lambda hy, a, b: a * b,
    "div": lambda hy, a, b: a / b,
    "neg": lambda hy, a: -a,
    "square": lambda hy, a: a * a,
    "pow": lambda hy, a, b: a**b,
    "rsqrt": lambda hy, a: 1.0 / hy.sqrt(a),
    "exp2": lambda hy, a: hy.exp(float(np.log(2.0)) * a),
    "logistic": lambda hy, a: hy.sigmoid(a),
    "copy": lambda hy, a: a,
    "copy_p": lambda hy, a: a,
    "convert_element_type": lambda hy, a: a,
    ARCTAN: lambda hy, a: hy.atan(a),
    SLIP_ANGLE: lambda hy, lateral, rolling, creep: hy.atan(lateral / hy.sqrt(rolling**2 + creep**2)),
    **{name: lambda hy, *given, name=name: getattr(hy, name)(*given) for name in _FUNCTIONS},
}
_REARRANGING = {"broadcast_in_dim", "reshape", "squeeze", "expand_dims", "slice", "transpose", "rev", "concatenate"}


def _smooth(hy: Any, operation: Operation, given: list[np.ndarray], known_sines: dict) -> list[np.ndarray]:
    """The results of an operation without branches."""
    name, params = operation.name, operation.equation.params
    if name == SINE_COSINE:
        return [_mapped(lambda x, k=k: _sine_cosine(hy, x, known_sines)[k], given) for k in (0, 1)]
    if name == "integer_pow":
        power = abs(params["y"])
        return [_mapped((lambda a: 1.0 / a**power) if params["y"] < 0 else (lambda a: a**power), given)]
    if name in _ELEMENTWISE:
        return [_mapped(lambda *items: _ELEMENTWISE[name](hy, *items), given)]
    if name == "reduce_sum":
        return [_boxed_sum(hy, given[0], params["axes"])]
    if name in _REARRANGING:
        ends = np.cumsum([0, *(part.size for part in given)])
        numbers = [np.arange(a, b).reshape(p.shape) for a, b, p in zip(ends, ends[1:], given, strict=False)]
        order = np.asarray(operation.equation.primitive.bind(*map(jnp.asarray, numbers), **params))
        return [np.concatenate([part.ravel() for part in given])[order.ravel()].reshape(order.shape)]
    if name in _CHOICES:
        raise operation.refused("its rates have a branch on the state")
    raise operation.refused("its rates have an operation without a known Taylor series")


def _sine_cosine(hy: Any, x: Any, known: dict) -> tuple[Any, Any]:
    """sin x and cos x; those of -x, which the other wheelset needs, follow without a series of their own."""
    if x not in known:
        sine, cosine = hy.sin(x), hy.cos(x)
        known |= {x: (sine, cosine), -x: (-sine, cosine)}
    return known[x]


def _mapped(function: Callable, given: Sequence[np.ndarray]) -> np.ndarray:
    items = [function(*element) for element in zip(*(part.ravel() for part in given), strict=True)]
    result = np.empty(len(items), object)
    result[:] = items
    return result.reshape(given[0].shape)


def _boxed_sum(hy: Any, x: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    kept = [k for k in range(x.ndim) if k not in axes]
    rows = x.transpose([*kept, *axes]).reshape(int(np.prod([x.shape[k] for k in kept])), -1)
    return _boxed(hy, [hy.sum(list(row)) for row in rows], tuple(x.shape[k] for k in kept))
