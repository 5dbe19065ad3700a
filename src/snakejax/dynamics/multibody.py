"""Equations of motion of planar bodies on wheels, derived from their declaration by `jax.jvp`.

With velocities V = (u, w, r, rates of free joints), joint angles q and the rates s of prescribed joints, bodies b at
(x_b, y_b) and angle a_b in the base frame, the kinetic energy is

    T = sum_b m_b ((u - r y_b + x_b')^2 + (w + r x_b + y_b')^2) / 2 + I_b (r + a_b')^2 / 2

and p = dT/dV, M = dp/dV; in the base frame, which turns (Hamel's equations),

    M V' + dp/dt at constant V + (-r p_w, r p_u, u p_w - w p_u, -dT/dq) = Q

Every derivative is a `jax.jvp`; nobody derives one by hand.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from snakejax.core.fast_math import sine_cosine
from snakejax.core.parameter import Scalar

from .contact import AppliedForces, Configuration
from .vehicle import AbstractVehicle

Vector = tuple[Scalar, ...]


class Phase(NamedTuple):
    """What velocities and forces depend on: joint angles and rates by name, and the angle of every wheel [rad]."""

    angles: dict[str, Scalar]
    rates: dict[str, Scalar]
    wheels: Vector
    rims: Vector
    """Speed of the rim of each wheel [m/s], zero where it rolls freely."""


def phase_of(vehicle: AbstractVehicle, configuration: Configuration) -> tuple[Phase, Phase]:
    """The phase of `configuration`, and its rate of change with the accelerations of prescribed joints."""
    inputs = configuration.inputs
    rims = [vehicle.rim(wheelset, inputs) for wheelset in vehicle.wheelsets]
    zero = jnp.zeros_like(configuration.joints[0].angle)
    at = Phase(
        {name: joint.angle for name, joint in inputs.items()},
        {name: joint.rate for name, joint in inputs.items()},
        tuple(joint.angle for joint in configuration.joints),
        tuple(zero if rim is None else rim.angle for rim in rims),
    )
    rate = Phase(
        {name: joint.rate for name, joint in inputs.items()},
        {name: joint.acceleration for name, joint in inputs.items()},
        tuple(joint.rate for joint in configuration.joints),
        tuple(zero if rim is None else rim.rate for rim in rims),
    )
    return at, rate


def wheel_velocities(vehicle: AbstractVehicle, V: Vector, phase: Phase) -> tuple[Vector, Vector]:
    """Lateral and rolling speed [m/s] of every wheel over the ground."""
    u, w, r = V[:3]
    rates = _with_free_rates(vehicle, phase.rates, V)

    def placed(angles: dict[str, Scalar]) -> list[Vector]:
        return [_scalars(vehicle.placement(wheelset, angles), u) for wheelset in vehicle.wheelsets]

    places, moves = jax.jvp(placed, (phase.angles,), (_at_names(rates, phase.angles),))
    lateral, rolling = [], []
    for (x, y, turned), (x_rate, y_rate, _), steered in zip(places, moves, phase.wheels, strict=True):
        along, across = u - r * y + x_rate, w + r * x + y_rate
        sine, cosine = sine_cosine(turned + steered)
        lateral.append(-along * sine + across * cosine)
        rolling.append(along * cosine + across * sine)
    return tuple(lateral), tuple(rolling)


def kinetic_energy(vehicle: AbstractVehicle, V: Vector, angles: dict[str, Scalar], rates: dict[str, Scalar]) -> Scalar:
    """T [J] of all bodies by the equation of the module."""
    u, w, r = V[:3]
    rates = _with_free_rates(vehicle, rates, V)

    def placed(angles: dict[str, Scalar]) -> list[Vector]:
        return [_scalars((b.x, b.y, b.angle), u) for b in vehicle.bodies(angles)]

    places, moves = jax.jvp(placed, (angles,), (_at_names(rates, angles),))
    energy = jnp.zeros_like(u)
    for body, (x, y, _), (x_rate, y_rate, turn) in zip(vehicle.bodies(angles), places, moves, strict=True):
        along, across = u - r * y + x_rate, w + r * x + y_rate
        energy = energy + body.mass * (along**2 + across**2) / 2 + body.inertia * (r + turn) ** 2 / 2
    return energy


def momenta(vehicle: AbstractVehicle, V: Vector, angles: dict[str, Scalar], rates: dict[str, Scalar]) -> Vector:
    """dT/dV: linear momentum along and across the base [kg m/s], angular momentum [N m s], and of free joints."""
    return tuple(
        jax.jvp(lambda *V: kinetic_energy(vehicle, V, angles, rates), V, direction)[1] for direction in _directions(V)
    )


class Balance(NamedTuple):
    """M V' = `right`, with the mass matrix `mass` by rows."""

    mass: tuple[Vector, ...]
    right: Vector


def balance(vehicle: AbstractVehicle, V: Vector, configuration: Configuration, loads: AppliedForces) -> Balance:
    """The mass matrix and everything else of the equations of motion under the forces `loads`."""
    at, change = phase_of(vehicle, configuration)
    zeros = tuple(jnp.zeros_like(part) for part in V)
    rate = _with_free_rates(vehicle, at.rates, V)

    def p(V: Vector, angles: dict[str, Scalar], rates: dict[str, Scalar]) -> Vector:
        return momenta(vehicle, V, angles, rates)

    (p_now, p_change) = jax.jvp(
        p, (V, at.angles, at.rates), (zeros, _at_names(rate, at.angles), _at_names(change.rates, at.rates))
    )
    columns = [jax.jvp(lambda V: p(V, at.angles, at.rates), (V,), (direction,))[1] for direction in _directions(V)]
    u, w, r = V[:3]
    Q = list(generalised_forces(vehicle, V, at, loads))
    bias = [
        p_change[0] - r * p_now[1],
        p_change[1] + r * p_now[0],
        p_change[2] + u * p_now[1] - w * p_now[0],
    ]
    torques = vehicle.joint_torques(configuration.inputs)
    for k, name in enumerate(vehicle.free_joints):
        tangent = {key: jnp.ones_like(u) if key == name else jnp.zeros_like(u) for key in at.angles}
        slope = jax.jvp(lambda a: kinetic_energy(vehicle, V, a, at.rates), (at.angles,), (tangent,))[1]
        bias.append(p_change[3 + k] - slope)
        Q[3 + k] = Q[3 + k] + torques.get(name, 0.0)
    right = tuple(a - b for a, b in zip(Q, bias, strict=True))
    return Balance(tuple(zip(*columns, strict=True)), right)


def generalised_forces(vehicle: AbstractVehicle, V: Vector, at: Phase, loads: AppliedForces) -> Vector:
    """Q: the wrench on the base and the virtual work of every wheel's force, for V' of `balance`."""
    X, Y, N = loads.wrench
    on_joints = [jnp.zeros_like(X) for _ in vehicle.free_joints]
    for k, wheelset in enumerate(vehicle.wheelsets):

        def placed(angles: dict[str, Scalar], wheelset=wheelset) -> Vector:
            return _scalars(vehicle.placement(wheelset, angles), V[0])

        x, y, turned = placed(at.angles)
        sine, cosine = sine_cosine(turned + at.wheels[k])
        F, T = loads.traction[k], loads.resistance[k]
        along, across = F * sine - T * cosine, -F * cosine - T * sine
        X, Y, N = X + along, Y + across, N + x * across - y * along
        for j, name in enumerate(vehicle.free_joints):
            tangent = {key: jnp.ones_like(X) if key == name else jnp.zeros_like(X) for key in at.angles}
            dx, dy, _ = jax.jvp(placed, (at.angles,), (tangent,))[1]
            on_joints[j] = on_joints[j] + along * dx + across * dy
    return (X, Y, N, *on_joints)


def accelerations(balanced: Balance) -> Vector:
    """V' of the equations of motion."""
    return solved([list(row) for row in balanced.mass], [[part] for part in balanced.right])[0]


def held_velocities(vehicle: AbstractVehicle, free: Sequence[Scalar], phase: Phase, like: Scalar) -> Vector:
    """V without slip: the velocities `vehicle.independent` have the values `free`, the others follow from the wheels.

    The condition is that the lateral speed, or the rolling speed less that of the rim, of every held wheel is zero;
    these are linear in V.
    """
    names = ("u", "w", "r", *vehicle.free_joints)
    kept = [names.index(name) for name in vehicle.independent]
    others = [k for k in range(len(names)) if k not in kept]
    start = [jnp.zeros_like(like) for _ in names]
    for k, value in zip(kept, free, strict=True):
        start[k] = value

    def slips(unknown: Vector) -> Vector:
        V = list(start)
        for k, value in zip(others, unknown, strict=True):
            V[k] = value
        lateral, rolling = wheel_velocities(vehicle, tuple(V), phase)
        held = []
        for k, wheelset in enumerate(vehicle.wheelsets):
            held += [lateral[k]] if wheelset.holds in ("lateral", "both") else []
            held += [rolling[k] - phase.rims[k]] if wheelset.holds in ("rolling", "both") else []
        return tuple(held)

    zeros = tuple(jnp.zeros_like(like) for _ in others)
    rest = slips(zeros)
    columns = [jax.jvp(slips, (zeros,), (direction,))[1] for direction in _directions(zeros)]
    if len(rest) != len(others):
        raise ValueError(
            f"{type(vehicle).__name__} holds {len(rest)} velocities of wheels, but {len(others)} velocities are not "
            f"independent."
        )
    solution = (
        solved([list(row) for row in zip(*columns, strict=True)], [[-part] for part in rest])[0] if others else ()
    )
    V = list(start)
    for k, value in zip(others, solution, strict=True):
        V[k] = value
    return tuple(V)


def solved(matrix: list[list[Scalar]], right: list[list[Scalar]]) -> list[Vector]:
    """Solutions, one for each column of `right`, of at most five equations: Gauss with partial pivoting, unrolled."""
    n = len(matrix)
    rows = [list(row) + list(side) for row, side in zip(matrix, right, strict=True)]
    for k in range(n):
        for i in range(k + 1, n):
            larger = jnp.abs(rows[i][k]) > jnp.abs(rows[k][k])
            pairs = [(jnp.where(larger, b, a), jnp.where(larger, a, b)) for a, b in zip(rows[k], rows[i], strict=True)]
            rows[k], rows[i] = [a for a, _ in pairs], [b for _, b in pairs]
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [b - factor * a for a, b in zip(rows[k], rows[i], strict=True)]
    solutions = []
    for column in range(n, len(rows[0]) if rows else n):
        x: list[Scalar] = [jnp.zeros(())] * n
        for k in reversed(range(n)):
            rest = rows[k][column]
            for j in range(k + 1, n):
                rest = rest - rows[k][j] * x[j]
            x[k] = rest / rows[k][k]
        solutions.append(tuple(x))
    return solutions


def _directions(V: Vector) -> list[Vector]:
    return [
        tuple(jnp.ones_like(part) if j == k else jnp.zeros_like(part) for j, part in enumerate(V))
        for k in range(len(V))
    ]


def _scalars(parts: Sequence, like: Scalar) -> Vector:
    return tuple(jnp.zeros_like(like) + part for part in parts)


def _at_names(rates: dict[str, Scalar], names: dict[str, Scalar]) -> dict[str, Scalar]:
    return {name: rates[name] for name in names}


def _with_free_rates(vehicle: AbstractVehicle, rates: dict[str, Scalar], V: Vector) -> dict[str, Scalar]:
    return {**rates, **dict(zip(vehicle.free_joints, V[3:], strict=True))}
