"""The model with every candidate effect, the tyre and the constants of the vehicle as parameters with priors."""

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.parameter import parameters
from snakejax.dynamics.model import Model
from snakejax.estimation.discrepancy.priors import constant_sd, effect_sd, tyre_sd
from snakejax.estimation.discrepancy.strength import Scales


class CandidateModel(NamedTuple):
    """`model` and P parameters `names`, first those `always` free: of the tyre, of the vehicle, of effects of the base.

    `neutral` (P,): their values in the model; `sd` (P,): prior standard deviation of their steps; `candidates`: the
    numbers of the parameters of each effect; `probes`: a value for each parameter without a derivative at its neutral
    value; `tyre` and `constants`: the numbers of those that belong to the tyre and to the vehicle.
    """

    model: Model
    names: tuple[str, ...]
    neutral: np.ndarray
    sd: np.ndarray
    candidates: OrderedDict[str, tuple[int, ...]]
    probes: dict[int, float]
    always: tuple[int, ...]
    tyre: tuple[int, ...]
    constants: tuple[int, ...]

    def free(self, effects: tuple[str, ...]) -> np.ndarray:
        """The numbers of the parameters free in a model with `effects`."""
        return np.array([*self.always, *(k for effect in effects for k in self.candidates[effect])], int)


def movable_parameters(
    model: Model,
    tyre: Sequence[str],
    candidates: Mapping[str, Sequence[str]],
    base: Sequence[str],
    held: Collection[str] = (),
) -> tuple[str, ...]:
    """The parameters of a `CandidateModel` in their order: tyre, constants that are not `held`, effects of the `base`,
    other effects."""
    effects = [*base, *(effect for effect in candidates if effect not in base)]
    constants = (name for name in constant_sd(model, {}) if name not in held)
    return (*tyre, *constants, *(name for effect in effects for name in candidates[effect]))


def candidate_model(
    model: Model,
    tyre: tuple[str, ...],
    candidates: Mapping[str, tuple[str, ...]],
    base: Sequence[str],
    scales: Scales,
    stated_sd: Mapping[str, float],
    held: Collection[str] = (),
) -> CandidateModel:
    """`model`, which holds all `candidates` {effect: parameter names}, with priors from `scales` and `stated_sd`.

    The effects `base` are always in the model; constants of the vehicle that are `held` keep their value.
    """
    known = parameters(model)
    constants = {name: sd for name, sd in constant_sd(model, stated_sd).items() if name not in held}
    names = movable_parameters(model, tyre, candidates, base, held)
    always = len(tyre) + len(constants) + sum(len(candidates[effect]) for effect in base)
    sd = {name: tyre_sd(known[name].domain) for name in tyre} | constants
    sd |= {name: effect_sd(known[name].domain, model, scales) for name in names if name not in sd}
    place = {name: k for k, name in enumerate(names)}
    probes = {
        place[name]: 0.1 * step
        for effect, parts in candidates.items()
        for name in parts
        if (step := model.effects[effect].secant_step.get(name.rsplit(".", 1)[-1])) is not None
    }
    return CandidateModel(
        model,
        names,
        np.array([float(known[name].value) for name in names]),
        np.array([sd[name] for name in names]),
        OrderedDict((e, tuple(place[name] for name in candidates[e])) for e in candidates if e not in base),
        probes,
        tuple(range(always)),
        tuple(range(len(tyre))),
        tuple(range(len(tyre), len(tyre) + len(constants))),
    )
