"""Limits of the joints: bounds of angle, rate and acceleration at every instant, also between the points of a grid.

They apply to the command of a joint and to its motion under the controller of eq. (8), which overshoots at the start.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import AbstractSignal, Delayed, Joint, Logged, Scaled, Sines, Tracked

from .gait_families import JOINTS, scaled

COARSE, FINE = 0.01, 0.0005
"""Grid [s] of the constraints in the optimisation, and of the final proven bounds."""
BINS = 24
"""Number of time intervals; the optimiser gets the least slack in each of them as one constraint."""
_UNUSED = 1e-9
"""Below this a joint does not move, so a gait sets no limit to it."""
QUANTITIES = ("", "_rate", "_acceleration")


class Limit(NamedTuple):
    """Limits of one input, a joint angle for example: angle [rad], rate [rad/s], acceleration [rad/s^2]; infinite where
    there is none."""

    angle: float = np.inf
    rate: float = np.inf
    acceleration: float = np.inf


@dataclasses.dataclass(frozen=True, init=False)
class Limits:
    """Limits of the inputs of a vehicle: `Limits(phi=0.9, psi=1.6, psi_rate=6.5)`, `Limits(handle=0.8)`.

    **Arguments:** by the name of an input its largest angle [rad] (or speed [m/s], or command), or a `Limit`; with
    `_rate` behind the name that of its rate [rad/s], with `_acceleration` that of its acceleration [rad/s^2].
    **Raises:** `InputError` for an unknown name, a number not above 0, or an input without limit.
    """

    each: tuple[tuple[str, Limit], ...]

    def __init__(self, **values: Limit | float) -> None:
        inputs = [name.removesuffix("_rate").removesuffix("_acceleration") for name in values]
        inputs = JOINTS if set(JOINTS) & set(inputs) else tuple(dict.fromkeys(inputs))
        if all(isinstance(limit, Limit) for limit in values.values()):
            object.__setattr__(self, "each", tuple(values.items()))
        else:
            object.__setattr__(self, "each", Limits.of(values, names=inputs).each)

    @staticmethod
    def of(values: Mapping[str, Any], otherwise: "Limits | None" = None, names: Sequence[str] = JOINTS) -> "Limits":
        """Limits of the inputs `names` from {"phi": 0.9, "psi_rate": 6.5, ...}; missing ones are taken from
        `otherwise`.

        **Raises:** `InputError` for an unknown name, a number not above 0, or an input without limit.
        """
        defaults = Limits(**{name: Limit() for name in names}) if otherwise is None else otherwise
        known = defaults.named()
        for name, value in values.items():
            if name not in known:
                raise InputError(f"There is no limit `{name}`", "option --limit", instead_of(name, known))
            if not value > 0:
                raise InputError(
                    f"The limit {value:g} of `{name}` is not above 0", "option --limit", "give one above 0"
                )
        known |= values
        for name in defaults.names:
            if not np.isfinite(known[name]):
                what = f"Nothing limits the angle of `{name}`" if name in JOINTS else f"Nothing limits `{name}`"
                remedy = f"write {name}=ANGLE in rad" if name in JOINTS else f"write {name}=VALUE"
                raise InputError(what, "option --limit", remedy)
        return Limits(**{name: Limit(*(known[name + q] for q in QUANTITIES)) for name in defaults.names})

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return tuple(name for name, _ in self.each)

    def __getitem__(self, name: str) -> Limit:
        """The limit of one input."""
        return dict(self.each)[name]

    def named(self) -> dict[str, float]:
        """All limits by name: phi, phi_rate, phi_acceleration, psi, ..."""
        return {name + q: value for name, limit in self.each for q, value in zip(QUANTITIES, limit, strict=True)}


def input_names(model: Model) -> tuple[str, ...]:
    """The inputs that a gait gives: those that follow no other."""
    return tuple(one.name for one in model.board.inputs if one.follows is None)


def limits_of(signal: AbstractSignal) -> AbstractSignal:
    """The command that a joint follows: that of the tracking controller, or the signal itself."""
    return signal.command if isinstance(signal, Tracked) else signal


def bend_bounds(signal: AbstractSignal) -> tuple[Scalar, Scalar]:
    """Upper bounds of the second [rad/s^2] and the third derivative [rad/s^3] of a joint angle.

    The error e of a tracked joint obeys e'' = -kd e' - kp e, so e'^2 + kp e^2 never increases; with its initial value
    E^2 this gives |e'| <= E, |e''| <= (kd + sqrt(kp)) E and |e'''| <= kd |e''| + kp E.
    """
    if isinstance(signal, Sines):
        a, w = jnp.abs(signal.amplitude), jnp.abs(signal.frequency)
        return jnp.sum(a * w**2), jnp.sum(a * w**3)
    if isinstance(signal, Logged):
        c3, c2 = signal.coefficients[0], signal.coefficients[1]
        ends = jnp.stack([2 * c2, 2 * c2 + 6 * c3 * jnp.diff(signal.knots)])
        return jnp.max(jnp.abs(ends)), jnp.max(jnp.abs(6 * c3))
    if isinstance(signal, Tracked):
        start = signal.command.at(jnp.zeros(()))
        rate = jnp.sqrt(start.rate**2 + signal.kp * start.angle**2 + 1e-300)
        second = signal.kd * rate + jnp.sqrt(signal.kp) * rate
        third = signal.kd * second + signal.kp * rate
        below = bend_bounds(signal.command)
        return below[0] + second, below[1] + third
    raise TypeError(f"The derivatives of a {type(signal).__name__} have no known bounds.")


def reached(signal: AbstractSignal, until: float, step: float) -> Joint:
    """Upper bounds of |angle|, |rate| and |acceleration| in each of the n steps from 0 to `until` [s]: (n,) each.

    Between two grid points a function exceeds the larger of both values by at most step^2 / 8 times its largest second
    derivative, and by at most step / 2 times its largest first derivative.
    """
    if isinstance(signal, Delayed):
        return reached(signal.signal, until, step)
    if isinstance(signal, Scaled):
        return Joint(*(jnp.abs(signal.factor) * part for part in reached(signal.signal, until, step)))
    count = max(int(np.ceil(until / step)), 1)
    return _between(signal, jnp.linspace(0.0, until, count + 1), jnp.asarray(until / count))


@eqx.filter_jit  # else each operation is a program of its own
def _between(signal: AbstractSignal, grid: Float[Array, " n+1"], step: Scalar) -> Joint:
    """`reached` between the points of a `grid` [s] in equal steps."""
    samples = jax.vmap(signal.at)(grid)
    second, third = bend_bounds(signal)
    excess = (step**2 / 8 * second, step**2 / 8 * third, step / 2 * third)
    return Joint(*(jnp.maximum(jnp.abs(p[1:]), jnp.abs(p[:-1])) + b for p, b in zip(samples, excess, strict=True)))


def clipped(model: Model, gait: AbstractInputs) -> list[tuple[str, AbstractSignal]]:
    """The limited signals by name of input: the commands, and the joint motions where these differ."""
    joints, signals = model.commanded(gait), []
    for name in input_names(model):
        command, joint = limits_of(gait.signal(name)), joints.signal(name)
        signals += [(name, command)] if joint is command else [(name, command), (name, joint)]
    return signals


def slack(model: Model, gait: AbstractInputs, limits: Limits, until: float) -> Float[Array, " rows"]:
    """Constraint slack 1 - bound / limit of each limit in each of `BINS` time intervals, with the bounds of `reached`.

    If no slack is negative, `gait` provably satisfies `limits` from 0 to `until` [s].
    """
    rows = []
    for name, signal in clipped(model, gait):
        for limit, value in zip(limits[name], reached(signal, until, COARSE), strict=True):
            if np.isfinite(limit):
                size = -(-value.size // BINS)
                padded = jnp.pad(value, (0, size * BINS - value.size))
                rows.append(1 - jnp.max(padded.reshape(BINS, size), axis=1) / limit)
    return jnp.concatenate(rows)


def peaks(model: Model, gait: AbstractInputs, until: float) -> dict[str, float]:
    """Proven upper bounds, by the names of `Limits.named`, over 0 to `until` [s], of command and joint motion."""
    bounds: dict[str, float] = {}
    for name, signal in clipped(model, gait):
        for q, values in zip(QUANTITIES, reached(signal, until, FINE), strict=True):
            bounds[name + q] = max(bounds.get(name + q, 0.0), float(jnp.max(values)))
    return bounds


def within(model: Model, gait: AbstractInputs, limits: Limits, until: float) -> AbstractInputs:
    """`gait` with the command of each input scaled down so that it provably satisfies `limits` from 0 to `until` [s].

    Command and joint motion are linear in the amplitude of the command, so one factor for each input is sufficient.
    """
    bounds, largest_allowed = peaks(model, gait, until), limits.named()
    changed = {}
    for name in input_names(model):
        signal = gait.signal(name)
        excess = max(bounds[name + q] / largest_allowed[name + q] for q in QUANTITIES)
        factor = 1.0 if excess <= 1 else 1 / excess * (1 - 1e-12)
        command = scaled(limits_of(signal), factor)
        changed[name] = Tracked(command, signal.kp, signal.kd) if isinstance(signal, Tracked) else command
    return model.board.inputs_of(changed)


def reached_by(gaits: Sequence[AbstractInputs], model: Model, until: float) -> Limits:
    """The largest angle and rate of given gaits as limits; acceleration and unused joints stay unlimited."""
    all_peaks = [peaks(model, gait, until) for gait in gaits]
    largest = {
        name: max(bounds[name] for bounds in all_peaks) for name in all_peaks[0] if not name.endswith("_acceleration")
    }
    used = {name: value if value > _UNUSED else np.inf for name, value in largest.items()}
    return Limits(**{name: Limit(used[name], used[f"{name}_rate"]) for name in input_names(model)})
