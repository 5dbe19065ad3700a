"""The signals of a run by the names of the inputs of its vehicle."""

import abc
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from snakejax.core.parameter import Scalar

from .signals import AbstractSignal, Joint, Logged


class AbstractInputs(eqx.Module):
    """The signals of a run by the names of the vehicle's inputs."""

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """The names of the signals that are given."""

    @abc.abstractmethod
    def signal(self, name: str) -> AbstractSignal:
        """The signal of the input `name`."""

    @abc.abstractmethod
    def changed(self, name: str, change: Callable[[AbstractSignal], AbstractSignal]) -> Self:
        """These inputs with `change` applied to the signal of `name`, and to those that follow it."""

    def at(self, t: Scalar) -> dict[str, Joint]:
        """Value, rate and acceleration of every signal at time `t` [s]."""
        return {name: self.signal(name).at(t) for name in self.names}

    def begins(self) -> Scalar:
        """The time [s] at which a simulation from rest starts: 0, or the earliest onset of a logged joint before 0."""
        return jnp.min(jnp.stack([jnp.zeros(()), *(log.onset for log in logs_of(self))]))


class Gait(AbstractInputs):
    """Joint signals: steering `phi` of the front wheelset (the back one turns the other way) and rotor `psi`.

    `phi_back`, if given, is the independent signal of the back wheelset, positive in the same direction as the front.
    """

    phi: AbstractSignal
    psi: AbstractSignal
    phi_back: AbstractSignal | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """phi, psi and, if it is given, phi_back."""
        return ("phi", "psi") if self.phi_back is None else ("phi", "psi", "phi_back")

    def signal(self, name: str) -> AbstractSignal:
        """The signal of one joint."""
        return getattr(self, name)

    def changed(self, name: str, change: Callable[[AbstractSignal], AbstractSignal]) -> "Gait":
        """This gait with one signal changed; `phi` stands for the steering of both wheelsets."""
        if name == "psi":
            return Gait(self.phi, change(self.psi), self.phi_back)
        if name == "phi_back":
            return Gait(self.phi, self.psi, None if self.phi_back is None else change(self.phi_back))
        return Gait(change(self.phi), self.psi, None if self.phi_back is None else change(self.phi_back))


class Commanded(AbstractInputs):
    """Inputs on which all changes by effects have been made already: `Model.prepared` makes them once for a run."""

    inputs: AbstractInputs

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the signals."""
        return self.inputs.names

    def signal(self, name: str) -> AbstractSignal:
        """The signal of one input."""
        return self.inputs.signal(name)

    def changed(self, name: str, change: Callable[[AbstractSignal], AbstractSignal]) -> "Commanded":
        """These inputs with one signal changed."""
        return Commanded(self.inputs.changed(name, change))


def as_gait(inputs: AbstractInputs) -> Gait:
    """`inputs`, which are those of a snakeboard. **Raises:** `TypeError` for those of another vehicle."""
    if not isinstance(inputs, Gait):
        raise TypeError(f"A snakeboard is driven by a Gait, not by {type(inputs).__name__}.")
    return inputs


class Inputs(AbstractInputs):
    """The signals of any vehicle by name: `Inputs({"steer": ..., "drive": ...})`."""

    signals: OrderedDict[str, AbstractSignal]

    def __init__(self, signals: Mapping[str, AbstractSignal] | Iterable[tuple[str, AbstractSignal]]) -> None:
        self.signals = OrderedDict(signals)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the signals."""
        return tuple(self.signals)

    def signal(self, name: str) -> AbstractSignal:
        """The signal of one input."""
        return self.signals[name]

    def changed(self, name: str, change: Callable[[AbstractSignal], AbstractSignal]) -> "Inputs":
        """These inputs with one signal changed."""
        return Inputs((key, change(signal) if key == name else signal) for key, signal in self.signals.items())


def _is_logged(part: Any) -> bool:
    return isinstance(part, Logged)


def logs_of(gait: AbstractInputs) -> list[Logged]:
    """The logs of `gait`."""
    return [part for part in jax.tree.leaves(gait, is_leaf=_is_logged) if _is_logged(part)]


G = TypeVar("G", bound=AbstractInputs)


def _is_signal(part: Any) -> bool:
    return isinstance(part, AbstractSignal)


def with_signals(gait: G, change: Callable[[AbstractSignal], AbstractSignal]) -> G:
    """`gait` with `change` applied to the signal of each input."""
    return jax.tree.map(change, gait, is_leaf=_is_signal)


def with_logs(gait: G, change: Callable[[Logged], Logged]) -> G:
    """`gait` with `change` applied to each of its logs."""
    return jax.tree.map(
        lambda part: change(part) if _is_logged(part) else part,
        gait,
        is_leaf=_is_logged,
    )


def on_clock(gait: G, offset: Scalar, drift: Scalar) -> G:
    """`gait` with its logs moved to a clock that shows t when theirs shows t (1 + drift) + offset [s]."""
    return with_logs(gait, lambda log: log.on_clock(offset, drift))
