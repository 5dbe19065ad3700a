"""A model in the form of a CommonRoad vehicle parameter file (Althoff, Koschi, Manzinger, IV 2017)."""

import json
import math

import jax.numpy as jnp

from snakejax.core.errors import InputError
from snakejax.core.parameter import own_parameters, parameters
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Bakker, Pacejka


def commonroad_yaml(model: Model) -> str:
    """`model` as YAML with the keys of CommonRoad's vehicle parameters, in SI units.

    `m` [kg]; `I_z` [kg m^2]; `a`, `b` [m]: the wheelsets ahead of and behind the centre of mass. `tire`, with the load
    F_z of a wheelset: p_dy1 = D / F_z; p_cy1 = C; p_ey1 = E; p_ky1 = -B C D / F_z, negative since CommonRoad counts the
    slip angle to the other side; left out where front and rear differ in tyre or load. What CommonRoad has no key for
    stands under `snakejax`: the other measures of the vehicle, the parameters of the tyre, the structure, the effects.

    **Raises:** `InputError` for a vehicle without one wheelset ahead of and one behind the centre of mass.
    """
    board = model.effective_vehicle()
    straight = {name: jnp.zeros(()) for name in (*(one.name for one in board.inputs), *board.free_joints)}
    arms = sorted(float(board.placement(wheelset, straight).x) for wheelset in board.wheelsets)
    if len(arms) != 2 or not arms[0] < 0 < arms[1]:
        what = f"CommonRoad's vehicles have one axle ahead of the centre of mass and one behind, not {len(arms)} at"
        places = ", ".join(f"{arm:g} m" for arm in arms)
        raise InputError(f"{what} {places}", "commonroad_yaml()", "export a vehicle with two")
    lines = [
        "# Vehicle parameters in the form of CommonRoad, SI units",
        _line("m", board.mass),
        _line("I_z", board.total_inertia),
        _line("a", arms[1]),
        _line("b", -arms[0]),
    ]
    tyre = model.tyre.coefficients() if isinstance(model.tyre, Bakker) else model.tyre
    loads = [float(board.load(wheelset)) for wheelset in board.wheelsets]
    if isinstance(tyre, Pacejka) and model.constraint.slips and math.isclose(*loads):
        load = loads[0]
        B, C, D, E = (float(part) for part in (tyre.B, tyre.C, tyre.D, tyre.E))
        values = {"p_cy1": C, "p_dy1": D / load, "p_ey1": E, "p_ky1": -B * C * D / load}
        lines += ["tire:", *(_line(name, value, 2) for name, value in values.items())]
    lines += ["snakejax:", f"  structure: {json.dumps(model.structure)}", f"  tyre_law: {type(model.tyre).__name__}"]
    parts = {"vehicle": model.board, "tyre": model.tyre}
    for title, part in parts.items():
        lines += [f"  {title}:", *(_line(name, p.value, 4) for name, p in parameters(part).items())]
    lines.append("  effects:" if model.effects else "  effects: {}")
    for name, effect in model.effects.items():
        own = [_line(parameter, p.value, 6) for parameter, p in own_parameters(effect)]
        lines += [f"    {json.dumps(name)}:" if own else f"    {json.dumps(name)}: {{}}", *own]
    return "\n".join(lines) + "\n"


def _line(name: str, value: object, indent: int = 0) -> str:
    number = float(value)  # type: ignore[arg-type]
    if not math.isfinite(number):
        raise InputError(f"{name} is not finite", "commonroad_yaml()", "export a model with finite parameters")
    # YAML 1.1 takes 1e-05 for a string, 1.0e-05 for a number.
    text = repr(number)
    mantissa, exponent, power = text.partition("e")
    return f"{' ' * indent}{name}: {mantissa if '.' in mantissa else mantissa + '.0'}{exponent}{power}"
