"""The grammar of laws: what may act, on which variables it may depend, and in which form; every term has a unit.

A law is a sum of terms, each an amplitude times a product of variables and one function of a variable:

    action                         function of a variable v
    X, Y, N, all three, a force    v, v^2, v |v|, v and v |v|, 1 and v, tanh(v / s), tanh((v / s)^2), a threshold, a
    in the world, drag, dry        bump, a peak, a ramp from a stop on, from two stops on, a line with play, sin and cos
    friction, force across the     of k v, what is there and is not in turns, the logarithm of a speed, what dies away
    velocity, yaw drag, grip,      with time, a product of two variables;
    rolling friction of each wheel in the plane a bump, a threshold, a stripe, a plane

    force in the world             in the plane also a spring to a point, a tether, also from a height and to a point of
                                   the body, a magnet, the slope of a hill, a whirl, a trough, a fence, a wave along a
                                   direction
    dry friction, drag             of the body, in proportion to the distance from a point (a cable dragged along), that
                                   falls with the speed (Stribeck), across a direction, in wind; of a point of the body,
                                   of a wheel there that does not steer, of the end of an arm that a joint turns
    dry friction, drag, grip,      in the plane also an oval or a rectangle with an edge; at the wheels also tiles of
    rolling friction               two kinds in turns
    grip of one axle               functions of joints; as a load that goes from axle to axle also of other variables
    rolling friction of one axle   a constant
    sliding friction of each       a constant
    wheel
    force across each wheel        functions of joints, to the same side or to opposite sides ahead and behind
    height of the floor under      in the plane a bump, a threshold, a stripe, a wave along a direction
    each wheel
    push of a joint                a yaw moment, the acceleration of a joint times a function of that joint
    unbalance of a joint           the force of a mass off its axis

A variable is one of a motion, or the angle or the rate of a joint in the world, `(rotor_rate + r)`.
Where no such form is good enough, see `smooth_forms`.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from .friction_forms import friction_forms
from .functions import EVEN, ODD, Function, functions_of
from .plane_forms import in_the_plane
from .plane_shapes import PlaneShapes
from .point_forms import of_a_point
from .terms import (
    ACTIONS,
    BACK,
    BODY_ACTION,
    DRAGGING,
    EAST,
    FRONT,
    LOAD,
    NEWTON_METRE,
    NORTH,
    OPPOSITE_SIDES,
    PUSH_SUFFIX,
    SIDE,
    SLIDING,
    WORLD_VARIABLES,
    Action,
    Family,
    Range,
    ShapeParameter,
    Term,
    may_act,
    term_of,
)
from .units import is_sum, power, product, unit_of

WORLD = ((EAST, "abc"), (NORTH, "fgh"))
"""The axes of the world, with letters for amplitudes along them."""
BODY = tuple(zip(ACTIONS[:3], ("abc", "fgh", "jlm"), strict=True))
"""The axes of the body and its yaw moment, likewise: a force in any direction that acts at any point of the body."""
ALONG = ACTIONS[0].name
"""The action of a force along the body."""
AGAINST_MOTION = ("drag", "friction")
"""The actions against the velocity of the body."""
NOWHERE = np.zeros((0, 2))
"""No places."""
OF_GRIP = ("grip", LOAD.name, FRONT.name, BACK.name)
"""Those actions that are a change of the grip."""


def families(ranges: dict[str, Range], wheel: Sequence[str], places: np.ndarray = NOWHERE) -> Iterator[Family]:
    """All forms of law of the variables in `ranges`; those named in `wheel` belong to a wheel, on which only `OF_WHEEL`
    depend. Near the `places` (M, 2) small spots are looked for."""
    pushes = [name for name in ranges if name.endswith(PUSH_SUFFIX)]
    ranges = {name: interval for name, interval in ranges.items() if name not in pushes}
    single = [name for name in ranges if not is_sum(name)]
    yield from _pushes(pushes, ranges)
    for variable, interval in ranges.items():
        for function in functions_of(variable, interval):
            for action in (*ACTIONS, *_of_axles(variable, wheel)):
                if not may_act(action, variable, wheel) or drives(action.name, variable, function.name):
                    continue
                if action.name in OF_GRIP and function.name in ("affine", "falling threshold"):
                    continue  # A constant part of the grip is that of the tyre, or of one tyre.
                yield _of_one_variable(action, function, variable)
            if variable in WORLD_VARIABLES:
                yield _along(WORLD, "world", function, variable)
            on_body = all(may_act(action, variable, wheel) for action, _ in BODY)
            if on_body and not drives(BODY_ACTION, variable, function.name):
                yield _along(BODY, BODY_ACTION, function, variable)
    for one, other in combinations(single, 2):
        if one in wheel or other in wheel:
            continue
        for action in ACTIONS[:3]:
            pair = (one, other)
            if any(drives(action.name, v, "product") or not may_act(action, v, wheel) for v in pair):
                continue
            unit = product(unit_of(one), unit_of(other))
            yield Family("product", action.name, (one, other), (term_of(action, "a", f"{one} * {other}", unit),))
            parts = tuple(term_of(action, letter, v, unit_of(v)) for letter, v in (("a", one), ("b", other)))
            # One of its parts alone is a form of one variable.
            yield Family("sum", action.name, (one, other), parts, whole=True)
    if "x" in ranges and "y" in ranges:
        shapes = PlaneShapes.of(ranges["x"], ranges["y"], places)
        yield from of_a_point(shapes, "theta" if "theta" in ranges else "heading")
        yield from in_the_plane(ranges, shapes)
    yield from friction_forms(ranges, wheel)
    for action in (*DRAGGING, SLIDING) if "axle" in wheel else ():
        variable = "slip_speed" if action is SLIDING else "rolling_speed"
        yield Family("constant", action.name, (variable,), (term_of(action, "a", "", {}),), action.shape)


def drives(action: str, variable: str, function: str) -> bool:
    """Whether a force along the body is the same whichever way the body moves, and so drives it one way: nothing
    passive does. From runs that all go forward it cannot be told from a resistance, and leads others astray."""
    if action in AGAINST_MOTION:
        return variable == "u" and function in ODD
    return action in (ALONG, BODY_ACTION) and (
        variable == "speed" or (variable == "u" and function in (*EVEN, "affine"))
    )


def _of_axles(variable: str, wheel: Sequence[str]) -> tuple[Action, ...]:
    """The actions that differ from axle to axle, which may depend on a variable; the grip of one axle alone and a force
    across each wheel depend on joints."""
    if "axle" not in wheel:
        return ()
    return (LOAD, FRONT, BACK, SIDE, OPPOSITE_SIDES) if variable.endswith(("_angle", "_rate")) else (LOAD,)


def _pushes(accelerations: Sequence[str], ranges: dict[str, Range]) -> Iterator[Family]:
    """Laws by which a joint pushes the body more or less than its inertia says."""
    for name in accelerations:
        joint, unit = name.removesuffix(PUSH_SUFFIX), product(NEWTON_METRE, power(unit_of(name), -1))
        action = Action(f"push of {joint}", (("N", name),), unit)
        for variable in (name.replace(PUSH_SUFFIX, suffix) for suffix in ("_angle", "_rate")):
            for function in functions_of(variable, ranges[variable]) if variable in ranges else ():
                if function.name not in ("affine", "linear", "threshold", "falling threshold"):
                    yield _of_one_variable(action, function, variable)
        if {f"{joint}_angle", f"{joint}_rate", "r"} <= set(ranges):
            yield _unbalance(joint)


def _unbalance(joint: str) -> Family:
    """The force of a mass off the axis of a joint at the centre of the body, at the angle q of the joint: outwards with
    the square of its rate in the world, and against its acceleration."""
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 4))
    ahead, left = f"cos({joint}_angle + q)", f"sin({joint}_angle + q)"
    out, against = f"({joint}_rate + r) ** 2", f"{joint}{PUSH_SUFFIX}"
    formulas = (("X", f"({out} * {ahead} + {against} * {left})"), ("Y", f"({out} * {left} - {against} * {ahead})"))
    variables = (f"{joint}_rate", f"{joint}_angle")
    return Family("unbalance", "unbalance", variables, (Term("a", {"N": 1, "s": 2}, formulas),), (q,))


def _of_one_variable(action: Action, function: Function, variable: str) -> Family:
    """A function of one variable acts; each of its parts has an amplitude."""
    terms = [term_of(action, "abc"[k], text, power(unit_of(variable), n)) for k, (text, n) in enumerate(function.parts)]
    return Family(function.name, action.name, (variable,), tuple(terms), (*function.shape, *action.shape))


def _along(sides: Sequence[tuple[Action, str]], name: str, function: Function, variable: str) -> Family:
    """A function of one variable acts along several `sides`; each of its parts has an amplitude for each of them."""
    terms = [
        term_of(action, letters[k], text, power(unit_of(variable), n))
        for k, (text, n) in enumerate(function.parts)
        for action, letters in sides
    ]
    return Family(function.name, name, (variable,), tuple(terms), function.shape)
