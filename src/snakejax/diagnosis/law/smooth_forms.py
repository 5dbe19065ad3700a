"""Forms of law without a formula: smooth functions of one or two variables, through values at knots.

They follow whatever the force does, so they cost many parameters. In the regression their curvature is penalised: the
squares of second differences of neighbouring values are added to chi^2, with that weight which predicts runs left out
best. Of few knots and many, too, those are taken that predict best.

    action                         function
    X, Y, N, drag, dry friction,   a natural cubic spline of one variable, a Fourier series of an angle or, with a wave
    across the velocity,           number of its own, of a place or the angle of a joint;
    yaw drag, grip                 a product of splines of two variables
    height of the floor            a product of splines of the place of a wheel
"""

import re
from collections.abc import Iterator, Sequence
from itertools import combinations
from math import isqrt

import numpy as np

from .functions import wave_number
from .terms import (
    ACTIONS,
    EAST,
    HEIGHT,
    NORTH,
    PUSH_SUFFIX,
    WORLD_VARIABLES,
    Action,
    Family,
    Range,
    ShapeParameter,
    Term,
    acting,
    may_act,
)
from .units import is_direction, is_sum

KNOTS = (4, 6, 9, 14)
"""Numbers of knots of a spline."""
SIDE = 4
"""Knots along each variable of a function of two."""
HARMONICS = 5
"""The highest harmonic of a series."""
REPEATS = (1, 2, 3, 4, 6)
"""So many times in a turn a series in a heading repeats."""
SIDES_OF_FLOOR = (4, 6)
"""The same of the height of a floor, which may be uneven in several places."""


def smooth_of_one(ranges: dict[str, Range], wheel: Sequence[str]) -> Iterator[Family]:
    """The smooth functions of one variable of `ranges`; of those named in `wheel` only the grip may be one."""
    for variable, interval in ranges.items():
        if variable.endswith(PUSH_SUFFIX):
            continue
        for action in _actions(variable, wheel):
            yield from _of_one(action, variable, interval, wheel)
        if variable in WORLD_VARIABLES:
            sides = (_of_one(action, variable, interval, wheel) for action in (EAST, NORTH))
            yield from (_in_world(east, north) for east, north in zip(*sides, strict=True))


def _of_one(action: Action, variable: str, interval: Range, wheel: Sequence[str]) -> Iterator[Family]:
    """The smooth functions of one variable for one `action`."""
    if is_direction(variable):
        yield from (_series(action, variable, times) for times in REPEATS)
        return
    for knots in KNOTS:
        yield _spline(action, variable, interval, knots)
    if variable in ("x", "y", "time") or (variable.endswith("_angle") and variable not in wheel):
        shape = (wave_number(variable, interval),)
        yield _series(action, f"k * {variable}", 1, shape)._replace(variables=(variable,))


def _in_world(east: Family, north: Family) -> Family:
    """A force in the world each side of which is a function of its own: the values of `north` get other letters."""

    def own(text: str) -> str:
        return re.sub(r"\b[cs](?=\d)", lambda letter: {"c": "f", "s": "g"}[letter[0]], text)

    terms = (*east.terms, *(term._replace(amplitude=own(term.amplitude)) for term in north.terms))
    together = (*east.together, *((component, own(formula)) for component, formula in north.together))
    curvature = None if east.curvature is None else np.kron(np.eye(2), east.curvature)
    return east._replace(action="world", terms=terms, together=together, curvature=curvature)


def smooth_of_two(
    ranges: dict[str, Range], wheel: Sequence[str], action: str, variables: Sequence[str]
) -> Iterator[Family]:
    """The smooth functions of two variables of `ranges`, of which one is in `variables`, for one `action`."""
    single = [v for v in ranges if not (is_sum(v) or v.endswith(PUSH_SUFFIX))]
    usual = [v for v in single if not is_direction(v) and v not in wheel]
    for one, other in combinations(usual, 2):
        if {one, other} & set(variables):
            acts = [a for a in _actions(one, wheel) if a.name == action and a in _actions(other, wheel)]
            for each in acts:
                yield _surface(each, (one, other), (ranges[one], ranges[other]))


def smooth_floors(ranges: dict[str, Range]) -> Iterator[Family]:
    """The smooth functions of the place of a wheel that may be the height of the floor."""
    if "wheel_x" in ranges and "wheel_y" in ranges:
        place, intervals = ("wheel_x", "wheel_y"), (ranges["wheel_x"], ranges["wheel_y"])
        yield from (_surface(HEIGHT, place, intervals, side) for side in SIDES_OF_FLOOR)


def _actions(variable: str, wheel: Sequence[str]) -> tuple[Action, ...]:
    """What a function of a variable may act on; values at knots are the only parameters."""
    known = tuple(action for action in ACTIONS if not action.shape and may_act(action, variable, wheel))
    return (*known, EAST, NORTH) if variable in WORLD_VARIABLES else known


def _spline(action: Action, variable: str, interval: Range, knots: int) -> Family:
    low, high = f"{interval.low:.4g}", f"{interval.high:.4g}"
    return _through_values(action, "smooth function", (variable,), f"spline({variable}, {low}, {high}", knots)


def _surface(action: Action, variables: tuple[str, str], intervals: tuple[Range, Range], side: int = SIDE) -> Family:
    sides = (f"{v}, {i.low:.4g}, {i.high:.4g}" for v, i in zip(variables, intervals, strict=True))
    return _through_values(action, "smooth function of two", variables, f"surface({', '.join(sides)}", side**2)


def _through_values(action: Action, name: str, variables: tuple[str, ...], call: str, count: int) -> Family:
    """A function through `count` values, each of which has the unit of the `action`; the first value of a
    grip or of a height is zero: a constant part of the grip is that of the tyre, and a height has no zero."""
    values = [f"c{k + 1}" for k in range(count)]
    if action.name in ("grip", "height"):
        values[0] = "0"
    terms = []
    for k, value in enumerate(values):
        alone = ", ".join("1" if j == k else "0" for j in range(count))
        if value != "0":
            terms.append(Term(value, action.unit, acting(action, f"{call}, {alone})")))
    together = acting(action, f"{call}, {', '.join(values)})")
    curvature = _curvature(count if len(variables) == 1 else isqrt(count), len(variables))
    curvature = curvature[count - len(terms) :, count - len(terms) :]
    return Family(name, action.name, variables, tuple(terms), whole=True, together=together, curvature=curvature)


def _curvature(knots: int, variables: int) -> np.ndarray:
    """The sum of squared second differences of values at `knots` along each of one or two variables, as a form."""
    second = np.diff(np.eye(knots), 2, axis=0)
    of_one, same = second.T @ second, np.eye(knots)
    return of_one if variables == 1 else np.kron(of_one, same) + np.kron(same, of_one)


def _series(action: Action, angle: str, times: int, shape: tuple[ShapeParameter, ...] = ()) -> Family:
    """A Fourier series of an `angle` that repeats so many `times` in a turn."""
    terms = []
    for n in range(1, HARMONICS + 1):
        multiple = angle if n * times == 1 else f"{n * times} * {angle}"
        terms += [Term(f"{f[0]}{n}", action.unit, acting(action, f"{f}({multiple})")) for f in ("sin", "cos")]
    return Family("series", action.name, (angle,), tuple(terms), shape)
