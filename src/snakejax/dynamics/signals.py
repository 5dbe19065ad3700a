"""Joint signals: angle, rate and acceleration over time, in closed form or from a log."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Parametrised, Scalar, param


class Joint(NamedTuple):
    """A joint at one instant: angle [rad], rate [rad/s], acceleration [rad/s^2]."""

    angle: Scalar
    rate: Scalar
    acceleration: Scalar


class AbstractSignal(Parametrised):
    """A joint angle as a function of time."""

    @abc.abstractmethod
    def at(self, t: Scalar) -> Joint:
        """Angle, rate and acceleration at time `t` [s]."""


@eqx.filter_jit
def angles_at(signal: AbstractSignal, times: Float[Array, " n"]) -> Float[Array, " n"]:
    """The angle [rad] of `signal` at `times` [s], by one program."""
    return jax.vmap(lambda t: signal.at(t).angle)(times)


class Sines(AbstractSignal):
    """A sum of sines, sum_k a_k sin(w_k t + p_k).

    **Arguments:** `amplitude` [rad], `frequency` (angular) [rad/s], `phase` [rad], each of shape (terms,).
    """

    amplitude: Float[Array, " terms"] = eqx.field(converter=jnp.asarray)
    frequency: Float[Array, " terms"] = eqx.field(converter=jnp.asarray)
    phase: Float[Array, " terms"] = eqx.field(converter=jnp.asarray)

    @staticmethod
    def of(terms: Sequence[Sequence[float]]) -> "Sines":
        """From [[amplitude, angular frequency, phase], ...] as in `case.toml`; [] is a joint that stays at 0."""
        table = np.asarray(terms, np.float64).reshape(-1, 3)
        return Sines(table[:, 0], table[:, 1], table[:, 2])

    def padded(self, terms: int) -> "Sines":
        """The same signal with `terms` terms; added terms have amplitude zero."""
        extra = (0, terms - self.amplitude.shape[0])
        return Sines(*(jnp.pad(part, extra) for part in (self.amplitude, self.frequency, self.phase)))

    def at(self, t: Scalar) -> Joint:
        angle = rate = acceleration = jnp.zeros(())
        for k in range(self.amplitude.shape[0]):
            a, w = self.amplitude[k], self.frequency[k]
            phase = w * t + self.phase[k]
            sine, cosine = sine_cosine(phase)
            angle, rate, acceleration = angle + a * sine, rate + a * w * cosine, acceleration - a * w**2 * sine
        return Joint(angle, rate, acceleration)


UNSEEN = 1e9
"""Onset [s] of a joint without an observed onset; finite, because infinity has no derivative."""
NEAR = 0.1
"""Samples less than this many frames after an onset are dropped: a knot there would be too close to the onset."""


class Logged(AbstractSignal):
    """A joint angle from a log: the natural cubic spline through its samples (`Logged.of(times, angles)`).

    `knots` (n,) [s]; `coefficients` (4, n - 1), highest power first; `noise` [rad]: standard deviation of a sample;
    `strength`: that of the smoothing spline which removed most of it. Before and after the log the joint keeps its
    first and last angle. A joint that rests until `onset` [s] and then accelerates suddenly is constant before the
    onset and a spline after it, with rate zero at the onset; `onset` is `UNSEEN` if it was not observed.
    """

    knots: Float[Array, " n"]
    coefficients: Float[Array, "4 n-1"]
    noise: Scalar = eqx.field(default_factory=lambda: jnp.zeros(()))
    strength: Scalar = eqx.field(default_factory=lambda: jnp.zeros(()))
    onset: Scalar = eqx.field(default_factory=lambda: jnp.asarray(UNSEEN))

    @staticmethod
    def of(times: Any, angles: Any, noise: float = 0.0, strength: float = 0.0, onset: float | None = None) -> "Logged":
        """From `times` [s], strictly increasing, and `angles` [rad], both (n,) with n >= 4.

        **Raises:** `ValueError` for other times or angles, or for an `onset` [s] without samples on both sides.
        """
        times, angles = np.asarray(times, np.float64), np.asarray(angles, np.float64)
        if times.size < 4 or times.shape != angles.shape:
            raise ValueError(f"A joint log needs at least 4 samples of time and angle, but has {times.size}.")
        if not (np.isfinite(times).all() and np.isfinite(angles).all() and (np.diff(times) > 0).all()):
            raise ValueError("The times of a joint log must be finite and increase, and its angles must be finite.")
        if onset is not None and not times[0] < onset < times[-2]:
            raise ValueError(f"The joint begins at {onset:g} s, outside its log from {times[0]:g} to {times[-1]:g} s.")
        if onset is None:
            spline = CubicSpline(times, angles, bc_type="natural").c
        else:
            times, spline = spline_with_onset(times, angles, onset)
        parts = noise, strength, UNSEEN if onset is None else onset
        return Logged(jnp.asarray(times), jnp.asarray(spline), *(jnp.asarray(float(part)) for part in parts))

    def on_clock(self, offset: Scalar, drift: Scalar) -> "Logged":
        """The same signal on a clock that shows t when that of the knots shows t (1 + drift) + offset [s]."""
        pace = 1 + drift
        powers = jnp.stack([pace**k for k in (3, 2, 1, 0)])
        knots, onset = ((part - offset) / pace for part in (self.knots, self.onset))
        return dataclasses.replace(self, knots=knots, coefficients=self.coefficients * powers[:, None], onset=onset)

    def padded(self, samples: int) -> "Logged":
        """The same signal with `samples` knots; added knots lie after the end, where the angle is constant."""
        extra = samples - self.knots.shape[0]
        if extra <= 0:
            return self
        d, (c3, c2, c1, c0) = self.knots[-1] - self.knots[-2], self.coefficients[:, -1]
        stay = jnp.zeros((4, extra)).at[3].set(((c3 * d + c2) * d + c1) * d + c0)
        knots = jnp.concatenate([self.knots, self.knots[-1] + jnp.arange(1.0, extra + 1)])
        return dataclasses.replace(self, knots=knots, coefficients=jnp.concatenate([self.coefficients, stay], axis=1))

    def at(self, t: Scalar) -> Joint:
        inside = (t >= self.knots[0]) & (t <= self.knots[-1])
        clamped = jnp.clip(t, self.knots[0], self.knots[-1])
        k = jnp.clip(jnp.searchsorted(self.knots, clamped, side="right") - 1, 0, self.knots.shape[0] - 2)
        d, (c3, c2, c1, c0) = clamped - self.knots[k], self.coefficients[:, k]
        angle = ((c3 * d + c2) * d + c1) * d + c0
        rate, acceleration = (3 * c3 * d + 2 * c2) * d + c1, 6 * c3 * d + 2 * c2
        return Joint(angle, jnp.where(inside, rate, 0.0), jnp.where(inside, acceleration, 0.0))


def split_at_onset(times: np.ndarray, onset: float) -> tuple[np.ndarray, np.ndarray]:
    """Masks (n,) of the samples at `times` [s] before an `onset` [s], at rest, and after it, in motion."""
    return times < onset, times > onset + NEAR * float(np.median(np.diff(times)))


def spline_with_onset(times: np.ndarray, angles: np.ndarray, onset: float) -> tuple[np.ndarray, np.ndarray]:
    """Knots (m,) [s] and coefficients (4, m - 1) of a joint that rests until `onset` [s] and has rate zero there."""
    rest, moving = split_at_onset(times, onset)
    knots = np.concatenate([[onset], times[moving]])
    level = float(angles[rest].mean())
    after = CubicSpline(knots, np.concatenate([[level], angles[moving]]), bc_type=((1, 0.0), (2, 0.0))).c
    before = np.zeros((4, int(rest.sum())))
    before[3] = level
    return np.concatenate([times[rest], knots]), np.concatenate([before, after], axis=1)


class Tracked(AbstractSignal):
    """A joint that starts at angle zero and at rest and follows `command` by the controller of eq. (8).

    The error e = actual - command obeys e'' + kd e' + kp e = 0 with e(0) = -command(0), e'(0) = -command'(0), so with
    a = kd / 2, q = kp - a^2:

        e(t) = e0 c + (e0' + a e0) s        c = exp(-a t) cos(sqrt(q) t)      s = exp(-a t) sin(sqrt(q) t) / sqrt(q)

    (cosh, sinh of sqrt(-q) t for q < 0): a closed form without integration.
    """

    command: AbstractSignal
    kp: Scalar = param("1/s^2", positive=True)
    kd: Scalar = param("1/s", low=0.0)

    @property
    def decay(self) -> Scalar:
        """The rate [1/s] at which the error decays in the end: a - sqrt(max(-q, 0))."""
        a = self.kd / 2
        return a - jnp.sqrt(jnp.maximum(a**2 - self.kp, 0.0))

    def at(self, t: Scalar) -> Joint:
        start = self.command.at(jnp.zeros(()))
        angle, rate, acceleration = self.command.at(t)
        a = self.kd / 2
        q = self.kp - a**2
        c, s = _decaying(a, q, t)
        e0, slope = -start.angle, -start.rate - a * start.angle
        e = e0 * c + slope * s
        e_rate = slope * c - q * e0 * s - a * e
        return Joint(angle + e, rate + e_rate, acceleration - self.kd * e_rate - self.kp * e)


_EARLY = 1e-4
"""Below this |q| t^2 a power series gives the derivatives."""
_CRITICAL = 1e-10
"""Below this |q| [1/s^2] the controller is critically damped: a power series is exact to 1e-9 for 1000 s."""


@jax.custom_jvp
def _decaying(a: Scalar, q: Scalar, t: Scalar) -> tuple[Scalar, Scalar]:
    """exp(-a t) times cos(sqrt(q) t) and sin(sqrt(q) t) / sqrt(q); for q < 0 by exponentials, which do not overflow.

    The branches do not depend on time: along a run these are analytic functions.
    """
    return _closed_or_series(a, q, t, jnp.abs(q) < _CRITICAL)


@_decaying.defjvp
def _decaying_jvp(primals, tangents):
    # The closed form loses digits of the derivatives by q where |q| t^2 is small.
    return jax.jvp(lambda a, q, t: _closed_or_series(a, q, t, jnp.abs(q * t**2) < _EARLY), primals, tangents)


def _closed_or_series(a: Scalar, q: Scalar, t: Scalar, series: Scalar) -> tuple[Scalar, Scalar]:
    """The two functions by power series, whose next terms are below 1e-20 for |q| t^2 < `_EARLY`, or closed form."""
    z, oscillates = q * t**2, q > 0
    w = jnp.sqrt(jnp.where(series, 1.0, jnp.abs(q)))
    sine, cosine = sine_cosine(jnp.where(oscillates, w * t, 0.0))
    v = jnp.where(oscillates | series, 0.0, w)
    slow, fast = jnp.exp((v - a) * t), jnp.exp(-(v + a) * t)
    even = jnp.where(oscillates, slow * cosine, (slow + fast) / 2)
    odd = jnp.where(oscillates, slow * sine, (slow - fast) / 2) / w
    even_series = slow * (1 - z / 2 * (1 - z / 12 * (1 - z / 30)))
    odd_series = slow * t * (1 - z / 6 * (1 - z / 20 * (1 - z / 42)))
    return jnp.where(series, even_series, even), jnp.where(series, odd_series, odd)


class Delayed(AbstractSignal):
    """`signal` delayed by `delay` [s]; zero before that time."""

    signal: AbstractSignal
    delay: Scalar = param("s", low=0.0)

    def at(self, t: Scalar) -> Joint:
        started = t >= self.delay
        joint = self.signal.at(jnp.where(started, t - self.delay, 0.0))
        return Joint(*(jnp.where(started, part, 0.0) for part in joint))


class Scaled(AbstractSignal):
    """`factor` times `signal`."""

    signal: AbstractSignal
    factor: Scalar = param("-")

    def at(self, t: Scalar) -> Joint:
        return Joint(*(self.factor * part for part in self.signal.at(t)))
