"""Forms of law of the place: what lies on the floor or covers it, lines on it, and how high it is."""

from collections.abc import Iterator, Sequence

import numpy as np

from snakejax.dynamics.law import PLACE_OF_WHEEL

from .plane_shapes import METRE, PlaneShapes
from .terms import (
    ACTIONS,
    EAST,
    HEIGHT,
    NORTH,
    OF_WHEEL,
    PLACE,
    Action,
    Family,
    Range,
    ShapeParameter,
    Term,
    may_act,
    term_of,
)
from .units import Unit


def in_the_plane(ranges: dict[str, Range], shapes: PlaneShapes) -> Iterator[Family]:
    """Laws of the place of the body or, where that is in `ranges`, of a wheel."""
    at_wheels = [action for action in ACTIONS if action.name in OF_WHEEL and "wheel_x" in ranges]
    for action in at_wheels:
        yield from _coverings(action, PLACE_OF_WHEEL, shapes)
        yield _tiles(action, PLACE_OF_WHEEL, shapes)
    for action in ACTIONS:
        if action.name in ("friction", "drag"):
            yield from _coverings(action, PLACE, shapes)
    of_body = [(action, PLACE) for action in ACTIONS if may_act(action, PLACE[0], ())]
    for action, (x, y) in [*of_body, *((one, PLACE_OF_WHEEL) for one in at_wheels)]:
        plane = tuple(term_of(action, a, v, METRE) for a, v in (("a", x), ("b", y)))
        yield Family("plane", action.name, (x, y), plane, action.shape)
        # On which side of a line something is, the direction says: it turns once around. A grip or a height may fall as
        # well as rise there, as their constant part is free.
        direction = shapes.direction if action.name == "grip" else shapes.around
        yield from _spots((action,), action.name, (x, y), shapes, direction)
    yield from _in_the_world(shapes)
    if "wheel_x" in ranges:
        yield from _spots((HEIGHT,), "height", PLACE_OF_WHEEL, shapes, shapes.direction)
        yield from _waves((HEIGHT,), "height", PLACE_OF_WHEEL, shapes)


def _in_the_world(shapes: PlaneShapes) -> Iterator[Family]:
    """A force along the axes of the world."""
    sides, place = (EAST, NORTH), PLACE
    constant = (term_of(EAST, "a", "", {}), term_of(NORTH, "b", "", {}))
    planes = [
        term_of(side, letter, v, METRE)
        for side, letters in ((EAST, "cd"), (NORTH, "fg"))
        for letter, v in zip(letters, "xy", strict=True)
    ]
    yield Family("plane", "world", place, (*constant, *planes))
    yield from _spots(sides, "world", place, shapes, shapes.around)
    yield from _waves(sides, "world", place, shapes)
    beyond = _beyond("x", "y")
    trough = _each(sides, "ab", f"tanh({beyond} / s)")
    yield Family("trough", "world", place, trough, (shapes.direction, shapes.distance, shapes.width), whole=True)
    fence = _each(sides, "ab", f"({beyond} + sqrt({beyond} ** 2 + s ** 2))", METRE)
    yield Family("fence", "world", place, fence, (shapes.around, shapes.distance, shapes.corner), whole=True)


def _beyond(x: str, y: str) -> str:
    """How far a place is beyond a line, which is d from the origin in the direction q."""
    return f"({x} * cos(q) + {y} * sin(q) - d)"


def _each(actions: Sequence[Action], letters: str, text: str, unit: Unit | None = None) -> tuple[Term, ...]:
    """A term for each of the `actions` with the same function of the place, which has a `unit` or is a pure number."""
    return tuple(term_of(action, letter, text, unit or {}) for action, letter in zip(actions, letters, strict=True))


def _spots(
    actions: Sequence[Action], name: str, place: tuple[str, str], shapes: PlaneShapes, direction: ShapeParameter
) -> Iterator[Family]:
    """What is there around a point, on one side of a line, or along a line."""
    x, y = place
    around, along = (*shapes.point, shapes.width), (direction, shapes.distance, shapes.width)
    functions = {
        "bump": (f"exp(-(({x} - x0) ** 2 + ({y} - y0) ** 2) / s ** 2)", around),
        "threshold": (f"(0.5 + 0.5 * tanh({_beyond(x, y)} / s))", along),
        "stripe": (f"exp(-({_beyond(x, y)} / s) ** 2)", along),
    }
    for kind, (text, own) in functions.items():
        terms = _each(actions, "ab"[: len(actions)], text)
        of_action = actions[0].shape
        begins = tuple(part.starts[0] for part in of_action)
        also = tuple((*spot, *begins) for spot in shapes.small_spots) if kind == "bump" else ()
        whole = len(actions) > 1
        yield Family(f"{kind} in the plane", name, place, terms, (*own, *of_action), whole=whole, also=also)


def _coverings(action: Action, place: tuple[str, str], shapes: PlaneShapes) -> Iterator[Family]:
    """What covers a part of the floor, with an edge: an oval, as a puddle, or a rectangle with round corners, as a mat.
    Its middle is (x0, y0), its half axes are d in the direction q and h across, its edge is s times as wide."""
    x, y = place
    along = f"((({x} - x0) * cos(q) + ({y} - y0) * sin(q)) / d)"
    across = f"((({y} - y0) * cos(q) - ({x} - x0) * sin(q)) / h)"
    halves = tuple(
        ShapeParameter(
            letter, {"m": 1}, tuple(shapes.size * part for part in starts), 0.01 * shapes.size, 2 * shapes.size
        )
        for letter, starts in (("d", (0.1, 0.25)), ("h", (0.1,)))
    )
    q = ShapeParameter("q", {"rad": 1}, (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4))
    s = ShapeParameter("s", {}, (0.3,), 0.02, 2.0)
    shape = (*shapes.point, q, *halves, s, *action.shape)
    for name, power in (("oval", 2), ("mat", 8)):
        covered = f"(0.5 + 0.5 * tanh((1 - ({along} ** {power} + {across} ** {power} + 1e-12) ** {1 / power}) / s))"
        yield Family(name, action.name, place, (term_of(action, "a", covered, {}),), shape)


def _tiles(action: Action, place: tuple[str, str], shapes: PlaneShapes) -> Family:
    """Tiles of two kinds, in turns along both axes of the cameras: k is the wave number, p and q the phases along x and
    y, and from tile to tile the change takes s of the size of a wave."""
    x, y = place
    numbers = tuple(np.pi / shapes.size * np.arange(1.0, 16.0))
    k = ShapeParameter("k", {"m": -1}, numbers, 0.3 * numbers[0], 1.3 * numbers[-1])
    phases = tuple(ShapeParameter(letter, {"rad": 1}, tuple(np.pi * np.arange(4) / 4)) for letter in "pq")
    s = ShapeParameter("s", {}, (0.5,), 0.05, 5.0)
    board = f"tanh(sin(k * {x} + p) * sin(k * {y} + q) / s)"
    return Family("tiles", action.name, place, (term_of(action, "a", board, {}),), (k, *phases, s, *action.shape))


def _waves(actions: Sequence[Action], name: str, place: tuple[str, str], shapes: PlaneShapes) -> Iterator[Family]:
    """What repeats along a direction of the floor, half a wave to ten over its size."""
    x, y = place
    numbers = tuple(np.pi / shapes.size * np.arange(1.0, 21.0))
    k = ShapeParameter("k", {"m": -1}, numbers, 0.3 * numbers[0], 1.2 * numbers[-1])
    phase = f"(k * ({x} * cos(q) + {y} * sin(q)))"
    n = len(actions)
    terms = (*_each(actions, "ab"[:n], f"sin{phase}"), *_each(actions, "cf"[:n], f"cos{phase}"))
    yield Family("wave in the plane", name, place, terms, (shapes.direction, k))
