"""Laws: effects that a formula defines, as a search finds them in recordings."""

import ast
import functools
import types
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.formula import SMOOTH_FUNCTIONS, evaluated, names_in, parsed
from snakejax.core.parameter import Scalar, own_parameters, param

from .contact import Motion, Wheel, Wrench, slip_angle
from .floor import place_on_floor, placement_of, weight_on_floor, wrench_of_wheel
from .ports import Effect, Force, LateralForce, RollingForce
from .signals import Joint
from .vehicle import AbstractVehicle, Wheelset

if TYPE_CHECKING:
    from .model import Model

COMPONENTS = ("X", "Y", "N", "east", "north", "grip", "lateral", "resistance", "height")
"""What a law may set: force along and across the body [N], yaw moment [N m], force along the axes of the world [N], the
factor on the lateral force of each wheel [-], a force on each wheel, beside that of its tyre, against its lateral slip
or against its rolling forward [N], or the height of the floor under each wheel [m]."""
OF_EACH_WHEEL = ("grip", "lateral", "resistance", "height")
"""The components that each wheel has for itself: they may depend on `WHEEL_VARIABLES`, and are set alone."""
PLACE_OF_WHEEL = ("wheel_x", "wheel_y")
"""The variables of a wheel that say where it stands; the height of a floor depends on no others."""


VARIABLES = ("time", "x", "y", "heading", "theta", "u", "w", "r", "speed")
"""The variables of any vehicle, see `Motion`; `speed` is that of the body. Those of its joints come beside."""
WHEEL_VARIABLES = ("slip_speed", "slip_angle", "rolling_speed", "wheel_x", "wheel_y", "turn_rate", "axle")
"""The variables of one wheel, on which what acts at it may depend, see `wheel_variables`."""


class LawParameter(NamedTuple):
    """A parameter of a law: its `unit`, its `default`, and the least and the largest value that it may have."""

    name: str
    unit: str
    default: float = 0.0
    low: float = -float("inf")
    high: float = float("inf")


class Law(Effect):
    """An effect given by formulas: `expression` is as in `east = -k * x; north = -k * y`."""

    expression: ClassVar[str] = ""
    formulas: ClassVar[dict[str, ast.expr]] = {}

    def values(self) -> dict[str, Any]:
        """The values of the parameters by name."""
        return {name: value for name, (value, _) in own_parameters(self)}

    def inapplicable_because(self, model: "Model") -> str | None:
        joints = {given.name: Joint(*(np.zeros(()),) * 3) for given in model.board.inputs}
        known = {*VARIABLES, *model.board.variables(joints), *model.board.accelerations(joints), *self.values()}
        known |= set(WHEEL_VARIABLES if set(self.formulas) & set(OF_EACH_WHEEL) else ())
        for tree in self.formulas.values():
            for name in names_in(tree):
                if name not in known:
                    return f"a {model.board.noun} has no variable `{name}`."
        return None

    def force_on_body(self, motion: Motion) -> Wrench | None:
        """What a law that adds forces does to the body; None for a law that changes the forces that are there."""
        return self.wrench(motion) if isinstance(self, Force) else None


class ForceLaw(Law, Force):
    """A force on the body, along the axes of the body or of the world, and a yaw moment."""

    def wrench(self, motion: Motion) -> Wrench:
        known = variables_of(motion) | self.values()
        zero = jnp.zeros_like(motion.u)
        part = {name: zero + evaluated(tree, known, jnp) for name, tree in self.formulas.items()}
        X, Y = motion.into_body(part.get("east", zero), part.get("north", zero))
        return X + part.get("X", zero), Y + part.get("Y", zero), part.get("N", zero)


class GripLaw(Law, LateralForce):
    """A factor on the lateral force of each wheel."""

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        return force * _of_wheel(self, "grip", wheel, motion)


class LateralLaw(Law, LateralForce):
    """A force on each wheel against its lateral slip, beside that of its tyre."""

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        return force + _of_wheel(self, "lateral", wheel, motion)

    def force_on_body(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.u)
        return _sum_over_wheels(motion, lambda wheel: (zero, -self.lateral(zero, wheel, motion)))


class ResistanceLaw(Law, RollingForce):
    """A force on each wheel against its rolling forward."""

    def resistance(self, wheel: Wheel, motion: Motion) -> Scalar:
        return _of_wheel(self, "resistance", wheel, motion) + jnp.zeros_like(wheel.rolling)

    def force_on_body(self, motion: Motion) -> Wrench:
        zero = jnp.zeros_like(motion.u)
        return _sum_over_wheels(motion, lambda wheel: (-self.resistance(wheel, motion), zero))


class FloorLaw(Law, Force):
    """The height of the floor: the weight pushes each wheel down the slope on which it stands."""

    def wrench(self, motion: Motion) -> Wrench:
        def height(x: Scalar, y: Scalar) -> Scalar:
            known = self.values() | dict(zip(PLACE_OF_WHEEL, (x, y), strict=True))
            return evaluated(self.formulas["height"], known, jnp) + jnp.zeros_like(x)

        return weight_on_floor(height, motion)


def _sum_over_wheels(motion: Motion, force: Callable[[Wheel], tuple[Scalar, Scalar]]) -> Wrench:
    """The wrench on the body of a `force` along and across each wheel [N]."""
    board = motion.board
    each = [
        wrench_of_wheel(placement_of(board, wheel.wheelset, motion), wheel.joint.angle, *force(wheel))
        for wheel in motion.wheels
    ]
    X, Y, N = (sum(parts, jnp.zeros_like(motion.u)) for parts in zip(*each, strict=True))
    return X, Y, N


def _of_wheel(law: Law, component: str, wheel: Wheel, motion: Motion) -> Scalar:
    """The value of a component of `law` for one wheel."""
    of_wheel = wheel_variables(motion.board, wheel.wheelset, wheel, motion)
    return evaluated(law.formulas[component], variables_of(motion) | of_wheel | law.values(), jnp)


def variables_of(motion: Motion) -> dict[str, Scalar]:
    """What a force may depend on: the motion of the vehicle, and its joints."""
    own = {name: getattr(motion, name) for name in VARIABLES if name != "speed"}
    # The small constant keeps the derivative of the speed finite at rest.
    own["speed"] = jnp.sqrt(motion.u**2 + motion.w**2 + 1e-12)
    return own | motion.board.variables(motion.inputs) | motion.board.accelerations(motion.inputs)


def wheel_variables(board: AbstractVehicle, wheelset: Wheelset, wheel: Wheel, motion: Motion) -> dict[str, Scalar]:
    """What acts at a `wheel` of `board` may depend on these beside.

    Its lateral slip speed [m/s], slip angle [rad] and rolling speed [m/s]; where it stands on the floor, `wheel_x` and
    `wheel_y` [m]; the rate [rad/s] at which it turns on the floor, r plus that of its steering; and `axle`, 1 ahead of
    the middle, -1 behind it.
    """
    values = (
        wheel.lateral,
        slip_angle(wheel.lateral, wheel.rolling, board.creep_speed),
        wheel.rolling,
        *place_on_floor(placement_of(board, wheelset, motion), motion),
        motion.r + wheel.joint.rate,
        jnp.zeros_like(motion.r) + np.sign(wheelset.place),
    )
    return dict(zip(WHEEL_VARIABLES, values, strict=True))


def formulas_of(expression: str) -> dict[str, ast.expr]:
    """The formulas of an expression such as `east = -k * x; north = -k * y`, by component.

    **Raises:** `InputError` where it is none, sets a component twice, or mixes that of each wheel with another.
    """
    formulas: dict[str, ast.expr] = {}
    for part in expression.split(";"):
        name, equals, formula = part.partition("=")
        name = name.strip()
        if not equals or name not in COMPONENTS or name in formulas:
            what = f"`{part.strip()}` sets no component of a law, or sets one again"
            raise InputError(what, "expression", f"write `COMPONENT = formula`, of {', '.join(COMPONENTS)}")
        formulas[name] = parsed(formula)
    alone = set(formulas) & set(OF_EACH_WHEEL)
    if alone and len(formulas) > 1:
        what = f"A law that sets the {min(alone)} of each wheel cannot set anything else"
        raise InputError(what, "expression", "write two laws")
    return formulas


@functools.cache
def law_class(expression: str, given: tuple[LawParameter, ...], description: str = "") -> type[Law]:
    """The class of effects of one law, with the parameters `given`; their defaults leave the model unchanged where
    they make the formulas zero, or the grip 1.

    **Raises:** `InputError` for an expression that is none, a parameter that it does not name, or a height that depends
    on anything but the place of a wheel.
    """
    formulas = formulas_of(expression)
    named = {name for tree in formulas.values() for name in names_in(tree)}
    for one in given:
        if one.name not in named:
            raise InputError(f"`{expression}` has no parameter `{one.name}`", "expression", "leave it out")
    if "height" in formulas and (others := named - {one.name for one in given} - set(PLACE_OF_WHEEL)):
        what = f"The height of the floor cannot depend on `{min(others)}`"
        raise InputError(what, "expression", f"write it as a formula of {' and '.join(PLACE_OF_WHEEL)}")
    kinds: dict[str, type] = {"grip": GripLaw, "lateral": LateralLaw, "resistance": ResistanceLaw, "height": FloorLaw}
    bases = tuple(kinds[component] for component in formulas if component in kinds) or (ForceLaw,)
    fields: dict[str, Any] = {p.name: param(p.unit, low=p.low, high=p.high, default=p.default) for p in given}
    own = {
        "__annotations__": {p.name: Scalar for p in given},
        "__module__": __name__,
        "expression": expression,
        "formulas": formulas,
        "description": description or _description(expression),
        **fields,
    }
    return types.new_class("Law", bases, exec_body=lambda namespace: namespace.update(own))


def _description(expression: str) -> str:
    """What a law found in recordings is."""
    if any(f"{name}(" in expression for name in SMOOTH_FUNCTIONS):
        return (
            f"A smooth function found in the recordings: {expression}. Its parameters are its values at evenly spaced"
            " places between the two numbers after each variable."
        )
    return f"A law found in the recordings: {expression}."


def law(expression: str, units: Mapping[str, str], values: Mapping[str, float]) -> Law:
    """The law `expression` with parameters of `units` at `values`, as a result writes it.

    **Raises:** `InputError` for an expression that is none, or a parameter without a value.
    """
    if lacking := [name for name in units if name not in values]:
        raise InputError(f"`{lacking[0]}` of the law has no value", "expression", "give it one")
    given = tuple(LawParameter(name, unit) for name, unit in units.items())
    return law_class(expression, given)(**{name: values[name] for name in units})
