"""Parameters: differentiable scalar fields with a unit and a physical domain."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.core
import numpy as np
from jaxtyping import Array, Float

Scalar = Float[Array, ""]
"""One number: a JAX array of shape ()."""


T = TypeVar("T")


_FEW = 12
"""The most numbers of an array that a `repr` lists."""


class Domain(NamedTuple):
    """Domain of a parameter: `low <= value <= high` in `unit`; `positive` means strictly above zero.

    A fit moves the logarithm of a `multiplicative` parameter. `typical` (mean, standard deviation), if given, is a weak
    prior for the first steps of a fit; the final result does not depend on it.
    """

    unit: str
    low: float
    high: float
    positive: bool
    multiplicative: bool
    typical: tuple[float, float] | None = None

    def step_to(self, value: float) -> float:
        """The coordinate that a fit moves: ln(value) if multiplicative, else the value."""
        return math.log(value) if self.multiplicative else value

    def moved(self, value: float, step: float) -> float:
        """`value` after a `step` z: value exp(z) if multiplicative, else value + z; it may lie outside the domain."""
        return float(value * np.exp(step) if self.multiplicative else value + step)

    def moved_inside(self, value: float, step: float) -> float:
        """`moved`, and at the bound that this would cross."""
        return float(np.clip(self.moved(value, step), self.low, self.high))

    def complaint(self, value: float) -> str | None:
        """The reason why `value` is outside this domain, or None if it is inside."""
        if not math.isfinite(value):
            return "must be a finite number"
        if self.positive and value <= 0:
            return "must be above 0"
        if value < self.low:
            return f"must be at least {self.low:g}"
        if value > self.high:
            return f"must be at most {self.high:g}"
        return None


class Parameter(NamedTuple):
    """One scalar leaf of a module: its value and its domain."""

    value: Scalar
    domain: Domain


def _as_scalar(value: Any) -> Any:
    return value if value is None or isinstance(value, jax.Array) else np.asarray(value, np.float64)


def param(
    unit: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    positive: bool = False,
    multiplicative: bool = False,
    typical: tuple[float, float] | None = None,
    default: float | None = dataclasses.MISSING,  # type: ignore[assignment]
    meaning: str = "",
) -> Any:
    """A scalar field of an `equinox.Module` with a unit and a physical domain.

    **Arguments:** `unit`: SI, "-" for a pure number. `low`, `high`: closed bounds. `positive`: strictly above
    zero, and so multiplicative. `multiplicative`: a fit moves its logarithm. `typical`: see `Domain`. `default`: for an
    effect, the neutral value. `meaning`: what the value is, for a template of case.toml.
    """
    domain = Domain(unit, low, high, positive, positive or multiplicative, typical)
    kwargs = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(converter=_as_scalar, metadata={"domain": domain, "meaning": meaning}, **kwargs)


class Parametrised(eqx.Module):
    """A module whose `param` fields are checked against their domains when it is built from numbers.

    **Raises:** `ValueError` for a value that is not finite or lies outside its domain.
    """

    def __repr__(self) -> str:
        """`GroundSlope(sx=0.003 rad, sy=0 rad)`; of arrays, which are traced or many, the shape."""
        parts = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.repr}  # type: ignore[arg-type]
        units = {name: parameter.domain.unit for name, parameter in own_parameters(self)}
        texts = [f"{name}={_shown(value)}{unit_text(units.get(name, '-'))}" for name, value in parts.items()]
        return f"{type(self).__name__}({', '.join(texts)})"

    def __check_init__(self) -> None:
        for name, parameter in own_parameters(self):
            if isinstance(parameter.value, jax.core.Tracer) or np.ndim(parameter.value):
                continue
            if why := parameter.domain.complaint(float(parameter.value)):
                raise ValueError(f"{type(self).__name__}.{name} {why}, but it is {float(parameter.value):g}.")


def unit_text(unit: str) -> str:
    """The unit behind a number, none for a pure number."""
    return "" if unit == "-" else f" {unit}"


def _shown(value: Any) -> str:
    """A number to six digits, a small array as a list, another one by its shape."""
    if isinstance(value, jax.core.Tracer) or not isinstance(value, jax.Array | np.ndarray):
        return repr(value)
    if value.ndim == 0:
        return f"{float(value):.6g}"
    return repr(np.asarray(value).tolist()) if value.size <= _FEW else f"array of {'x'.join(map(str, value.shape))}"


def own_parameters(module: eqx.Module) -> Iterator[tuple[str, Parameter]]:
    """The `param` fields of one module with their values, without those of its submodules and without None."""
    for field in dataclasses.fields(module):  # type: ignore[arg-type]
        domain = field.metadata.get("domain")
        if domain is not None and getattr(module, field.name) is not None:
            yield field.name, Parameter(getattr(module, field.name), domain)


def parameters(tree: Any, prefix: str = "") -> dict[str, Parameter]:
    """All parameters in `tree` by dotted name: `tyre.B`, `effects.ground_slope.sx`."""
    if isinstance(tree, Mapping):
        parts = list(tree.items())
    elif isinstance(tree, tuple | list):
        parts = [(str(i), part) for i, part in enumerate(tree)]
    elif isinstance(tree, eqx.Module):
        own_values = {f"{prefix}{name}": parameter for name, parameter in own_parameters(tree)}
        names = [f.name for f in dataclasses.fields(tree) if "domain" not in f.metadata]  # type: ignore[arg-type]
        return own_values | parameters({name: getattr(tree, name) for name in names}, prefix)
    else:
        return {}
    result: dict[str, Parameter] = {}
    for name, part in parts:
        result |= parameters(part, f"{prefix}{name}.")
    return result


def _getter(name: str) -> Callable[[Any], Any]:
    def get(tree: Any) -> Any:
        for part in name.split("."):
            if isinstance(tree, Mapping):
                tree = tree[part]
            elif isinstance(tree, tuple | list):
                tree = tree[int(part)]
            else:
                tree = getattr(tree, part)
        return tree

    return get


def short_name(name: str) -> str:
    """The name of a parameter in tables, messages and options: `B` for `tyre.B`, the dotted name for all others."""
    return name.removeprefix("tyre.")


def require_in_domain(values: Mapping[str, Any], known: Mapping[str, Parameter]) -> None:
    """Check `values` by dotted name; tracers and arrays of several numbers are not checked.

    **Raises:** `ValueError` for a name that is not `known` or a number outside its domain.
    """
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"There is no parameter `{name}`; known: {', '.join(known)}.")
        if not isinstance(value, jax.core.Tracer) and np.ndim(value) == 0:
            if why := known[name].domain.complaint(float(value)):
                raise ValueError(f"Parameter `{name}` {why}, but it is {float(value):g}.")


def with_parameters(tree: T, values: Mapping[str, Any]) -> T:
    """`tree` with the parameters in `values` (by dotted name) replaced; values may be JAX tracers.

    **Raises:** `ValueError` for an unknown name or a number outside its domain.
    """
    require_in_domain(values, parameters(tree))
    getters = [_getter(name) for name in values]
    if not getters:
        return tree
    return eqx.tree_at(lambda t: [get(t) for get in getters], tree, [_as_scalar(v) for v in values.values()])
