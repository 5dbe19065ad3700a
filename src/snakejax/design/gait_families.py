"""Gait families: parametrised commands of the inputs, of a snakeboard its two joints.

Unknowns that scale an angle are in units of the largest angle of the joint, and frequencies are logarithms, so all
unknowns are of order one.
"""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import AbstractInputs, Gait, Inputs
from snakejax.dynamics.signals import AbstractSignal, Logged, Sines

JOINTS = ("phi", "psi")
"""The inputs of a snakeboard."""
TINY = 1e-12
"""Keeps the derivative of an amplitude defined at zero."""
RATIOS = ((1.0, 1.0), (1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (1.0, 3.0), (2.0, 3.0), (3.0, 2.0))
"""Cycles of steering and rotor in a common period for random starts; the paper's gaits have the first and the third.
The first ratio is listed twice, so it is drawn twice as often."""

Bounds = tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]


class GaitFamily(eqx.Module):
    """A parametrised family of gaits; `angles` [rad] are the largest angles of the inputs `names`: of steering and
    rotor."""

    angles: eqx.AbstractVar[tuple[float, ...]]
    names: eqx.AbstractVar[tuple[str, ...]]

    @abc.abstractmethod
    def gait(self, unknowns: Float[Array, " P"]) -> AbstractInputs:
        """The command with the given `unknowns` (P,), differentiable by them."""

    @abc.abstractmethod
    def bounds(self) -> Bounds:
        """Lower and upper bounds (P,) of the unknowns."""

    @abc.abstractmethod
    def guess(self, rng: np.random.Generator) -> Float[np.ndarray, " P"]:
        """Random unknowns (P,) to start from: one dominant sine for each joint, with frequencies in a simple ratio."""

    @property
    def size(self) -> int:
        """The number P of unknowns."""
        return self.bounds()[0].size

    def driven(self, signals: Iterable[AbstractSignal]) -> AbstractInputs:
        """The inputs with these signals, in the order of `names`."""
        named = dict(zip(self.names, signals, strict=True))
        return Gait(**named) if self.names == JOINTS else Inputs(named)

    def like(self, gait: AbstractInputs) -> Float[np.ndarray, " P"] | None:
        """The unknowns (P,) that reproduce the command `gait`, or None if the family does not contain it."""
        del gait
        return None


class SumsOfSines(GaitFamily):
    """Sums of `terms` sines for each joint, with free frequencies between `band[0]` and `band[1]` [rad/s].

    The angle is sum_k a_k sin(w_k t + p_k). Unknowns, joint by joint: the coefficients s_k of sin(w_k t), the
    coefficients c_k of cos(w_k t), and ln w_k; a_k = sqrt(s_k^2 + c_k^2), p_k = atan2(c_k, s_k).
    """

    angles: tuple[float, ...] = eqx.field(static=True)
    band: tuple[float, float] = eqx.field(static=True)
    terms: int = eqx.field(static=True, default=3)
    names: tuple[str, ...] = eqx.field(static=True, default=JOINTS)

    def gait(self, unknowns: Float[Array, " P"]) -> AbstractInputs:
        s, c, w = jnp.moveaxis(unknowns.reshape(len(self.angles), 3, self.terms), 1, 0)
        return self.driven(_sines(a * s[k], a * c[k], jnp.exp(w[k])) for k, a in enumerate(self.angles))

    def bounds(self) -> Bounds:
        def filled(coefficient: float, frequency: float) -> np.ndarray:
            joint = np.repeat([coefficient, coefficient, np.log(frequency)], self.terms)
            return np.concatenate([joint] * len(self.angles))

        return filled(-1.0, self.band[0]), filled(1.0, self.band[1])

    def guess(self, rng: np.random.Generator) -> Float[np.ndarray, " P"]:
        joints = []
        for w in _guessed(rng, self.band, len(self.angles)):
            frequencies = w * np.array([1.0, *rng.choice([0.25, 0.5, 2.0, 3.0], self.terms - 1)])
            size, phase = _sizes(rng, self.terms), rng.uniform(0, 2 * np.pi, self.terms)
            joints += [size * np.cos(phase), size * np.sin(phase), np.log(np.clip(frequencies, *self.band))]
        return np.concatenate(joints)

    def like(self, gait: AbstractInputs) -> Float[np.ndarray, " P"] | None:
        joints = []
        for name, angle in zip(self.names, self.angles, strict=True):
            signal = gait.signal(name)
            if not isinstance(signal, Sines):
                return None
            a, w, p = (np.asarray(part, float) for part in (signal.amplitude, signal.frequency, signal.phase))
            present = np.flatnonzero(a)
            a, w, p = a[present] / angle, w[present], p[present]
            missing = self.terms - a.size
            if missing < 0 or (w < self.band[0]).any() or (w > self.band[1]).any():
                return None
            # A term of zero amplitude gets its own frequency, so that the derivative by its amplitude is not zero.
            low, high = np.log(self.band)
            others = np.exp(np.linspace(low, high, missing + 2))[1:-1]
            a, w, p = np.pad(a, (0, missing)), np.concatenate([w, others]), np.pad(p, (0, missing))
            joints += [a * np.cos(p), a * np.sin(p), np.log(w)]
        return np.concatenate(joints)


class Fourier(GaitFamily):
    """Fourier series of all joints: a constant and `harmonics` multiples of one free frequency w [rad/s] in `band`.

    Unknowns: ln w, then for each joint the constant, the coefficients of sin(k w t) and the coefficients of cos(k w t).
    """

    angles: tuple[float, ...] = eqx.field(static=True)
    band: tuple[float, float] = eqx.field(static=True)
    harmonics: int = eqx.field(static=True, default=3)
    names: tuple[str, ...] = eqx.field(static=True, default=JOINTS)

    def gait(self, unknowns: Float[Array, " P"]) -> AbstractInputs:
        w, H = jnp.exp(unknowns[0]), self.harmonics
        multiples = jnp.arange(1.0, H + 1)
        joints = []
        for row, angle in zip(unknowns[1:].reshape(len(self.angles), 2 * H + 1), self.angles, strict=True):
            wave = _sines(angle * row[1 : H + 1], angle * row[H + 1 :], w * multiples)
            # A constant is a sine of frequency 0 and phase pi/2.
            constant = (angle * row[0], 0.0, jnp.pi / 2)
            parts = (wave.amplitude, wave.frequency, wave.phase)
            joints.append(
                Sines(*(jnp.append(part, jnp.asarray(one)) for part, one in zip(parts, constant, strict=True)))
            )
        return self.driven(joints)

    def bounds(self) -> Bounds:
        coefficients = np.ones(len(self.angles) * (2 * self.harmonics + 1))
        low, high = (np.concatenate([[np.log(w)], sign * coefficients]) for w, sign in zip(self.band, (-1, 1)))  # noqa: B905
        return low, high

    def guess(self, rng: np.random.Generator) -> Float[np.ndarray, " P"]:
        H, base = self.harmonics, min(_guessed(rng, self.band, len(self.angles)))
        joints = []
        for _ in self.angles:
            size, phase = np.roll(_sizes(rng, H), rng.integers(min(H, 3))), rng.uniform(0, 2 * np.pi, H)
            joints += [[0.0], size * np.cos(phase), size * np.sin(phase)]
        return np.concatenate([[np.log(base)], *joints])


class Spline(GaitFamily):
    """Natural cubic splines through `knots` evenly spaced angles of each joint from 0 to `seconds` [s].

    Unknowns, joint by joint: the angles at the knots. `case.toml` reads such a gait as a joint log of its knots.
    """

    angles: tuple[float, ...] = eqx.field(static=True)
    seconds: float = eqx.field(static=True)
    knots: int = eqx.field(static=True, default=24)
    names: tuple[str, ...] = eqx.field(static=True, default=JOINTS)

    def gait(self, unknowns: Float[Array, " P"]) -> AbstractInputs:
        through = spline(np.linspace(0.0, self.seconds, self.knots))
        values = unknowns.reshape(len(self.angles), self.knots)
        return self.driven(through(angle * row) for angle, row in zip(self.angles, values, strict=True))

    def bounds(self) -> Bounds:
        return -np.ones(len(self.angles) * self.knots), np.ones(len(self.angles) * self.knots)

    def guess(self, rng: np.random.Generator) -> Float[np.ndarray, " P"]:
        times = np.linspace(0.0, self.seconds, self.knots)
        fastest = np.pi / (times[1] - times[0]) / 2
        guessed = _guessed(rng, (fastest / 4, fastest), len(self.angles))
        swings = [0.7 * np.sin(w * times + rng.uniform(0, 2 * np.pi)) for w in guessed]
        return np.concatenate(swings)


def spline(times: Sequence[float] | np.ndarray) -> Callable[[Float[Array, " n"]], Logged]:
    """Natural cubic spline with knots at `times` (n,) [s], as a function of the angles (n,) [rad] at the knots.

    The coefficients are linear in the angles, so the function is differentiable.
    """
    times = np.asarray(times, np.float64)
    weights = jnp.asarray(CubicSpline(times, np.eye(times.size), bc_type="natural").c)
    knots = jnp.asarray(times)
    return lambda angles: Logged(knots, jnp.einsum("cpn,n->cp", weights, angles))


def scaled(signal: AbstractSignal, factor: float | Scalar) -> AbstractSignal:
    """The command with its angle multiplied by `factor`. **Raises:** `TypeError` if it is neither sines nor a log."""
    if isinstance(signal, Sines):
        return Sines(signal.amplitude * factor, signal.frequency, signal.phase)
    if isinstance(signal, Logged):
        return dataclasses.replace(signal, coefficients=signal.coefficients * factor)
    raise TypeError(f"A command is a sum of sines or a log, but this is a {type(signal).__name__}.")


def _sines(s: Float[Array, " K"], c: Float[Array, " K"], w: Float[Array, " K"]) -> Sines:
    # Without TINY a term of zero amplitude would have no derivative.
    return Sines(jnp.sqrt(s**2 + c**2 + TINY**2), w, jnp.arctan2(c, s + TINY))


def _guessed(rng: np.random.Generator, band: tuple[float, float], count: int) -> list[float]:
    """Random frequencies [rad/s] of `count` inputs in simple ratios, within a factor 2 of the middle of `band`."""
    low, high = band
    middle = np.sqrt(low * high)
    base = np.exp(rng.uniform(np.log(middle / 2), np.log(middle * 2)))
    ratios = RATIOS[rng.integers(len(RATIOS))]
    ratios += tuple(RATIOS[rng.integers(len(RATIOS))][0] for _ in range(count - len(ratios)))
    return [float(np.clip(base * ratio, low, high)) for ratio in ratios[:count]]


def _sizes(rng: np.random.Generator, terms: int) -> np.ndarray:
    return np.array([rng.uniform(0.4, 0.9), *rng.uniform(0.0, 0.2, terms - 1)])
