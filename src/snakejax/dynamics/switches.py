"""Switches of effects: a compiled program passes by the effects that can change nothing.

A search for a missing effect has all of them in one model, so that one program serves every candidate. Most of them are
neutral at a time.
"""

import dataclasses
from collections import OrderedDict
from collections.abc import Mapping
from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Bool

from snakejax.core.parameter import own_parameters

from .conditions import ByCondition

if TYPE_CHECKING:
    from .model import Model

Switches = OrderedDict[str, Bool[Array, ""]]
"""Whether an effect can change anything, by its name."""


def switches_of(model: "Model", moving: Mapping[str, Bool[Array, ""]]) -> Switches:
    """The switches of all effects of `model`; parameters may be traced.

    An effect is on where one of its parameters has another value than its default, which is neutral; where the
    derivative by one of them is asked, which `moving` says by dotted name; where its parameters differ between
    conditions; and where it has none.
    """
    conditions = model.effects_of(ByCondition)
    varied = {name for effect in conditions for difference in effect.differences for name in difference.names}
    switches: Switches = OrderedDict()
    for name, effect in model.effects.items():
        defaults = {field.name: field.default for field in dataclasses.fields(effect)}  # type: ignore[arg-type]
        known = {f"effects.{name}.{part}": (part, value.value) for part, value in own_parameters(effect)}
        on = [jnp.asarray(not known or not varied.isdisjoint(known))]
        for dotted, (part, value) in known.items():
            on += [jnp.asarray(value != _neutral(defaults[part])), jnp.asarray(moving.get(dotted, False))]
        switches[name] = jnp.any(jnp.stack(on))
    return switches


def _neutral(default: object) -> float:
    """The default of a parameter; one without default is never neutral."""
    return float(default) if isinstance(default, int | float) else jnp.nan
