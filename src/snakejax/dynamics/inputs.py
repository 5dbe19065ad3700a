"""Inputs of a run: the signals of its joints."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from snakejax.core.parameter import Scalar

from .signals import AbstractSignal, Logged


class Gait(eqx.Module):
    """Joint signals: steering `phi` of the front wheelset (the back one turns the other way) and rotor `psi`.

    `phi_back`, if given, is the independent signal of the back wheelset, positive in the same direction as the front.
    """

    phi: AbstractSignal
    psi: AbstractSignal
    phi_back: AbstractSignal | None = None

    def begins(self) -> Scalar:
        """The time [s] at which a simulation from rest starts: 0, or the earliest onset of a logged joint before 0."""
        return jnp.min(jnp.stack([jnp.zeros(()), *(log.onset for log in logs_of(self))]))


def _is_logged(part: Any) -> bool:
    return isinstance(part, Logged)


def logs_of(gait: Gait) -> list[Logged]:
    """The logs of `gait`."""
    return [part for part in jax.tree.leaves(gait, is_leaf=_is_logged) if _is_logged(part)]


def with_logs(gait: Gait, change: Callable[[Logged], Logged]) -> Gait:
    """`gait` with `change` applied to each of its logs."""
    return jax.tree.map(
        lambda part: change(part) if _is_logged(part) else part,
        gait,
        is_leaf=_is_logged,
    )


def on_clock(gait: Gait, offset: Scalar, drift: Scalar) -> Gait:
    """`gait` with its logs moved to a clock that shows t when theirs shows t (1 + drift) + offset [s]."""
    return with_logs(gait, lambda log: log.on_clock(offset, drift))
