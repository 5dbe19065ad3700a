"""The rates of a model as a plain C function, written from the operations that JAX traces."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jex

from snakejax.core.errors import InputError
from snakejax.core.jax_config import require_x64
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import InputModifier
from snakejax.dynamics.signals import AbstractSignal, Joint

C_TYPES = {"b": "int", "i": "long", "u": "unsigned long", "f": "double"}
INFIX = {
    **{"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"},
    **{"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="},
}
CALLS = {
    **{name: name for name in ("sqrt", "exp", "log", "log1p", "expm1", "floor", "ceil", "sin", "cos", "tan", "tanh")},
    **{name: name for name in ("atan", "asin", "acos", "sinh", "cosh", "atan2", "pow", "cbrt")},
    **{"abs": "fabs", "max": "snakejax_max", "min": "snakejax_min", "sign": "snakejax_sign"},
}
INLINED = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint")
UNCHANGED = ("optimization_barrier", "stop_gradient", "copy", "copy_p")
MOVED = ("squeeze", "reshape", "broadcast_in_dim", "slice", "transpose", "expand_dims", "rev")
"""Operations that only move the elements of an array."""

_HEAD = """\
/* {title}
 *
 * state: {states}
{inputs} *
 * SI units. The constants below are the parameters of the model.
 */
#include <math.h>

static double snakejax_max(double a, double b) {{ return a != a || b != b ? NAN : (a > b ? a : b); }}
static double snakejax_min(double a, double b) {{ return a != a || b != b ? NAN : (a < b ? a : b); }}
static double snakejax_sign(double a) {{ return a > 0 ? 1.0 : (a < 0 ? -1.0 : a); }}

"""
_JOINTS = " * joints: phi, phi', phi'', psi, psi', psi'' [rad, rad/s, rad/s^2] at that time\n"


class _Given(AbstractSignal):
    """A joint whose angle, rate and acceleration are inputs."""

    joint: Joint

    def at(self, t):
        del t
        return self.joint


def c_function(model: Model, gait: Gait | None = None, name: str = "snakejax_rates") -> str:
    """`Model.rates` as the text of a C99 file with one function, which needs only `math.h`.

    Without `gait`: `void NAME(double t, const double state[], const double joints[6], double rates[])` with the joints
    (phi, phi', phi'', psi, psi', psi'') at time t; with a `gait` of sines: `void NAME(double t, const double state[],
    double rates[])`. The state is that of `Model.start`: of the constraint, then the memories of tyre effects.

    **Raises:** `InputError` for a `name` that C does not take, for an effect that changes the command without a `gait`,
    or for an operation that cannot be written.
    """
    require_x64()
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        raise InputError(f"`{name}` is no name in C", "argument name", "take letters, digits and _")
    changing = [n for n, effect in model.effects.items() if isinstance(effect, InputModifier)]
    if gait is None and changing:
        what = f"`{changing[0]}` changes the command of a joint, not its angle at one instant"
        raise InputError(what, "argument gait", "give the gait, which is then part of the function")
    zero = jnp.zeros(())
    states, tree = jax.tree.flatten(model.start((zero, zero, zero)))
    values = {n: float(p.value) for n, p in parameters(model).items()}

    def rates(t: Any, state: list[Any], joints: list[Any], constants: list[Any]) -> list[Any]:
        used = with_parameters(model, dict(zip(values, constants, strict=True)))
        driven = Gait(_Given(Joint(*joints[:3])), _Given(Joint(*joints[3:]))) if gait is None else gait
        return jax.tree.leaves(used.rates(t, jax.tree.unflatten(tree, state), driven))

    joints = [zero] * (6 if gait is None else 0)
    traced = jax.make_jaxpr(rates)(zero, states, joints, [jnp.asarray(value) for value in values.values()])
    named = {n: re.sub(r"\W", "_", n) for n in values}
    inputs = [
        "t",
        *(f"state[{k}]" for k in range(len(states))),
        *(f"joints[{k}]" for k in range(len(joints))),
        *named.values(),
    ]
    writer = _Writer()
    results = writer.run(traced.jaxpr, traced.consts, [_scalar(text) for text in inputs])
    units = {n: p.domain.unit for n, p in parameters(model).items()}
    constants = [f"static const double {named[n]} = {_number(v)}; /* {units[n]} */" for n, v in values.items()]
    title = f"Rates of {type(model.board).__name__}, {type(model.tyre).__name__}, {model.structure}"
    effects = f" with {', '.join(model.effects)}" if model.effects else ""
    head = _HEAD.format(
        title=(title + effects).replace("*/", ""),
        states=f"{len(states)} numbers, in the order of Model.start",
        inputs=_JOINTS if gait is None else "",
    )
    joint_argument = "const double joints[6], " if gait is None else ""
    arguments = f"double t, const double state[{len(states)}], {joint_argument}double rates[{len(states)}]"
    assigned = [f"    rates[{k}] = {result.item()};" for k, result in enumerate(results)]
    body = [*writer.lines, "    (void)t;", *assigned]
    return head + "\n".join([*constants, "", f"void {name}({arguments})", "{", *body, "}"]) + "\n"


def _scalar(text: str) -> np.ndarray:
    scalar = np.empty((), object)
    scalar[()] = text
    return scalar


def _number(value: Any) -> str:
    """A literal that C reads as the same number."""
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    if isinstance(value, int | np.integer):
        return str(int(value))
    number = float(value)
    if number != number:
        return "NAN"
    if abs(number) == float("inf"):
        return "INFINITY" if number > 0 else "(-INFINITY)"
    text = repr(number)
    return f"({text})" if text.startswith("-") else text


def _texts(values: np.ndarray) -> np.ndarray:
    texts = np.empty(values.shape, object)
    for place in np.ndindex(values.shape):
        texts[place] = _number(values[place])
    return texts


class _Writer:
    """Statements in C for the equations of a jaxpr; each value is an array of expressions."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def run(self, jaxpr: Any, consts: Sequence[Any], arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The expressions of the results of `jaxpr`. **Raises:** `InputError` for an operation that is not known."""
        known: dict[Any, np.ndarray] = dict(zip(jaxpr.invars, arguments, strict=True))
        known |= {var: _texts(np.asarray(value)) for var, value in zip(jaxpr.constvars, consts, strict=True)}

        def read(atom: Any) -> np.ndarray:
            return _texts(np.asarray(atom.val)) if isinstance(atom, jex.Literal) else known[atom]

        for equation in jaxpr.eqns:
            results = self._of(equation, [read(atom) for atom in equation.invars])
            known.update(zip(equation.outvars, results, strict=True))
        return [np.asarray(read(atom), object) for atom in jaxpr.outvars]

    def _of(self, equation: Any, inputs: list[np.ndarray]) -> list[np.ndarray]:
        name, params = equation.primitive.name, equation.params
        if name in INLINED:
            inner = params.get("jaxpr", params.get("call_jaxpr", params.get("fun_jaxpr")))
            closed = inner if hasattr(inner, "consts") else jex.ClosedJaxpr(inner, ())
            return self.run(closed.jaxpr, closed.consts, inputs)
        if name in UNCHANGED:
            return inputs
        out = equation.outvars[0].aval
        if name in MOVED:
            return [_moved(equation, inputs[0])]
        if name == "concatenate":
            return [np.concatenate(inputs, axis=params["dimension"])]
        if name == "reduce_sum":
            return [self._assigned(_summed(inputs[0], params["axes"]), out)]
        return [self._assigned(np.vectorize(_expression(name, equation), otypes=[object])(*inputs), out)]

    def _assigned(self, expressions: np.ndarray, aval: Any) -> np.ndarray:
        """New variables for `expressions`."""
        names = np.empty(np.shape(expressions), object)
        for place in np.ndindex(names.shape):
            variable = f"v{len(self.lines)}"
            kind = C_TYPES[np.dtype(aval.dtype).kind]
            self.lines.append(f"    const {kind} {variable} = {np.asarray(expressions, object)[place]};")
            names[place] = variable
        return names


def _moved(equation: Any, array: np.ndarray) -> np.ndarray:
    """The array after an operation that only moves elements, which are numbered for that purpose."""
    numbers = np.arange(array.size).reshape(array.shape)
    places = np.asarray(equation.primitive.bind(jnp.asarray(numbers), **equation.params))
    return np.asarray(array, object).reshape(-1)[places.reshape(-1)].reshape(places.shape)


def _summed(array: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    for axis in sorted(axes, reverse=True):
        array = np.apply_along_axis(lambda row: f"({' + '.join(row)})", axis, array).astype(object)
    return np.asarray(array, object)


def _expression(name: str, equation: Any) -> Callable[..., str]:
    """The C expression of one operation on scalars. **Raises:** `InputError` for one that is not known."""
    kind = np.dtype(equation.outvars[0].aval.dtype).kind
    params = equation.params
    if name in INFIX and not (name == "div" and kind in "iu"):
        return lambda a, b: f"{a} {INFIX[name]} {b}"
    if name in CALLS and (name not in ("abs", "max", "min", "sign") or kind == "f"):
        return lambda *a: f"{CALLS[name]}({', '.join(a)})"
    if name == "integer_pow":
        power = int(params["y"])
        if 0 < power <= 8:
            return lambda a: " * ".join([a] * power)
        return lambda a: f"pow({a}, {power})"
    others: dict[str, Callable[..., str]] = {
        "neg": lambda a: f"-({a})",
        "square": lambda a: f"{a} * {a}",
        "rsqrt": lambda a: f"1.0 / sqrt({a})",
        "round": lambda a: f"nearbyint({a})" if int(params["rounding_method"]) == 1 else f"round({a})",
        "select_n": lambda which, *cases: _selected(which, cases),
        "clamp": lambda low, a, high: f"snakejax_min(snakejax_max({a}, {low}), {high})",
        "is_finite": lambda a: f"isfinite({a}) ? 1 : 0",
        "or": lambda a, b: f"{a} {'||' if kind == 'b' else '|'} {b}",
        "and": lambda a, b: f"{a} {'&&' if kind == 'b' else '&'} {b}",
        "not": lambda a: f"!{a}" if kind == "b" else f"~{a}",
        "convert_element_type": lambda a: f"({a}) != 0" if kind == "b" else f"({C_TYPES[kind]})({a})",
    }
    if name not in others:
        what = f"The operation `{name}` of the model cannot be written in C"
        raise InputError(what, "c_function()", "take a gait of sines, or leave out the effect that uses it")
    return others[name]


def _selected(which: str, cases: Sequence[str]) -> str:
    text = cases[-1]
    for number in range(len(cases) - 2, -1, -1):
        text = f"{which} == {number} ? {cases[number]} : ({text})"
    return text
