"""The functions of one variable of which laws are made."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .terms import Range, ShapeParameter
from .units import Unit, is_direction, power, unit_of


class Function(NamedTuple):
    """Functions of one variable that a law adds up: text with the power of the unit of the variable in it."""

    name: str
    parts: tuple[tuple[str, int], ...]
    shape: tuple[ShapeParameter, ...] = ()


EVEN = ("square", "absolute value", "even saturation", "two ramps", "round absolute value")
"""The names of those that do not change with the sign of their variable."""
ODD = ("linear", "signed square", "linear and signed square", "saturation", "play")
"""The names of those that change their sign with that of their variable."""


def functions_of(variable: str, interval: Range) -> Iterator[Function]:
    """The functions of one variable."""
    v, unit = variable, unit_of(variable)
    if is_direction(v):
        yield Function("harmonic", ((f"sin({v})", 0), (f"cos({v})", 0)))
        yield Function("second harmonic", ((f"sin(2 * {v})", 0), (f"cos(2 * {v})", 0)))
        q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 8))
        yield Function("square of a cosine", ((f"cos({v} - q) * abs(cos({v} - q))", 0),), (q,))
        return
    yield Function("linear", ((v, 1),))
    yield Function("square", ((f"{v} ** 2", 2),))
    if interval.low < 0 < interval.high:
        yield Function("absolute value", ((f"abs({v})", 1),))
        yield Function("signed square", ((f"{v} * abs({v})", 2),))
        yield Function("linear and signed square", ((v, 1), (f"{v} * abs({v})", 2)))
    yield Function("affine", (("", 0), (v, 1)))
    scales = tuple(interval.largest * part for part in (0.1, 0.25, 0.5, 1.0))
    s = ShapeParameter("s", unit, scales, 0.01 * interval.largest, 20 * interval.largest)
    yield Function("saturation", ((f"tanh({v} / s)", 0),), (s,))
    yield Function("even saturation", ((f"tanh(({v} / s) ** 2)", 0),), (s,))
    places = tuple(interval.low + interval.width * part for part in np.linspace(0.08, 0.92, 8))
    # Beyond what was seen, the tail of a threshold or bump would stand for a force that nobody knows there.
    v0 = ShapeParameter("v0", unit, places, interval.low, interval.high)
    widths = tuple(interval.width * part for part in (0.04, 0.1, 0.25))
    width = ShapeParameter("s", unit, widths, 0.005 * interval.width, 5 * interval.width)
    yield Function("threshold", ((f"(0.5 + 0.5 * tanh(({v} - v0) / s))", 0),), (v0, width))
    yield Function("falling threshold", ((f"(0.5 - 0.5 * tanh(({v} - v0) / s))", 0),), (v0, width))
    yield Function("bump", ((f"exp(-(({v} - v0) / s) ** 2)", 0),), (v0, width))
    yield Function("peak", ((f"1 / (1 + (({v} - v0) / s) ** 2)", 0),), (v0, width))
    yield from _ramps(v, unit, interval)
    if variable == "time":
        # From the start of a recording on: of what began before, the amplitude is that at its start.
        times = tuple(interval.width * part for part in (0.1, 0.3, 1.0))
        of_time = ShapeParameter("s", unit, times, 0.01 * interval.width, 20 * interval.width)
        yield Function("decay", ((f"exp(-{v} / s)", 0),), (of_time,))
    if variable.endswith("speed"):
        yield _logarithm(v, unit, interval)
    if variable in ("x", "y", "time"):
        yield _square_wave(v, interval)
    if variable in ("x", "y", "time") or variable.endswith("_angle"):
        yield Function("wave", ((f"sin(k * {v})", 0), (f"cos(k * {v})", 0)), (wave_number(v, interval),))


def _ramps(v: str, unit: Unit, interval: Range) -> Iterator[Function]:
    """Functions that are zero on one side of v0 and grow along a line on the other, with a corner that is round over s:
    from a stop on, from two stops on, what a spring with play does, and the same without a stop."""
    places = tuple(interval.low + interval.width * part for part in (0.1, 0.3, 0.5, 0.7, 0.9))
    v0 = ShapeParameter("v0", unit, places, interval.low, interval.high)
    s = ShapeParameter("s", unit, (0.05 * interval.width,), 0.002 * interval.width, interval.width)
    for name, beyond in (("ramp", f"{v} - v0"), ("falling ramp", f"v0 - {v}")):
        yield Function(name, ((f"({beyond} + sqrt(({v} - v0) ** 2 + s ** 2))", 1),), (v0, s))
    if interval.low < 0 < interval.high:
        play = min(-interval.low, interval.high)
        v0 = v0._replace(starts=tuple(play * part for part in (0.2, 0.4, 0.6, 0.8)), low=0.0, high=play)
        above, below = (f"sqrt(({v} {sign} v0) ** 2 + s ** 2)" for sign in "-+")
        yield Function("two ramps", ((f"({above} + {below} - 2 * v0)", 1),), (v0, s))
        widths = ShapeParameter("s", unit, (0.1 * interval.largest,), 0.01 * interval.largest, interval.largest)
        yield Function("round absolute value", ((f"(sqrt({v} ** 2 + s ** 2) - s)", 1),), (widths,))
        yield Function("play", ((f"(2 * {v} + {above} - {below})", 1),), (v0, s))


def _logarithm(v: str, unit: Unit, interval: Range) -> Function:
    """What grows with the logarithm of a speed beyond s, as the friction of rubber does (Grosch 1963), and that of rock
    (Dieterich 1979)."""
    starts = tuple(interval.largest * part for part in (0.003, 0.03, 0.3))
    s = ShapeParameter("s", unit, starts, 1e-4 * interval.largest, 20 * interval.largest)
    return Function("logarithm", ((f"log(1 + ({v} / s) ** 2)", 0),), (s,))


def _square_wave(v: str, interval: Range) -> Function:
    """What is there and is not, in turns: from tile to tile, or as a ventilation that switches itself on and off."""
    k = wave_number(v, interval)
    k = k._replace(starts=k.starts[1:20])
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(4) / 2))
    s = ShapeParameter("s", {}, (0.3,), 0.02, 3.0)
    return Function("square wave", ((f"(0.5 + 0.5 * tanh(sin(k * {v} + q) / s))", 0),), (k, q, s))


def wave_number(variable: str, interval: Range) -> ShapeParameter:
    """The wave number k of a form that is periodic in a variable: half a wave to fifteen over what was seen of it."""
    numbers = tuple(np.pi / interval.width * np.arange(1.0, 31.0))
    return ShapeParameter("k", power(unit_of(variable), -1), numbers, 0.3 * numbers[0], 1.2 * numbers[-1])
