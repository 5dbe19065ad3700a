"""The vocabulary of laws: what may act, terms with units, and forms that are sums of terms."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snakejax.dynamics.contact import STICKING_SPEED

from .units import Unit, power, product

NEWTON: Unit = {"N": 1}
NEWTON_METRE: Unit = {"N": 1, "m": 1}
DAMPING: Unit = {"N": 1, "s": 1, "m": -1}
YAW_DAMPING: Unit = {"N": 1, "m": 1, "s": 1}

DRY_FRICTION = tuple(
    (side, f"-{v} / sqrt(u ** 2 + w ** 2 + {STICKING_SPEED**2})") for side, v in (("X", "u"), ("Y", "w"))
)


class ShapeParameter(NamedTuple):
    """A parameter inside a function: `starts` of its search, its bounds and its unit."""

    name: str
    unit: Unit
    starts: tuple[float, ...]
    low: float = -np.inf
    high: float = np.inf


class Action(NamedTuple):
    """What a term acts on: the multiplier of the function for each component, and the unit of the product. `shape`: the
    parameters inside the multipliers."""

    name: str
    components: tuple[tuple[str, str], ...]
    unit: Unit
    shape: tuple[ShapeParameter, ...] = ()


_BEGINS = ShapeParameter("e", {"m": 1, "s": -1}, (2 * STICKING_SPEED,), 0.2 * STICKING_SPEED, 1.0)
"""The speed over which the dry friction of a wheel begins."""
_ROLLING = "rolling_speed / sqrt(rolling_speed ** 2 + e ** 2)"
ACTIONS = (
    Action("X", (("X", ""),), NEWTON),
    Action("Y", (("Y", ""),), NEWTON),
    Action("N", (("N", ""),), NEWTON_METRE),
    Action("drag", (("X", "-u"), ("Y", "-w")), DAMPING),
    Action("friction", DRY_FRICTION, NEWTON),
    Action("across", (("X", "-w"), ("Y", "u")), DAMPING),
    Action("yaw_drag", (("N", "-r"),), YAW_DAMPING),
    Action("grip", (("grip", "-"),), {}),
    Action("rolling", (("resistance", _ROLLING),), NEWTON, (_BEGINS,)),
)
OF_WHEEL = ("grip", "rolling")
"""Those actions that each wheel has for itself, which may depend on its own variables."""
OF_FACING = ("X", "Y")
"""Those actions that turn with the body."""
LOAD = Action("load", (("grip", "-axle"),), {})
"""Load goes from one axle to the other: the grip rises behind the middle by as much as it falls ahead of it."""
FRONT, BACK = (
    Action(f"{end} grip", (("grip", f"-0.5 * (1 {sign} axle)"),), {}) for end, sign in (("front", "+"), ("back", "-"))
)
"""The grip of the wheels ahead of the middle alone, and of those behind it."""
DRAGGING = tuple(
    Action(f"{end} rolling", (("resistance", f"0.5 * (1 {sign} axle) * {_ROLLING}"),), NEWTON, (_BEGINS,))
    for end, sign in (("front", "+"), ("back", "-"))
)
"""A dry friction of the wheels ahead of the middle alone, and of those behind it, against their rolling."""
SIDE = Action("side", (("lateral", ""),), NEWTON)
"""A force across each wheel, beside that of its tyre, as of a wheel that leans."""
OPPOSITE_SIDES = Action("opposite sides", (("lateral", "axle"),), NEWTON)
"""The same, to the other side behind the middle, as of wheels that lean as they steer."""
SLIDING = Action("sliding", (("lateral", "slip_speed / sqrt(slip_speed ** 2 + e ** 2)"),), NEWTON, (_BEGINS,))
"""A dry friction of each wheel against its lateral slip, beside the force of its tyre."""
HEIGHT = Action("height", (("height", ""),), {"m": 1})
"""The height of the floor under each wheel, which the weight pushes down the slope."""
PUSH_SUFFIX = "_acceleration"
"""A joint pushes the body by its acceleration: this times a function of its angle or rate is an action on N."""
EAST, NORTH = Action("east", (("east", ""),), NEWTON), Action("north", (("north", ""),), NEWTON)
BODY_ACTION = "body"
"""The name of the action of a force on the body together with a yaw moment."""
PLACE = ("x", "y")
"""The variables that are the place of the body."""
WORLD_VARIABLES = (*PLACE, "heading", "theta", "time")
"""The variables on which a force along the axes of the world may depend."""


def may_act(action: Action, variable: str, wheel: Sequence[str]) -> bool:
    """Whether an action may depend on a `variable`: on those of a `wheel` only what each wheel has for itself may, and
    that depends on the speed and not on u, as a wheel is alike in both directions. No place pushes along or across the
    body whichever way that faces: from runs that all face one way it cannot be told from a friction or from a force in
    the world, and leads others astray."""
    of_wheel = action.name in OF_WHEEL
    if variable in wheel:
        return of_wheel
    return not (of_wheel and variable == "u") and not (variable in PLACE and action.name in OF_FACING)


class Term(NamedTuple):
    """`amplitude` [unit] times a formula for each component."""

    amplitude: str
    unit: Unit
    formulas: tuple[tuple[str, str], ...]


class Family(NamedTuple):
    """A form of law: its `terms` are added; `shape` are the parameters inside them. `name` and `variables` tell it.

    `whole`: without one of its terms it is another form, or depends on where the axes of the cameras are. `together`:
    the formula of all terms for each component, where that is not their sum written out. `curvature` (T, T): the
    quadratic form of the amplitudes that says how curved the function is. `also`: values of the shape at which its
    search begins too.
    """

    name: str
    action: str
    variables: tuple[str, ...]
    terms: tuple[Term, ...]
    shape: tuple[ShapeParameter, ...] = ()
    whole: bool = False
    together: tuple[tuple[str, str], ...] = ()
    curvature: np.ndarray | None = None
    also: tuple[tuple[float, ...], ...] = ()

    @property
    def size(self) -> int:
        """How many parameters it has."""
        return len(self.terms) + len(self.shape)

    @property
    def starts(self) -> np.ndarray:
        """The values (G, S) of the shape at which its search begins: all combinations of those of its parameters, and
        `also`."""
        rows = [*itertools.product(*(part.starts for part in self.shape)), *self.also]
        return np.array(rows, float).reshape(len(rows), len(self.shape))

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


def acting(action: Action, formula: str) -> tuple[tuple[str, str], ...]:
    """For each component of an `action`, what this multiplies a `formula` by, times it."""
    texts = []
    for component, multiplier in action.components:
        bare = multiplier.removeprefix("-")
        joined = " * ".join(part for part in (bare, formula) if part)
        texts.append((component, "-" * multiplier.startswith("-") + joined))
    return tuple(texts)


def term_of(action: Action, amplitude: str, formula: str, unit: Unit) -> Term:
    """An amplitude so that it times `formula`, which has `unit`, acts."""
    return Term(amplitude, product(action.unit, power(unit, -1)), acting(action, formula))
