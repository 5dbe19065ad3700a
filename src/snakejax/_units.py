"""Parameters: differentiable scalar fields that know their unit and their physical domain."""

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


T = TypeVar("T")


class Domain(NamedTuple):
    """What a parameter may be: `low <= value <= high` in `unit`; `positive` means strictly above zero.

    A `multiplicative` parameter is moved by its logarithm in a fit. `typical` (mean, spread), where given, is a weak
    prior for the first steps of a fit; the result does not know it.
    """

    unit: str
    low: float
    high: float
    positive: bool
    multiplicative: bool
    typical: tuple[float, float] | None = None

    def step_to(self, value: float) -> float:
        """`value` in the coordinate that a fit moves."""
        return math.log(value) if self.multiplicative else value

    def moved(self, value: float, step: float) -> float:
        """`value` after a `step` in the coordinate that a fit moves; it may lie outside."""
        return float(value * np.exp(step) if self.multiplicative else value + step)

    def complaint(self, value: float) -> str | None:
        """Why `value` lies outside this domain, or None where it lies inside."""
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
) -> Any:
    """A scalar field of an `equinox.Module` with a unit and a physical domain.

    **Arguments:** `unit`: SI, "-" for a pure number. `low`, `high`: closed bounds. `positive`: strictly above
    zero, and so multiplicative. `multiplicative`: a fit moves its logarithm. `typical`: see `Domain`. `default`: for an
    effect, the neutral value.
    """
    domain = Domain(unit, low, high, positive, positive or multiplicative, typical)
    kwargs = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(converter=_as_scalar, metadata={"domain": domain}, **kwargs)


class Parametrised(eqx.Module):
    """A module whose `param` fields are checked against their domains when it is built from numbers."""

    def __check_init__(self) -> None:
        for name, parameter in own_parameters(self):
            if isinstance(parameter.value, jax.core.Tracer) or np.ndim(parameter.value):
                continue
            if why := parameter.domain.complaint(float(parameter.value)):
                raise ValueError(f"{type(self).__name__}.{name} {why}, but it is {float(parameter.value):g}.")


def own_parameters(module: eqx.Module) -> Iterator[tuple[str, Parameter]]:
    """The `param` fields of one module that hold a value, without those of its parts."""
    for field in dataclasses.fields(module):  # type: ignore[arg-type]
        domain = field.metadata.get("domain")
        if domain is not None and getattr(module, field.name) is not None:
            yield field.name, Parameter(getattr(module, field.name), domain)


def parameters(tree: Any, prefix: str = "") -> dict[str, Parameter]:
    """Every parameter below `tree`, by dotted name: `tyre.B`, `effects.ground_slope.sx`."""
    if isinstance(tree, Mapping):
        parts = list(tree.items())
    elif isinstance(tree, tuple | list):
        parts = [(str(i), part) for i, part in enumerate(tree)]
    elif isinstance(tree, eqx.Module):
        own = {f"{prefix}{name}": parameter for name, parameter in own_parameters(tree)}
        names = [f.name for f in dataclasses.fields(tree) if "domain" not in f.metadata]  # type: ignore[arg-type]
        return own | parameters({name: getattr(tree, name) for name in names}, prefix)
    else:
        return {}
    found: dict[str, Parameter] = {}
    for name, part in parts:
        found |= parameters(part, f"{prefix}{name}.")
    return found


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


def with_parameters(tree: T, values: Mapping[str, Any]) -> T:
    """`tree` with the parameters named in `values` replaced; values may be traced.

    **Raises:** `ValueError` for a name `tree` does not have, or a number outside its domain.
    """
    known = parameters(tree)
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"There is no parameter `{name}`; known: {', '.join(known)}.")
        if not isinstance(value, jax.core.Tracer) and np.ndim(value) == 0:
            if why := known[name].domain.complaint(float(value)):
                raise ValueError(f"Parameter `{name}` {why}, but it is {float(value):g}.")
    getters = [_getter(name) for name in values]
    if not getters:
        return tree
    return eqx.tree_at(lambda t: [get(t) for get in getters], tree, [_as_scalar(v) for v in values.values()])


def require_x64() -> None:
    """**Raises:** `RuntimeError` unless JAX computes in double precision."""
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise RuntimeError(
            'snakejax computes in double precision: call `jax.config.update("jax_enable_x64", True)` first.'
        )
