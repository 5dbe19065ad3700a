"""Forms of dry friction and drag of the body that no function of one variable says."""

from collections.abc import Iterator, Sequence

import numpy as np

from snakejax.dynamics.contact import STICKING_SPEED

from .terms import DAMPING, DRY_FRICTION, NEWTON, Family, Range, ShapeParameter, Term
from .units import Unit


def friction_forms(ranges: dict[str, Range], wheel: Sequence[str]) -> Iterator[Family]:
    """Those of the variables in `ranges`, of which `wheel` belong to a wheel: none without the speed of the body."""
    if {"u", "speed"} <= set(ranges):
        fastest = ranges["speed"].largest
        yield from _stribeck(fastest)
        yield _wind("theta" if "theta" in ranges else "heading", fastest)
        yield _friction_across("theta" if "theta" in ranges else "heading", fastest)
        if "r" in ranges:
            yield from _at_a_point(fastest, fastest / ranges["r"].largest)
            yield from _wheel_at_a_point(fastest, fastest / ranges["r"].largest)
            for name in (name for name in ranges if name.endswith("_angle") and name not in wheel):
                yield from _at_an_arm(name.removesuffix("_angle"), fastest, fastest / ranges["r"].largest)


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


def _at_an_arm(joint: str, fastest: float, size: float) -> Iterator[Family]:
    """Dry friction or drag of the end of an arm that a `joint` at the centre of the body turns: p long, and q beyond
    the angle of the joint. `size` and s as in `_at_a_point`."""
    s = ShapeParameter("s", {"m": 1, "s": -1}, (0.02 * fastest, 0.1 * fastest), 0.003 * fastest, fastest)
    p = ShapeParameter("p", {"m": 1}, (0.3 * size, size, 2 * size), 0.0, 10 * size)
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 4))
    ahead, left = f"(p * cos({joint}_angle + q))", f"(p * sin({joint}_angle + q))"
    along, across = f"(u - {left} * (r + {joint}_rate))", f"(w + {ahead} * (r + {joint}_rate))"
    turn = f"({ahead} * {across} - {left} * {along})"
    length = f" / sqrt({along} ** 2 + {across} ** 2 + s ** 2)"
    variables = (f"{joint}_rate", f"{joint}_angle", "u", "w", "r")
    for name, over, unit, own in (("friction", length, NEWTON, (p, q, s)), ("drag", "", DAMPING, (p, q))):
        formulas = tuple((side, f"-{v}{over}") for side, v in (("X", along), ("Y", across), ("N", turn)))
        yield Family(f"{name} at an arm", name, variables, (Term("a", unit, formulas),), own)


def _wheel_at_a_point(fastest: float, size: float) -> Iterator[Family]:
    """Dry friction or drag of a wheel or a runner p ahead of the centre, which does not steer: only against motion
    across the body. `size` [m] as in `_at_a_point`; dry friction begins over the speed s."""
    s = ShapeParameter("s", {"m": 1, "s": -1}, (0.02 * fastest, 0.1 * fastest), 0.003 * fastest, fastest)
    starts = tuple(size * part for part in (-2, -1, -0.4, 0, 0.4, 1, 2))
    p = ShapeParameter("p", {"m": 1}, starts, -10 * size, 10 * size)
    for name, across, unit, own in (
        ("friction", "tanh((w + p * r) / s)", NEWTON, (p, s)),
        ("drag", "(w + p * r)", DAMPING, (p,)),
    ):
        formulas = (("Y", f"-{across}"), ("N", f"-p * {across}"))
        yield Family(f"{name} across at a point", name, ("w", "r"), (Term("a", unit, formulas),), own)


def _wind(angle: str, fastest: float) -> Family:
    """The drag of air that moves with the speed v0 in the direction q of the world."""
    unit: Unit = {"m": 1, "s": -1}
    v0 = ShapeParameter("v0", unit, tuple(fastest * part for part in (0.5, 2, 8)), 0.0, 100 * fastest)
    q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 4))
    along, across = f"(u - v0 * cos(q - {angle}))", f"(w - v0 * sin(q - {angle}))"
    speed = f"sqrt({along} ** 2 + {across} ** 2 + {STICKING_SPEED**2})"
    formulas = (("X", f"-{speed} * {along}"), ("Y", f"-{speed} * {across}"))
    term = Term("a", {"N": 1, "s": 2, "m": -2}, formulas)
    return Family("wind", "drag", ("speed", angle), (term,), (v0, q))


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
