"""Priors of what a fit of an inexact model moves: the tyre, the constants of the vehicle, the effects."""

from collections.abc import Mapping

import equinox as eqx
import numpy as np

from snakejax.core.parameter import Domain
from snakejax.dynamics.model import Model

from .strength import Scales

SHAPE_SD = 0.7
"""Relative standard deviation of a positive tyre parameter without a typical value (a factor of 2)."""
SIZE_SD = 1.0
"""That of the tyre's scale of force (a factor of 2.7)."""
SPEED_OF_SLIP = 0.3
"""A speed [m/s] for units with a speed in them, where slow vehicles slip."""


def with_own_inertia(model: Model) -> Model:
    """`model` whose total yaw inertia is a number of its own and not m L^2."""
    board = model.board
    if getattr(board, "inertia", 0.0) is not None:
        return model
    inertia = np.asarray(float(board.total_inertia))
    return eqx.tree_at(lambda m: m.board.inertia, model, inertia, is_leaf=lambda leaf: leaf is None)


def constant_sd(model: Model, stated: Mapping[str, float]) -> dict[str, float]:
    """{parameter: relative standard deviation} of the constants of the vehicle, `stated` [SI] or that of its kind."""
    known = {}
    for name, share in model.board.stated_sd.items():
        value = getattr(model.board, name, None)
        if value is not None and float(value) > 0:
            known[f"board.{name}"] = stated[name] / float(value) if name in stated else share
    return known


def tyre_sd(domain: Domain) -> float:
    """Standard deviation of the step of a tyre parameter."""
    if domain.typical is not None:
        return domain.typical[1] / (domain.typical[0] if domain.multiplicative else 1.0)
    return SHAPE_SD if domain.positive else SIZE_SD


def effect_sd(domain: Domain, model: Model, scales: Scales) -> float:
    """A large value of an effect's parameter in its unit: weak priors that only keep matrices regular.

    Forces are those that move the vehicle, lengths a fifth of its half length.
    """
    force = float(np.hypot(scales.force[0], scales.force[1]))
    length = float(model.board.length)
    per_speed = force / SPEED_OF_SLIP
    large = {
        "N": force,
        "N m": float(scales.force[2]) + force * length,
        "N s/m": per_speed,
        "N s^2/m^2": per_speed / SPEED_OF_SLIP,
        "N m s": per_speed * length**2,
        "m": 0.2 * length,
        "1/m": 0.1,
        "rad": 0.1,
        "s": 0.1,
        "-": 0.5,
    }
    return large.get(domain.unit, 1.0)
