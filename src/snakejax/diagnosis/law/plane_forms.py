"""Forms of law of the place: what stands or lies on the floor, slopes of it, and what holds the vehicle by a line."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from snakejax.dynamics.law import PLACE_OF_WHEEL

from .terms import (
    ACTIONS,
    DRY_FRICTION,
    EAST,
    HEIGHT,
    NORTH,
    OF_WHEEL,
    Action,
    Family,
    Range,
    ShapeParameter,
    Term,
    term_of,
)
from .units import Unit


def in_the_plane(ranges: dict[str, Range]) -> Iterator[Family]:
    """Laws of the place."""
    metre: Unit = {"m": 1}
    size = max(ranges["x"].width, ranges["y"].width)
    pull = Term("k", {"N": 1, "m": -1}, (("east", "-x"), ("north", "-y")))
    constant = (term_of(EAST, "a", "", {}), term_of(NORTH, "b", "", {}))
    # Without a constant, its point would be on an axis of the world, which lies where the cameras have it.
    yield Family("spring", "world", ("x", "y"), (pull, *constant), whole=True)
    planes = [
        term_of(side, letter, v, metre)
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
    whirl = (("east", f"-(y - y0) * {bump}"), ("north", f"(x - x0) * {bump}"))
    yield Family("whirl", "world", ("x", "y"), (Term("a", {"N": 1, "m": -1}, whirl),), (*middles, s))
    # Without a slack length it is a spring, and without a corner nobody can follow its slope.
    away, corner = "sqrt((x - x0) ** 2 + (y - y0) ** 2 + s ** 2)", s._replace(starts=(0.05 * size,), low=0.002 * size)
    slack = ShapeParameter("d", metre, (0.2 * size, 0.5 * size, 0.8 * size), 0.0, 5 * size)
    taut = _taut(away)
    pull = (("east", f"-(x - x0) * {taut}"), ("north", f"-(y - y0) * {taut}"))
    yield Family("tether", "world", ("x", "y"), (Term("k", {"N": 1, "m": -1}, pull),), (*middles, slack, corner))
    angle = "theta" if "theta" in ranges else "heading"
    yield _tied(angle, middles, slack, corner, size)
    yield _magnet(angle, middles, s._replace(starts=(0.1 * size, 0.25 * size)), size)
    distance = tuple((side, f"{against} * sqrt((x - x0) ** 2 + (y - y0) ** 2)") for side, against in DRY_FRICTION)
    yield Family("cable", "friction", ("x", "y"), (Term("a", {"N": 1, "m": -1}, distance),), tuple(middles))
    # On which side of a line something is, the direction says: it turns once around. A grip or a height may fall as
    # well as rise there, as their constant part is free.
    around = q._replace(starts=tuple(np.pi * np.arange(16) / 8))
    at_wheels = [action for action in ACTIONS if action.name in OF_WHEEL and "wheel_x" in ranges]
    for action in at_wheels:
        yield from _coverings(action, PLACE_OF_WHEEL, middles, size)
    for action in ACTIONS:
        if action.name in ("friction", "drag"):
            yield from _coverings(action, ("x", "y"), middles, size)
    for action, (x, y) in [*((action, "xy") for action in ACTIONS), *((one, PLACE_OF_WHEEL) for one in at_wheels)]:
        plane = tuple(term_of(action, a, v, metre) for a, v in (("a", x), ("b", y)))
        yield Family("plane", action.name, (x, y), plane, action.shape)
        sided = q if action.name == "grip" else around
        yield from _spots((action,), action.name, (x, y), (*middles, s), (sided, d, s))
    yield from _spots((EAST, NORTH), "world", ("x", "y"), (*middles, s), (around, d, s))
    yield from _waves((EAST, NORTH), "world", ("x", "y"), q, size)
    trough = f"tanh({_beyond('x', 'y')} / s)"
    yield Family("trough", "world", ("x", "y"), _each((EAST, NORTH), "ab", trough), (q, d, s), whole=True)
    away = _beyond("x", "y")
    fence = f"({away} + sqrt({away} ** 2 + s ** 2))"
    sides = _each((EAST, NORTH), "ab", fence, metre)
    yield Family("fence", "world", ("x", "y"), sides, (around, d, corner), whole=True)
    if "wheel_x" in ranges:
        yield from _spots((HEIGHT,), "height", PLACE_OF_WHEEL, (*middles, s), (q, d, s))
        yield from _waves((HEIGHT,), "height", PLACE_OF_WHEEL, q, size)


def _beyond(x: str, y: str) -> str:
    """How far a place is beyond a line, which is d from the origin in the direction q."""
    return f"({x} * cos(q) + {y} * sin(q) - d)"


def _each(actions: Sequence[Action], letters: str, text: str, unit: Unit | None = None) -> tuple[Term, ...]:
    """A term for each of the `actions` with the same function of the place, which has a `unit` or is a pure number."""
    return tuple(term_of(action, letter, text, unit or {}) for action, letter in zip(actions, letters, strict=True))


def _spots(
    actions: Sequence[Action],
    name: str,
    place: tuple[str, str],
    around: tuple[ShapeParameter, ...],
    along: tuple[ShapeParameter, ...],
) -> Iterator[Family]:
    """What is there around a point, on one side of a line, or along a line."""
    x, y = place
    functions = {
        "bump": (f"exp(-(({x} - x0) ** 2 + ({y} - y0) ** 2) / s ** 2)", around),
        "threshold": (f"(0.5 + 0.5 * tanh({_beyond(x, y)} / s))", along),
        "stripe": (f"exp(-({_beyond(x, y)} / s) ** 2)", along),
    }
    for kind, (text, own) in functions.items():
        terms = _each(actions, "ab"[: len(actions)], text)
        whole = len(actions) > 1
        yield Family(f"{kind} in the plane", name, place, terms, (*own, *actions[0].shape), whole=whole)


def _coverings(
    action: Action, place: tuple[str, str], middles: Sequence[ShapeParameter], size: float
) -> Iterator[Family]:
    """What covers a part of the floor, with an edge: an oval, as a puddle, or a rectangle with round corners, as a mat.
    Its middle is (x0, y0), its half axes are d in the direction q and h across, its edge is s times as wide."""
    x, y = place
    along = f"((({x} - x0) * cos(q) + ({y} - y0) * sin(q)) / d)"
    across = f"((({y} - y0) * cos(q) - ({x} - x0) * sin(q)) / h)"
    halves = tuple(
        ShapeParameter(letter, {"m": 1}, tuple(size * part for part in starts), 0.01 * size, 2 * size)
        for letter, starts in (("d", (0.1, 0.25)), ("h", (0.1,)))
    )
    q = ShapeParameter("q", {"rad": 1}, (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4))
    s = ShapeParameter("s", {}, (0.3,), 0.02, 2.0)
    shape = (*middles, q, *halves, s, *action.shape)
    for name, power in (("oval", 2), ("mat", 8)):
        covered = f"(0.5 + 0.5 * tanh((1 - ({along} ** {power} + {across} ** {power} + 1e-12) ** {1 / power}) / s))"
        yield Family(name, action.name, place, (term_of(action, "a", covered, {}),), shape)


def _waves(
    actions: Sequence[Action], name: str, place: tuple[str, str], q: ShapeParameter, size: float
) -> Iterator[Family]:
    """What repeats along a direction of the floor, half a wave to ten over `size` [m]."""
    x, y = place
    numbers = tuple(np.pi / size * np.arange(1.0, 21.0))
    k = ShapeParameter("k", {"m": -1}, numbers, 0.3 * numbers[0], 1.2 * numbers[-1])
    phase = f"(k * ({x} * cos(q) + {y} * sin(q)))"
    n = len(actions)
    terms = (*_each(actions, "ab"[:n], f"sin{phase}"), *_each(actions, "cf"[:n], f"cos{phase}"))
    yield Family("wave in the plane", name, place, terms, (q, k))


def _taut(away: str) -> str:
    """By how much a line of the length `away` is longer than d, over its length; the corner is round over s."""
    return f"({away} - d + sqrt(({away} - d) ** 2 + s ** 2)) / {away}"


def _pulled(angle: str, strength: Callable[[str], str]) -> tuple[tuple[str, str], ...]:
    """A pull on the point p ahead of the centre of the body to the point (x0, y0), which is the way there times the
    `strength`, a function of the square of its length."""
    x, y = f"(x + p * cos({angle}) - x0)", f"(y + p * sin({angle}) - y0)"
    turn = f"p * ({x} * sin({angle}) - {y} * cos({angle}))"
    times = strength(f"{x} ** 2 + {y} ** 2")
    return tuple((side, f"{part} * {times}") for side, part in (("east", f"-{x}"), ("north", f"-{y}"), ("N", turn)))


def _tied(
    angle: str, middles: Sequence[ShapeParameter], slack: ShapeParameter, corner: ShapeParameter, size: float
) -> Family:
    """A tether from the point (x0, y0), h above or below, to the point p ahead of the centre of the body."""
    metre: Unit = {"m": 1}
    p = ShapeParameter("p", metre, (0.0,), -size, size)
    h = ShapeParameter("h", metre, (0.25 * size,), 0.0, 5 * size)
    pull = _pulled(angle, lambda square: _taut(f"sqrt({square} + h ** 2)"))
    term = Term("k", {"N": 1, "m": -1}, pull)
    return Family("tether at a point", "world", ("x", "y"), (term,), (*middles, slack, corner, p, h))


def _magnet(angle: str, middles: Sequence[ShapeParameter], s: ShapeParameter, size: float) -> Family:
    """The pull of a magnet, s below the point (x0, y0) of the floor, on one at the point p ahead of the centre of the
    body; both point up."""
    p = ShapeParameter("p", {"m": 1}, (-0.1 * size, 0.1 * size), -size, size)
    pull = _pulled(angle, lambda square: f"1 / (1 + ({square}) / s ** 2) ** 2.5")
    term = Term("k", {"N": 1, "m": -1}, pull)
    return Family("magnet", "world", ("x", "y"), (term,), (*middles, s, p))
