"""Active effects: a compiled program passes by those that can change nothing.

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

ActiveEffects = OrderedDict[str, Bool[Array, ""]]
"""Whether an effect can change anything, by its name."""


def active_effects(model: "Model", moving: Mapping[str, Bool[Array, ""]]) -> ActiveEffects:
    """Which effects of `model` are active; parameters may be traced.

    `moving`: the parameters that are candidates of a fit, by dotted name, and whether the derivative by each is asked.
    An effect is passed by if all its parameters are candidates, none of them moves, and all have their defaults, which
    are neutral for a candidate. One whose parameters differ between conditions is active.
    """
    conditions = model.effects_of(ByCondition)
    varied = {name for effect in conditions for difference in effect.differences for name in difference.names}
    active: ActiveEffects = OrderedDict()
    for name, effect in model.effects.items():
        defaults = {field.name: field.default for field in dataclasses.fields(effect)}  # type: ignore[arg-type]
        known = {f"effects.{name}.{part}": (part, value.value) for part, value in own_parameters(effect)}
        if not known or not known.keys() <= moving.keys() or not varied.isdisjoint(known):
            active[name] = jnp.asarray(True)
            continue
        changed = [jnp.asarray(value != _neutral(defaults[part])) for part, value in known.values()]
        active[name] = jnp.any(jnp.stack([*changed, *(jnp.asarray(moving[dotted]) for dotted in known)]))
    return active


def _neutral(default: object) -> float:
    """The default of a parameter; one without default is never neutral."""
    return float(default) if isinstance(default, int | float) else jnp.nan
