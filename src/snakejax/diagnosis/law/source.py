"""A law as a Python file: an effect of the user's own that acts in the same way."""

import ast
from collections.abc import Sequence

from snakejax.core.formula import FUNCTIONS, SMOOTH_FUNCTIONS, names_in
from snakejax.core.parameter import own_parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.law import (
    PLACE_OF_WHEEL,
    VARIABLES,
    WHEEL_VARIABLES,
    FloorLaw,
    GripLaw,
    LateralLaw,
    Law,
    ResistanceLaw,
)

_SPEED = "jnp.sqrt(motion.u**2 + motion.w**2 + 1e-12)"
_OF_WHEEL = "sj.dynamics.wheel_variables(motion.board, wheel.wheelset, wheel, motion)"
_AT_WHEEL = "lateral(self, force, wheel, motion)"
_WRITTEN: dict[type[Law], tuple[str, str, str]] = {
    FloorLaw: ("wrench(self, motion)", "Force", "sj.dynamics.weight_on_floor(height, motion)"),
    GripLaw: (_AT_WHEEL, "LateralForce", "force * grip"),
    LateralLaw: (_AT_WHEEL, "LateralForce", "force + lateral"),
    ResistanceLaw: ("resistance(self, wheel, motion)", "RollingForce", "jnp.zeros_like(wheel.rolling) + resistance"),
}
"""The method, the port and what is returned, by the kind of law; a force on the body returns what it sets."""


def law_source(law: Law, beside: Sequence[str] = ()) -> str:
    """A Python file with the effect `MissingForce`, which is `law`; `beside`: the other effects of its model.

    Its defaults are the values found, so that a fit goes on from there.
    """
    fields = [(name, value, domain) for name, (value, domain) in own_parameters(law)]
    names = dict.fromkeys(name for tree in law.formulas.values() for name in names_in(tree))
    known = {name for name, _, _ in fields}
    own = known | set(PLACE_OF_WHEEL if isinstance(law, FloorLaw) else ())
    lines = [f"{name} = {_variable(name)}" for name in names if name not in own]
    for component, tree in law.formulas.items():
        code = _code(tree, known)
        of_place = [f"def height({', '.join(PLACE_OF_WHEEL)}):", f"    return {code}"]
        lines += of_place if component == "height" else [f"{component} = {code}"]
    kind = next((kind for kind in _WRITTEN if isinstance(law, kind)), None)
    method, port, returned = ("wrench(self, motion)", "Force", "") if kind is None else _WRITTEN[kind]
    lines += [f"return {returned}"] if returned else _returned(law)
    declared = "\n".join(
        f'    {name}: sj.Scalar = sj.param("{domain.unit}", default={float(value)!r})' for name, value, domain in fields
    )
    body = "\n".join(f"        {line}" for line in lines)
    effects = "".join(f" --with {name}" for name in beside if name != LATERAL_SLIP_SWITCH)
    skid = " --skid free" if LATERAL_SLIP_SWITCH in beside else ""
    return f'''"""The law that `snakejax explain` found: {law.expression}

Fit it:  snakejax fit CASE{skid}{effects} --with THIS_FILE.py:MissingForce
"""

import jax.numpy as jnp
import snakejax as sj


class MissingForce(sj.{port}):
    description = "{law.description}"
{declared}

    def {method}:
{body}
'''


def _variable(name: str) -> str:
    if name == "speed":
        return _SPEED
    if name in WHEEL_VARIABLES:
        return f"{_OF_WHEEL}[{name!r}]"
    if name in VARIABLES:
        return f"motion.{name}"
    of_joints = "accelerations" if name.endswith("_acceleration") else "variables"
    return f"motion.board.{of_joints}(motion.inputs)[{name!r}]"


def _returned(law: Law) -> list[str]:
    """The lines that turn the components into a wrench."""
    set_, lines = set(law.formulas), []
    zero = "jnp.zeros_like(motion.u)"
    if set_ & {"east", "north"}:
        sides = (name if name in set_ else zero for name in ("east", "north"))
        lines.append(f"along, across = motion.into_body({', '.join(sides)})")
        sums = [" + ".join((own, name)) if name in set_ else own for own, name in (("along", "X"), ("across", "Y"))]
    else:
        sums = [f"{zero} + {name}" if name in set_ else zero for name in ("X", "Y")]
    return [*lines, f"return {', '.join(sums)}, {f'{zero} + N' if 'N' in set_ else zero}"]


def _code(tree: ast.expr, parameters: set[str]) -> str:
    """A formula as code: parameters are those of the effect, functions those of JAX and of the package."""

    class Renamed(ast.NodeTransformer):
        def visit_Name(self, node: ast.Name) -> ast.expr:
            owners = {**dict.fromkeys(FUNCTIONS, "jnp"), **dict.fromkeys(SMOOTH_FUNCTIONS, "sj.core")}
            owner = "self" if node.id in parameters else owners.get(node.id)
            return node if owner is None else ast.Attribute(ast.Name(owner, ast.Load()), node.id, ast.Load())

        def visit_Call(self, node: ast.Call) -> ast.expr:
            smooth = isinstance(node.func, ast.Name) and node.func.id in SMOOTH_FUNCTIONS
            own = [ast.keyword("library", ast.Name("jnp", ast.Load()))] if smooth else []
            return ast.Call(self.visit(node.func), [self.visit(part) for part in node.args], own)

    return ast.unparse(ast.fix_missing_locations(Renamed().visit(ast.parse(ast.unparse(tree), mode="eval")).body))
