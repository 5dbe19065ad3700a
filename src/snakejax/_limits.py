"""Limits of the joints: angle, rate and acceleration held at every instant, between the points of a grid too.

Both are held: what a joint is told, and what it does under the controller of eq. (8), whose start overshoots.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._errors import InputError, instead_of
from ._gait import AbstractSignal, Delayed, Gait, Joint, Logged, Scaled, Sines, Tracked
from ._model import Model
from ._shapes import scaled
from ._units import Scalar

COARSE, FINE = 0.01, 0.0005
"""Grid [s] on which an optimiser sees the limits, and that of the proof."""
BINS = 24
"""Stretches of time in each of which the optimiser sees the worst instant."""
_UNUSED = 1e-9
QUANTITIES = ("", "_rate", "_acceleration")


class Limit(NamedTuple):
    """The most of one joint: angle [rad], rate [rad/s], acceleration [rad/s^2]; infinite where there is none."""

    angle: float = np.inf
    rate: float = np.inf
    acceleration: float = np.inf


class Limits(NamedTuple):
    """The limits of steering and rotor."""

    phi: Limit
    psi: Limit

    @staticmethod
    def of(values: Mapping[str, float], otherwise: "Limits | None" = None) -> "Limits":
        """From {"phi": 0.9, "psi_rate": 6.5, ...}; what it does not name is as in `otherwise`.

        **Raises:** `InputError` for a name that is none, a number not above 0, or an angle without limit.
        """
        usual = Limits(Limit(), Limit()) if otherwise is None else otherwise
        known = usual.named()
        for name, value in values.items():
            if name not in known:
                raise InputError(f"There is no limit `{name}`", "option --limit", instead_of(name, known))
            if not value > 0:
                raise InputError(f"A limit of {value:g} for `{name}` is none", "option --limit", "give one above 0")
        known |= values
        for joint in Limits._fields:
            if not np.isfinite(known[joint]):
                what = f"Nothing limits the angle of `{joint}`"
                raise InputError(what, "option --limit", f"write {joint}=ANGLE in rad")
        return Limits(*(Limit(*(known[joint + q] for q in QUANTITIES)) for joint in Limits._fields))

    def named(self) -> dict[str, float]:
        """The six numbers by name: phi, phi_rate, phi_acceleration and so on."""
        return {
            joint + q: value
            for joint, limit in zip(Limits._fields, self, strict=True)
            for q, value in zip(QUANTITIES, limit, strict=True)
        }


def told(signal: AbstractSignal) -> AbstractSignal:
    """The command behind a joint."""
    return signal.command if isinstance(signal, Tracked) else signal


def _bends(signal: AbstractSignal) -> tuple[Scalar, Scalar]:
    """Upper bounds of the second and of the third derivative of a joint's angle.

    The error e of a tracked joint obeys e'' = -kd e' - kp e, and e'^2 + kp e^2 never grows, which bounds the rest.
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
        below = _bends(signal.command)
        return below[0] + second, below[1] + third
    raise TypeError(f"The bends of a {type(signal).__name__} are not known.")


def reached(signal: AbstractSignal, until: float, step: float) -> Joint:
    """How far angle, rate and acceleration go, at most, in each of the steps from 0 to `until` [s]: (n,) each.

    Between two points of a grid a function exceeds the larger of both by step^2 / 8 times its largest second derivative
    at most, and by step / 2 times its largest first one.
    """
    if isinstance(signal, Delayed):
        return reached(signal.signal, until, step)
    if isinstance(signal, Scaled):
        return Joint(*(jnp.abs(signal.factor) * part for part in reached(signal.signal, until, step)))
    count = max(int(np.ceil(until / step)), 1)
    step = until / count
    at = jax.vmap(signal.at)(jnp.linspace(0.0, until, count + 1))
    second, third = _bends(signal)
    between = (step**2 / 8 * second, step**2 / 8 * third, step / 2 * third)
    return Joint(*(jnp.maximum(jnp.abs(p[1:]), jnp.abs(p[:-1])) + b for p, b in zip(at, between, strict=True)))


def held(model: Model, gait: Gait) -> list[tuple[str, AbstractSignal]]:
    """What is held within limits, by the name of its joint: the commands, and the joints where they differ."""
    joints, found = model.commanded(gait), []
    for name in Limits._fields:
        command, joint = told(getattr(gait, name)), getattr(joints, name)
        found += [(name, command)] if joint is command else [(name, command), (name, joint)]
    return found


def room(model: Model, gait: Gait, limits: Limits, until: float) -> Float[Array, " rows"]:
    """What is left below each limit, as a share of it, in each of `BINS` stretches of time: an optimiser's constraints.

    Where none of them is negative `gait` is proven to keep to `limits` from 0 to `until` [s].
    """
    rows = []
    for name, signal in held(model, gait):
        for most, value in zip(getattr(limits, name), reached(signal, until, COARSE), strict=True):
            if np.isfinite(most):
                each = -(-value.size // BINS)
                filled = jnp.pad(value, (0, each * BINS - value.size))
                rows.append(1 - jnp.max(filled.reshape(BINS, each), axis=1) / most)
    return jnp.concatenate(rows)


def peaks(model: Model, gait: Gait, until: float) -> dict[str, float]:
    """Proven upper bounds of the six numbers that limits are about, over 0 to `until` [s], of command and joint."""
    found: dict[str, float] = {}
    for name, signal in held(model, gait):
        for q, values in zip(QUANTITIES, reached(signal, until, FINE), strict=True):
            found[name + q] = max(found.get(name + q, 0.0), float(jnp.max(values)))
    return found


def within(model: Model, gait: Gait, limits: Limits, until: float) -> Gait:
    """`gait`, made smaller joint by joint where it is not proven to keep to `limits` from 0 to `until` [s].

    Command and joint are linear in the size of the command, so that one factor brings back all of them.
    """
    found, most = peaks(model, gait, until), limits.named()
    changed = []
    for name, signal in zip(Limits._fields, (gait.phi, gait.psi), strict=True):
        excess = max(found[name + q] / most[name + q] for q in QUANTITIES)
        factor = 1.0 if excess <= 1 else 1 / excess * (1 - 1e-12)
        command = scaled(told(signal), factor)
        changed.append(Tracked(command, signal.kp, signal.kd) if isinstance(signal, Tracked) else command)
    return Gait(*changed)


def reached_by(gaits: list[Gait], model: Model, until: float) -> Limits:
    """The limits that given gaits keep to in angle and rate; nothing limits acceleration, or what they do not use."""
    every = [peaks(model, gait, until) for gait in gaits]
    most = {name: max(one[name] for one in every) for name in every[0] if not name.endswith("_acceleration")}
    used = {name: value if value > _UNUSED else np.inf for name, value in most.items()}
    return Limits(*(Limit(used[joint], used[f"{joint}_rate"]) for joint in Limits._fields))
