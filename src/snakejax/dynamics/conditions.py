"""Conditions of a recording: parameters that have other values on another floor, on another day, in another session."""

import functools
import re
import types
import zlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.errors import InputError
from snakejax.core.parameter import Parameter, Scalar, param, parameters, with_parameters

from .kinds import LABELS
from .ports import Effect

if TYPE_CHECKING:
    from .model import Model

FURTHEST = 20.0
"""A ratio is at most this number and at least its inverse."""
_UNFIT = re.compile(r"\W+")


def codes_of(labels: Mapping[str, str]) -> Float[np.ndarray, "4"]:
    """The labels of a run as numbers, in the order of `LABELS`; 0 for none. Different labels have different numbers but
    for one pair in 4e9 (CRC-32)."""
    return np.array([code_of(key, labels[key]) if key in labels else 0.0 for key in LABELS])


def code_of(key: str, label: str) -> float:
    """The number of one label."""
    return 1.0 + zlib.crc32(f"{key}={label}".encode())


class Difference(NamedTuple):
    """How the parameters `names` of a model differ in runs with one `label`: by the number `field` of an effect, their
    ratio where they are `relative`, else a difference in `unit`; it lies between `low` and `high`."""

    field: str
    names: tuple[str, ...]
    label: str
    relative: bool
    unit: str
    low: float
    high: float

    @property
    def neutral(self) -> float:
        """The number that changes nothing."""
        return 1.0 if self.relative else 0.0


class ByCondition(Effect):
    """Parameters that have other values in runs with certain labels: p times a ratio, or p plus a difference.

    Runs without one of these labels keep the values of the model.
    """

    key: ClassVar[str] = ""
    differences: ClassVar[tuple[Difference, ...]] = ()

    def inapplicable_because(self, model: "Model") -> str | None:
        known = parameters(model)
        for difference in self.differences:
            for name in difference.names:
                if name not in known:
                    return f"the model has no parameter `{name}`."
        return None

    def applied(self, model: "Model", codes: Float[Array, "4"]) -> "Model":
        """`model` with its parameters as they are in a run with the labels `codes`."""
        known = parameters(model)
        values: dict[str, Any] = {}
        for difference in self.differences:
            chosen = jnp.any(codes == code_of(self.key, difference.label))
            number = getattr(self, difference.field)
            for name in difference.names:
                value = values.get(name, known[name].value)
                other = value * number if difference.relative else value + number
                values[name] = jnp.where(chosen, other, value)
        return with_parameters(model, values)


@functools.cache
def by_condition(key: str, differences: tuple[Difference, ...]) -> type[ByCondition]:
    """The class of effects in which parameters differ by the label `key` as `differences` say.

    **Raises:** `InputError` where two labels give one name.
    """
    fields = {
        d.field: param(d.unit, low=d.low, high=d.high, multiplicative=d.relative, default=d.neutral)
        for d in differences
    }
    if len(fields) < len(differences):
        remedy = "write labels that differ in letters or digits"
        raise InputError(f"Two labels of the {key} differ in punctuation alone", "[[runs]] of case.toml", remedy)
    own = {
        "__annotations__": {d.field: Scalar for d in differences},
        "__module__": __name__,
        "key": key,
        "differences": differences,
        "description": f"Parameters have other values for each {key}.",
        **fields,
    }
    return types.new_class("ByCondition", (ByCondition,), exec_body=lambda namespace: namespace.update(own))


def differences_of(
    model: "Model", names: Iterable[str], labels: Iterable[str], called: str | None = None
) -> tuple[Difference, ...]:
    """How each of the parameters `names` may differ for each of `labels`; `called`: all by one ratio of that name."""
    known = parameters(model)
    groups = {_short(name): (name,) for name in names} if called is None else {called: tuple(names)}
    return tuple(
        _difference(f"{short}_{_UNFIT.sub('_', label)}", group, label, [known[name] for name in group])
        for label in labels
        for short, group in groups.items()
    )


def _short(name: str) -> str:
    """`tyre.front.D` as `front_D`."""
    return name.split(".", 1)[-1].replace(".", "_")


def _difference(field: str, names: tuple[str, ...], label: str, parts: list[Parameter]) -> Difference:
    values, domains = [float(p.value) for p in parts], [p.domain for p in parts]
    relative = all(d.multiplicative and v > 0 for d, v in zip(domains, values, strict=True))
    pairs = list(zip(domains, values, strict=True))
    if relative:
        low = max([1 / FURTHEST, *(d.low / v for d, v in pairs)])
        high = min([FURTHEST, *(d.high / v for d, v in pairs)])
        return Difference(field, names, label, True, "-", low, high)
    low, high = max(d.low - v for d, v in pairs), min(d.high - v for d, v in pairs)
    return Difference(field, names, label, False, domains[0].unit, low, high)
