"""The grammar of laws: what may act, on which variables it may depend, and in which form; every term has a unit.

A law is a sum of terms, each an amplitude times a product of variables and one function of a variable:

    action                         function of a variable v
    X, Y, N, a force in the world  v, v^2, v |v|, v and v |v|, 1 and v, tanh(v / s), tanh((v / s)^2), a threshold, a
    drag, dry friction, force      bump, a peak, a ramp from a stop on, from two stops on, a line with play, sin and cos
    across the velocity, yaw       of k v, a product of two variables,
    drag, grip, load from axle to  in the plane a spring to a point, a tether to a point, a plane, a bump, a threshold,
    axle, push of a joint          the slope of a hill, friction in proportion to the distance from a point (a cable
                                   dragged along), dry friction that falls with the speed (Stribeck), along the velocity
                                   or each axis, dry friction or drag of a point of the body, dry friction across a
                                   direction
                                   (a push is a yaw moment, the acceleration of a joint times a function of that joint)

A variable is one of a motion, or the rate at which a joint turns in the world, `(rotor_rate + r)`.
Where no such form is good enough, see `smooth_forms`.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from snakejax.dynamics.contact import STICKING_SPEED

from .units import Unit, is_sum, power, product, unit_of

NEWTON: Unit = {"N": 1}
NEWTON_METRE: Unit = {"N": 1, "m": 1}
DAMPING: Unit = {"N": 1, "s": 1, "m": -1}
YAW_DAMPING: Unit = {"N": 1, "m": 1, "s": 1}

DRY_FRICTION = tuple(
    (side, f"-{v} / sqrt(u ** 2 + w ** 2 + {STICKING_SPEED**2})") for side, v in (("X", "u"), ("Y", "w"))
)


class Action(NamedTuple):
    """What a term acts on: the multiplier of the function for each component, and the unit of the product."""

    name: str
    components: tuple[tuple[str, str], ...]
    unit: Unit


ACTIONS = (
    Action("X", (("X", ""),), NEWTON),
    Action("Y", (("Y", ""),), NEWTON),
    Action("N", (("N", ""),), NEWTON_METRE),
    Action("drag", (("X", "-u"), ("Y", "-w")), DAMPING),
    Action("friction", DRY_FRICTION, NEWTON),
    Action("across", (("X", "-w"), ("Y", "u")), DAMPING),
    Action("yaw_drag", (("N", "-r"),), YAW_DAMPING),
    Action("grip", (("grip", "-"),), {}),
)
LOAD = Action("load", (("grip", "-axle"),), {})
"""Load goes from one axle to the other: the grip rises behind the middle by as much as it falls ahead of it."""
PUSH_SUFFIX = "_acceleration"
"""A joint pushes the body by its acceleration: this times a function of its angle or rate is an action on N."""
EAST, NORTH = Action("east", (("east", ""),), NEWTON), Action("north", (("north", ""),), NEWTON)
WORLD_VARIABLES = ("x", "y", "heading", "theta", "time")
"""The variables on which a force along the axes of the world may depend."""


class ShapeParameter(NamedTuple):
    """A parameter inside a function: `starts` of its search, its bounds and its unit."""

    name: str
    unit: Unit
    starts: tuple[float, ...]
    low: float = -np.inf
    high: float = np.inf


class Term(NamedTuple):
    """`amplitude` [unit] times a formula for each component."""

    amplitude: str
    unit: Unit
    formulas: tuple[tuple[str, str], ...]


class Family(NamedTuple):
    """A form of law: its `terms` are added; `shape` are the parameters inside them. `name` and `variables` tell it.

    `whole`: without one of its terms it is another form, or depends on where the axes of the cameras are. `together`:
    the formula of all terms for each component, where that is not their sum written out. `curvature` (T, T): the
    quadratic form of the amplitudes that says how curved the function is.
    """

    name: str
    action: str
    variables: tuple[str, ...]
    terms: tuple[Term, ...]
    shape: tuple[ShapeParameter, ...] = ()
    whole: bool = False
    together: tuple[tuple[str, str], ...] = ()
    curvature: np.ndarray | None = None

    @property
    def size(self) -> int:
        """How many parameters it has."""
        return len(self.terms) + len(self.shape)

    def expression(self) -> str:
        """`east = a * x; grip = 1 - g * x`."""
        sides: dict[str, str] = {}
        parts = [("", self.together)] if self.together else [(f"{t.amplitude} * ", t.formulas) for t in self.terms]
        for amplitude, formulas in parts:
            for component, formula in formulas:
                negative = formula.startswith("-")
                text = f"{amplitude}{formula.removeprefix('-')}".removesuffix(" * ").replace(" * 1 / ", " / ")
                before = sides.get(component, "1" if component == "grip" else "")
                sides[component] = (
                    f"{before} {'-' if negative else '+'} {text}" if before else f"{'-' * negative}{text}"
                )
        return "; ".join(f"{component} = {text}" for component, text in sides.items())


class Range(NamedTuple):
    """What was seen of a variable: its 2nd and 98th percentile."""

    low: float
    high: float

    @property
    def width(self) -> float:
        return max(self.high - self.low, 1e-9)

    @property
    def largest(self) -> float:
        return max(abs(self.low), abs(self.high), 1e-9)


class _Function(NamedTuple):
    """Functions of one variable that a law adds up: text with the power of the unit of the variable in it."""

    name: str
    parts: tuple[tuple[str, int], ...]
    shape: tuple[ShapeParameter, ...] = ()


def _functions(variable: str, interval: Range) -> Iterator[_Function]:
    """The functions of one variable."""
    v, unit, angle = variable, unit_of(variable), variable in ("heading", "theta")
    if angle:
        yield _Function("harmonic", ((f"sin({v})", 0), (f"cos({v})", 0)))
        yield _Function("second harmonic", ((f"sin(2 * {v})", 0), (f"cos(2 * {v})", 0)))
        return
    yield _Function("linear", ((v, 1),))
    yield _Function("square", ((f"{v} ** 2", 2),))
    if interval.low < 0 < interval.high:
        yield _Function("absolute value", ((f"abs({v})", 1),))
        yield _Function("signed square", ((f"{v} * abs({v})", 2),))
        yield _Function("linear and signed square", ((v, 1), (f"{v} * abs({v})", 2)))
    yield _Function("affine", (("", 0), (v, 1)))
    scales = tuple(interval.largest * part for part in (0.1, 0.25, 0.5, 1.0))
    s = ShapeParameter("s", unit, scales, 0.01 * interval.largest, 20 * interval.largest)
    yield _Function("saturation", ((f"tanh({v} / s)", 0),), (s,))
    yield _Function("even saturation", ((f"tanh(({v} / s) ** 2)", 0),), (s,))
    places = tuple(interval.low + interval.width * part for part in np.linspace(0.08, 0.92, 8))
    # Beyond what was seen, the tail of a threshold or bump would stand for a force that nobody knows there.
    v0 = ShapeParameter("v0", unit, places, interval.low, interval.high)
    widths = tuple(interval.width * part for part in (0.04, 0.1, 0.25))
    width = ShapeParameter("s", unit, widths, 0.005 * interval.width, 5 * interval.width)
    yield _Function("threshold", ((f"(0.5 + 0.5 * tanh(({v} - v0) / s))", 0),), (v0, width))
    yield _Function("bump", ((f"exp(-(({v} - v0) / s) ** 2)", 0),), (v0, width))
    yield _Function("peak", ((f"1 / (1 + (({v} - v0) / s) ** 2)", 0),), (v0, width))
    yield from _ramps(v, unit, interval)
    if variable in ("x", "y", "time") or variable.endswith("_angle"):
        yield _Function("wave", ((f"sin(k * {v})", 0), (f"cos(k * {v})", 0)), (wave_number(v, interval),))


def _ramps(v: str, unit: Unit, interval: Range) -> Iterator[_Function]:
    """Functions that are zero on one side of v0 and grow along a line on the other, with a corner that is round over s:
    from a stop on, from two stops on, and what a spring with play does."""
    places = tuple(interval.low + interval.width * part for part in (0.1, 0.3, 0.5, 0.7, 0.9))
    v0 = ShapeParameter("v0", unit, places, interval.low, interval.high)
    s = ShapeParameter("s", unit, (0.05 * interval.width,), 0.002 * interval.width, interval.width)
    for name, beyond in (("ramp", f"{v} - v0"), ("falling ramp", f"v0 - {v}")):
        yield _Function(name, ((f"({beyond} + sqrt(({v} - v0) ** 2 + s ** 2))", 1),), (v0, s))
    if interval.low < 0 < interval.high:
        play = min(-interval.low, interval.high)
        v0 = v0._replace(starts=tuple(play * part for part in (0.2, 0.4, 0.6, 0.8)), low=0.0, high=play)
        above, below = (f"sqrt(({v} {sign} v0) ** 2 + s ** 2)" for sign in "-+")
        yield _Function("two ramps", ((f"({above} + {below} - 2 * v0)", 1),), (v0, s))
        yield _Function("play", ((f"(2 * {v} + {above} - {below})", 1),), (v0, s))


def wave_number(variable: str, interval: Range) -> ShapeParameter:
    """The wave number k of a form that is periodic in a variable: half a wave to fifteen over what was seen of it."""
    numbers = tuple(np.pi / interval.width * np.arange(1.0, 31.0))
    return ShapeParameter("k", power(unit_of(variable), -1), numbers, 0.3 * numbers[0], 1.2 * numbers[-1])


def acting(action: Action, formula: str) -> tuple[tuple[str, str], ...]:
    """For each component of an `action`, what this multiplies a `formula` by, times it."""
    texts = []
    for component, multiplier in action.components:
        bare = multiplier.removeprefix("-")
        joined = " * ".join(part for part in (bare, formula) if part)
        texts.append((component, "-" * multiplier.startswith("-") + joined))
    return tuple(texts)


def _term(action: Action, amplitude: str, formula: str, unit: Unit) -> Term:
    """An amplitude so that it times `formula`, which has `unit`, acts."""
    return Term(amplitude, product(action.unit, power(unit, -1)), acting(action, formula))


def families(ranges: dict[str, Range], wheel: Sequence[str]) -> Iterator[Family]:
    """All forms of law of the variables in `ranges`; those named in `wheel` belong to a wheel, so only its grip."""
    pushes = [name for name in ranges if name.endswith(PUSH_SUFFIX)]
    ranges = {name: interval for name, interval in ranges.items() if name not in pushes}
    single = [name for name in ranges if not is_sum(name)]
    yield from _pushes(pushes, ranges)
    for variable, interval in ranges.items():
        for function in _functions(variable, interval):
            for action in (*ACTIONS, LOAD) if "axle" in wheel else ACTIONS:
                if variable in wheel and action.name != "grip":
                    continue
                if action.name in ("grip", "load") and function.name == "affine":
                    continue  # A constant part of the grip is that of the tyre, or of one tyre.
                yield _of_one_variable(action, function, variable)
            if variable in WORLD_VARIABLES:
                yield _world(function, variable)
    for one, other in combinations(single, 2):
        if one in wheel or other in wheel:
            continue
        for action in ACTIONS[:3]:
            unit = product(unit_of(one), unit_of(other))
            yield Family("product", action.name, (one, other), (_term(action, "a", f"{one} * {other}", unit),))
            parts = tuple(_term(action, letter, v, unit_of(v)) for letter, v in (("a", one), ("b", other)))
            # One of its parts alone is a form of one variable.
            yield Family("sum", action.name, (one, other), parts, whole=True)
    if "x" in ranges and "y" in ranges:
        yield from _in_the_plane(ranges)
    if {"u", "speed"} <= set(ranges):
        yield from _stribeck(ranges["speed"].largest)
        yield _friction_across("theta" if "theta" in ranges else "heading", ranges["speed"].largest)
        if "r" in ranges:
            yield from _at_a_point(ranges["speed"].largest, ranges["speed"].largest / ranges["r"].largest)


def _at_a_point(fastest: float, size: float) -> Iterator[Family]:
    """Dry friction or drag of a point that is p ahead of the centre and q to its left: what the body drags along.
    `size` [m]: where a turn moves a point as fast as the body moves. Dry friction begins over the speed s."""
    metre: Unit = {"m": 1}
    s = ShapeParameter("s", {"m": 1, "s": -1}, (0.01 * fastest, 0.1 * fastest), 0.003 * fastest, fastest)
    starts = (tuple(size * part for part in parts) for parts in ((-2, -1, -0.4, 0.4, 1, 2), (-1, -0.3, 0, 0.3, 1)))
    shape = tuple(ShapeParameter(k, metre, v, -10 * size, 10 * size) for k, v in zip("pq", starts, strict=True))
    along, across = "(u - q * r)", "(w + p * r)"
    turn = f"(p * {across} - q * {along})"
    length = f" / sqrt({along} ** 2 + {across} ** 2 + s ** 2)"
    for name, over, unit, own in (("friction", length, NEWTON, (*shape, s)), ("drag", "", DAMPING, shape)):
        formulas = tuple((side, f"-{v}{over}") for side, v in (("X", along), ("Y", across), ("N", turn)))
        yield Family(f"{name} at a point", name, ("u", "w", "r"), (Term("a", unit, formulas),), own)


def _friction_across(angle: str, fastest: float) -> Family:
    """Dry friction against motion along the direction q in the world alone, as across the joints of floor boards."""
    s = ShapeParameter("s", {"m": 1, "s": -1}, (0.05 * fastest, 0.3 * fastest), 0.005 * fastest, 5 * fastest)
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 8))
    cosine, sine = f"cos(q - {angle})", f"sin(q - {angle})"
    against = f"-tanh((u * {cosine} + w * {sine}) / s)"
    formulas = (("X", f"{against} * {cosine}"), ("Y", f"{against} * {sine}"))
    return Family("friction across", "friction", (angle,), (Term("a", NEWTON, formulas),), (q, s))


def _stribeck(fastest: float) -> Iterator[Family]:
    """Dry friction of the body that falls from a + b at rest to a at speed, along the velocity or along each axis."""
    unit: Unit = {"m": 1, "s": -1}
    v0 = ShapeParameter("v0", unit, tuple(fastest * part for part in (0.1, 0.2, 0.4)), 0.01 * fastest, 5 * fastest)
    s = ShapeParameter("s", unit, tuple(fastest * part for part in (0.02, 0.08, 0.3)), 0.005 * fastest, 5 * fastest)
    along_axes = (("X", "-tanh(u / s)"), ("Y", "-tanh(w / s)"))
    for name, sides, shape in (("friction", DRY_FRICTION, (v0,)), ("friction of each axis", along_axes, (s, v0))):
        falling = tuple((side, f"{against} * exp(-(speed / v0) ** 2)") for side, against in sides)
        terms = (Term("a", NEWTON, sides), Term("b", NEWTON, falling))
        yield Family(f"falling {name}", "friction", ("speed",), terms, shape)


def _pushes(accelerations: Sequence[str], ranges: dict[str, Range]) -> Iterator[Family]:
    """Laws by which a joint pushes the body more or less than its inertia says."""
    for name in accelerations:
        unit = product(NEWTON_METRE, power(unit_of(name), -1))
        action = Action(f"push of {name.removesuffix(PUSH_SUFFIX)}", (("N", name),), unit)
        for variable in (name.replace(PUSH_SUFFIX, suffix) for suffix in ("_angle", "_rate")):
            for function in _functions(variable, ranges[variable]) if variable in ranges else ():
                if function.name not in ("affine", "linear", "threshold"):
                    yield _of_one_variable(action, function, variable)


def _of_one_variable(action: Action, function: _Function, variable: str) -> Family:
    """A function of one variable acts; each of its parts has an amplitude."""
    terms = [_term(action, "abc"[k], text, power(unit_of(variable), n)) for k, (text, n) in enumerate(function.parts)]
    return Family(function.name, action.name, (variable,), tuple(terms), function.shape)


def _world(function: _Function, variable: str) -> Family:
    terms = []
    for k, (text, n) in enumerate(function.parts):
        for action, letter in ((EAST, "abc"[k]), (NORTH, "fgh"[k])):
            terms.append(_term(action, letter, text, power(unit_of(variable), n)))
    return Family(function.name, "world", (variable,), tuple(terms), function.shape)


def _in_the_plane(ranges: dict[str, Range]) -> Iterator[Family]:
    """Laws of the place."""
    metre: Unit = {"m": 1}
    size = max(ranges["x"].width, ranges["y"].width)
    pull = Term("k", {"N": 1, "m": -1}, (("east", "-x"), ("north", "-y")))
    constant = (_term(EAST, "a", "", {}), _term(NORTH, "b", "", {}))
    # Without a constant, its point would be on an axis of the world, which lies where the cameras have it.
    yield Family("spring", "world", ("x", "y"), (pull, *constant), whole=True)
    planes = [
        _term(side, letter, v, metre)
        for side, letters in ((EAST, "cd"), (NORTH, "fg"))
        for letter, v in zip(letters, "xy", strict=True)
    ]
    yield Family("plane", "world", ("x", "y"), (*constant, *planes))
    middles = [
        ShapeParameter(
            f"{v}0",
            metre,
            tuple(np.linspace(ranges[v].low, ranges[v].high, 6)),
            ranges[v].low - size,
            ranges[v].high + size,
        )
        for v in "xy"
    ]
    s = ShapeParameter("s", metre, (0.15 * size, 0.4 * size), 0.01 * size, 5 * size)
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 8))
    d = ShapeParameter("d", metre, tuple(size * np.linspace(-0.4, 0.4, 5)), -3 * size, 3 * size)
    bump = "exp(-((x - x0) ** 2 + (y - y0) ** 2) / s ** 2)"
    slope = (("east", f"(x - x0) * {bump}"), ("north", f"(y - y0) * {bump}"))
    yield Family("hill", "world", ("x", "y"), (Term("a", {"N": 1, "m": -1}, slope),), (*middles, s))
    # Without a slack length it is a spring, and without a corner nobody can follow its slope.
    away, corner = "sqrt((x - x0) ** 2 + (y - y0) ** 2 + s ** 2)", s._replace(starts=(0.05 * size,), low=0.002 * size)
    slack = ShapeParameter("d", metre, (0.2 * size, 0.5 * size, 0.8 * size), 0.0, 5 * size)
    taut = f"({away} - d + sqrt(({away} - d) ** 2 + s ** 2)) / {away}"
    pull = (("east", f"-(x - x0) * {taut}"), ("north", f"-(y - y0) * {taut}"))
    yield Family("tether", "world", ("x", "y"), (Term("k", {"N": 1, "m": -1}, pull),), (*middles, slack, corner))
    distance = tuple((side, f"{against} * sqrt((x - x0) ** 2 + (y - y0) ** 2)") for side, against in DRY_FRICTION)
    yield Family("cable", "friction", ("x", "y"), (Term("a", {"N": 1, "m": -1}, distance),), tuple(middles))
    of_wheels = [
        (action, ("wheel_x", "wheel_y")) for action in ACTIONS if action.name == "grip" and "wheel_x" in ranges
    ]
    for action, place in [*((action, ("x", "y")) for action in ACTIONS), *of_wheels]:
        x, y = place
        bump = f"exp(-(({x} - x0) ** 2 + ({y} - y0) ** 2) / s ** 2)"
        edge = f"(0.5 + 0.5 * tanh(({x} * cos(q) + {y} * sin(q) - d) / s))"
        plane = tuple(_term(action, a, v, metre) for a, v in (("a", x), ("b", y)))
        yield Family("plane", action.name, place, plane)
        yield Family("bump in the plane", action.name, place, (_term(action, "a", bump, {}),), (*middles, s))
        yield Family("threshold in the plane", action.name, place, (_term(action, "a", edge, {}),), (q, d, s))
