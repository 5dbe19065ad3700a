"""Signals of robots: commands held between samples, and actuators between a command and what acts."""

from typing import Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar, param

from .signals import AbstractSignal, Joint, Logged, Sines

SHORTEST_LAG = 1e-3
"""Time constant [s] up to which a lag acts as none: recordings do not tell one so short from zero."""
HISTORY = 3.0
"""Time [s] of a held log that is kept before the first sample used: lags forget within it."""
AHEAD = 0.5
"""Time [s] of a held log that is kept after the last sample used: the clock of the inputs may be that late."""


class Held(AbstractSignal):
    """A command that keeps the value of its last sample (zero-order hold); before the first it has the first value.

    `knots` (n,) [s], `values` (n,).
    """

    knots: Float[Array, " n"]
    values: Float[Array, " n"]

    @staticmethod
    def of(times: Any, values: Any) -> "Held":
        """From `times` [s], strictly increasing, and `values`, both (n,). **Raises:** `ValueError` for others."""
        times, values = np.asarray(times, np.float64), np.asarray(values, np.float64)
        if not times.size or times.shape != values.shape:
            raise ValueError("A held command needs as many values as times, and at least one.")
        if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) > 0).all()):
            raise ValueError("The times of a held command must be finite and increase, and its values must be finite.")
        return Held(jnp.asarray(times), jnp.asarray(values))

    def padded(self, samples: int) -> "Held":
        """The same signal with `samples` knots; added knots lie after the end."""
        extra = samples - self.knots.shape[0]
        if extra <= 0:
            return self
        knots = jnp.concatenate([self.knots, self.knots[-1] + jnp.arange(1.0, extra + 1)])
        return Held(knots, jnp.pad(self.values, (0, extra), mode="edge"))

    def index(self, t: Scalar) -> Scalar:
        """The number of the last sample at time `t` [s]."""
        return jnp.clip(jnp.searchsorted(self.knots, t, side="right") - 1, 0, self.knots.shape[0] - 1)

    def at(self, t: Scalar) -> Joint:
        value = self.values[self.index(t)]
        return Joint(value, jnp.zeros_like(value), jnp.zeros_like(value))


def samples_between(times: Float[np.ndarray, " n"], first: float, last: float, fewest: int = 1) -> slice:
    """The samples at `times` [s] that matter from `first` to `last` [s]: those inside and one on each side, and at
    least `fewest` where there are so many."""
    start = max(int(np.searchsorted(times, first)) - 1, 0)
    stop = max(int(np.searchsorted(times, last)) + 1, start + fewest)
    return slice(max(min(start, len(times) - fewest), 0), stop)


def held_signals(inputs: Any) -> list[Held]:
    """The commands held between samples that are anywhere in `inputs`."""

    def is_held(part: Any) -> bool:
        return isinstance(part, Held)

    return list(filter(is_held, jax.tree.leaves(inputs, is_leaf=is_held)))


class LaggedHold(AbstractSignal):
    """A `command` that is held, through a first-order lag: tau y' = command - y, exact between the samples.

    `reached` (n,): the values of y at the samples, which `lagged` computes. For tau below `SHORTEST_LAG` y is the
    command.
    """

    command: Held
    tau: Scalar = param("s", low=0.0)
    reached: Float[Array, " n"] | None = None

    def at(self, t: Scalar) -> Joint:
        acts = self.tau > SHORTEST_LAG
        tau = jnp.where(acts, self.tau, 1.0)
        k = self.command.index(t)
        value = self.command.values[k]
        reached = self.command.values if self.reached is None else self.reached
        left = (reached[k] - value) * jnp.exp(-jnp.maximum(t - self.command.knots[k], 0.0) / tau)
        zero = jnp.zeros_like(value)
        parts = (value + left, -left / tau, left / tau**2)
        return Joint(*(jnp.where(acts, a, b) for a, b in zip(parts, (value, zero, zero), strict=True)))


class LaggedSines(AbstractSignal):
    """A sum of sines through a first-order lag that stood at its command at time 0, in closed form."""

    command: Sines
    tau: Scalar = param("s", low=0.0)

    def at(self, t: Scalar) -> Joint:
        tau = jnp.where(self.tau > SHORTEST_LAG, self.tau, 0.0)
        gain = 1 / jnp.sqrt(1 + (self.command.frequency * tau) ** 2)
        late = jnp.arctan(self.command.frequency * tau)
        swing = Sines(self.command.amplitude * gain, self.command.frequency, self.command.phase - late)
        zero = jnp.zeros_like(t)
        gap = self.command.at(zero).angle - swing.at(zero).angle
        safe = jnp.where(tau > 0, tau, 1.0)
        left = jnp.where(tau > 0, gap * jnp.exp(-t / safe), 0.0)
        angle, rate, acceleration = swing.at(t)
        return Joint(angle + left, rate - left / safe, acceleration + left / safe**2)


def lagged(signal: AbstractSignal, tau: Scalar) -> AbstractSignal:
    """`signal` through a first-order lag of time constant `tau` [s].

    **Raises:** `TypeError` for a signal that is neither held samples nor a sum of sines, bare or shaped.
    """
    if isinstance(signal, Sines):
        return LaggedSines(signal, tau)
    if isinstance(signal, Logged):
        # Its own samples, held for one interval: the lag of a smooth log is far longer than that.
        middle = (signal.knots[1:] + signal.knots[:-1]) / 2
        return lagged(Held(signal.knots[:-1], jax.vmap(lambda t: signal.at(t).angle)(middle)), tau)
    if isinstance(signal, LaggedHold | LaggedSines):
        raise TypeError("A signal that lags already cannot lag once more: leave one of the two lags out.")
    if not isinstance(signal, Held):
        raise TypeError(f"A lag needs held samples, a log or sines, not {type(signal).__name__}.")
    safe = jnp.where(tau > SHORTEST_LAG, tau, 1.0)
    stays = jnp.exp(-jnp.diff(signal.knots) / safe)

    def after(earlier, later):
        return earlier[0] * later[0], earlier[1] * later[0] + later[1]

    # y_(k+1) = stays_k y_k + (1 - stays_k) value_k, y_0 = value_0
    factor = jnp.concatenate([jnp.zeros(1), stays])
    addend = jnp.concatenate([signal.values[:1], (1 - stays) * signal.values[:-1]])
    _, reached = jax.lax.associative_scan(after, (factor, addend))
    return LaggedHold(signal, tau, reached)


class Shape(Protocol):
    """A change of the value of a command, as a module whose parameters a fit may move."""

    def shape(self, command: Scalar) -> Scalar:
        """The changed value."""
        ...


class Shaped(AbstractSignal):
    """The value of `signal` changed `by` a shape, with the rates by the chain rule."""

    signal: AbstractSignal
    by: Shape

    def at(self, t: Scalar) -> Joint:
        angle, rate, acceleration = self.signal.at(t)

        def moved(angle: Scalar, rate: Scalar) -> tuple[Scalar, Scalar]:
            return jax.jvp(self.by.shape, (angle,), (rate,))

        (value, slope), (_, bend) = jax.jvp(moved, (angle, rate), (rate, acceleration))
        return Joint(value, slope, bend)


def shaped(signal: AbstractSignal, by: Shape) -> AbstractSignal:
    """The values of `signal` changed `by` a shape; samples stay samples."""
    if isinstance(signal, Held):
        return Held(signal.knots, jax.vmap(by.shape)(signal.values))
    return Shaped(signal, by)


class Actuator(eqx.Module):
    """The actuator of one input: dead band, gain, offset and saturation, then a first-order lag.

    y = clip(gain (c - clip(c, -dead_band, dead_band)) + offset, -saturation, saturation)    lag: tau z' = y - z
    """

    gain: Scalar = param("-", default=1.0)
    offset: Scalar = param("-", default=0.0)
    dead_band: Scalar = param("-", low=0.0, default=0.0)
    saturation: Scalar | None = param("-", positive=True, default=None)
    lag: Scalar = param("s", low=0.0, default=0.0)

    def shape(self, command: Scalar) -> Scalar:
        """y [-] by the equation of the class."""
        y = self.gain * (command - jnp.clip(command, -self.dead_band, self.dead_band)) + self.offset
        return y if self.saturation is None else jnp.clip(y, -self.saturation, self.saturation)

    def acted(self, command: AbstractSignal) -> AbstractSignal:
        """What acts. **Raises:** `TypeError` where the command is of a kind that cannot lag."""
        plain = (float(self.gain), float(self.offset), float(self.dead_band)) == (1.0, 0.0, 0.0)
        changed = command if plain and self.saturation is None else shaped(command, self)
        return changed if float(self.lag) == 0.0 else lagged(changed, jnp.asarray(self.lag))
