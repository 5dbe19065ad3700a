"""Forms of law of a point of the floor: springs, lines and magnets that pull there, hills and whirls around it."""

from collections.abc import Callable, Iterator

from .plane_shapes import METRE, PlaneShapes
from .terms import DRY_FRICTION, EAST, NORTH, PLACE, Family, ShapeParameter, Term, term_of
from .units import Unit

PER_METRE: Unit = {"N": 1, "m": -1}
"""The unit of a stiffness."""


def of_a_point(shapes: PlaneShapes, angle: str) -> Iterator[Family]:
    """Those of a vehicle with the heading `angle`."""
    pull = Term("k", PER_METRE, (("east", "-x"), ("north", "-y")))
    constant = (term_of(EAST, "a", "", {}), term_of(NORTH, "b", "", {}))
    # Without a constant, its point would be on an axis of the world, which lies where the cameras have it.
    yield Family("spring", "world", PLACE, (pull, *constant), whole=True)
    bump = "exp(-((x - x0) ** 2 + (y - y0) ** 2) / s ** 2)"
    slope = (("east", f"(x - x0) * {bump}"), ("north", f"(y - y0) * {bump}"))
    spot, small = (*shapes.point, shapes.width), shapes.small_spots
    yield Family("hill", "world", PLACE, (Term("a", PER_METRE, slope),), spot, also=small)
    # The vortex of Kaufmann (1962): a solid whirl inside of s, and a velocity that falls with the distance beyond.
    core = " / ((x - x0) ** 2 + (y - y0) ** 2 + s ** 2)"
    whirl = (("east", f"-(y - y0){core}"), ("north", f"(x - x0){core}"))
    yield Family("whirl", "world", PLACE, (Term("a", {"N": 1, "m": 1}, whirl),), spot, also=small)
    # Without a slack length it is a spring, and without a corner nobody can follow its slope.
    taut = _taut("sqrt((x - x0) ** 2 + (y - y0) ** 2 + s ** 2)")
    slack = ShapeParameter("d", METRE, tuple(shapes.size * part for part in (0.2, 0.5, 0.8)), 0.0, 5 * shapes.size)
    pull = (("east", f"-(x - x0) * {taut}"), ("north", f"-(y - y0) * {taut}"))
    yield Family("tether", "world", PLACE, (Term("k", PER_METRE, pull),), (*shapes.point, slack, shapes.corner))
    yield _tied(angle, shapes, slack)
    yield _magnet(angle, shapes)
    distance = tuple((side, f"{against} * sqrt((x - x0) ** 2 + (y - y0) ** 2)") for side, against in DRY_FRICTION)
    yield Family("cable", "friction", PLACE, (Term("a", PER_METRE, distance),), shapes.point)


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


def _tied(angle: str, shapes: PlaneShapes, slack: ShapeParameter) -> Family:
    """A tether from the point (x0, y0), h above or below, to the point p ahead of the centre of the body."""
    p = ShapeParameter("p", METRE, (0.0,), -shapes.size, shapes.size)
    h = ShapeParameter("h", METRE, (0.25 * shapes.size,), 0.0, 5 * shapes.size)
    pull = _pulled(angle, lambda square: _taut(f"sqrt({square} + h ** 2)"))
    shape = (*shapes.point, slack, shapes.corner, p, h)
    return Family("tether at a point", "world", PLACE, (Term("k", PER_METRE, pull),), shape)


def _magnet(angle: str, shapes: PlaneShapes) -> Family:
    """The pull of a magnet, s below the point (x0, y0) of the floor, on one at the point p ahead of the centre of the
    body; both point up."""
    size = shapes.size
    p = ShapeParameter("p", METRE, (-0.1 * size, 0.1 * size), -size, size)
    deep = shapes.width._replace(starts=(0.1 * size, 0.25 * size))
    pull = _pulled(angle, lambda square: f"1 / (1 + ({square}) / s ** 2) ** 2.5")
    return Family("magnet", "world", PLACE, (Term("k", PER_METRE, pull),), (*shapes.point, deep, p))
