"""A template of an effect: a Python file with the estimated missing force, for the user to edit."""

from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH

from .dependence import PERIODIC, FittedFunction
from .missing_force import LatentForce

_SLIP_ANGLE = "sj.dynamics.slip_angle(wheel.lateral, wheel.rolling, motion.board.creep_speed)"
_VARIABLES = {
    "heading": "motion.heading",
    "speed": "jnp.hypot(motion.u, motion.w + 1e-9)",
    "slip_speed": "sum(wheel.lateral for wheel in motion.wheels) / len(motion.wheels)",
    "slip_angle": f"sum({_SLIP_ANGLE} for wheel in motion.wheels) / len(motion.wheels)",
    "steering_angle": "motion.steering.angle",
    "steering_rate": "motion.steering.rate",
    "rotor_angle": "motion.rotor.angle",
    "rotor_rate": "motion.rotor.rate",
    "time": "motion.time",
    # Of one sine: its frequency follows from angle and acceleration.
    "gait_phase": "jnp.arctan2(jnp.sign(s.angle) * jnp.sqrt(jnp.abs(s.angle * s.acceleration) + 1e-12), s.rate)",
}
_WHEEL_VARIABLES = {
    "slip_speed": "wheel.lateral",
    "slip_angle": _SLIP_ANGLE,
}
_UNITS = {"X": "N", "Y": "N", "N": "N m", "world": "N", "grip": "-", "drag": "N s/m", "yaw_drag": "N m s"}
_ACTS = {
    "X": "return {0}, jnp.zeros_like({0}), jnp.zeros_like({0})",
    "Y": "return jnp.zeros_like({0}), {0}, jnp.zeros_like({0})",
    "N": "return jnp.zeros_like({0}), jnp.zeros_like({0}), {0}",
    "drag": "return -({0}) * motion.u, -({0}) * motion.w, jnp.zeros_like(motion.u)",
    "yaw_drag": "return jnp.zeros_like(motion.r), jnp.zeros_like(motion.r), -({0}) * motion.r",
    "grip": "return force * (1 + {0})",
}


def effect_template(missing: LatentForce) -> str:
    """The text of a Python file with an effect that acts like the estimated missing force, for the user to edit.

    Its parameters are zero, and it then changes nothing; the values found stand in its docstring.

    **Raises:** `ValueError` where no variable was found on which the force depends.
    """
    shape = missing.shape
    if shape is None:
        raise ValueError("No variable was found on which the missing force depends, so there is nothing to start from.")
    terms, values = _form(shape)
    drop = shape.carrier == "grip"
    names = [name for name in terms if not (drop and not terms[name][0])]
    g = _sum(names, [terms[name][0] for name in names])
    if shape.carrier == "world":
        sides = {"east": [f"{n}x" for n in names], "north": [f"{n}y" for n in names]}
        coefficients = dict(zip([*sides["east"], *sides["north"]], values.T.ravel(), strict=True))
        lines = [f"{side} = {_sum(fields, [terms[n][0] for n in names])}" for side, fields in sides.items()]
        lines += ["X, Y = motion.into_body(east, north)", "return X, Y, jnp.zeros_like(X)"]
    else:
        coefficients = {name: value for name, value in zip(terms, values[:, 0], strict=True) if name in names}
        lines = [
            f"g = {g}" if len(g) < 100 else "g = " + g.replace(" + self.p2", "\n        g += self.p2"),
            _ACTS[shape.carrier].format("g"),
        ]
    by_wheel = _WHEEL_VARIABLES.get(shape.feature) if drop else None
    if shape.variable == "world_position":
        lines = ["x, y = motion.x, motion.y", *lines]
    else:
        joint = ["s = motion.steering"] if shape.feature == "gait_phase" else []
        of_vehicle = f"motion.board.variables(motion.inputs)[{shape.feature!r}]"
        lines = [*joint, f"v = {by_wheel or _VARIABLES.get(shape.feature, of_vehicle)}", *lines]
    method = "lateral(self, force, wheel, motion)" if drop else "wrench(self, motion)"
    unit = _UNITS[shape.carrier]
    known = "".join(f" --with {effect}" for effect in missing.beside if effect != LATERAL_SLIP_SWITCH)
    fields = [f'    {name}: sj.Scalar = sj.param("{_unit(unit, name, shape)}", default=0.0)' for name in coefficients]
    body = "\n".join(f"        {line}" for line in lines)
    values_found = ", ".join(f"{name}={value:.4g}" for name, value in coefficients.items())
    return f'''"""A missing action that depends on {shape.variable}, as `snakejax explain` found it. Edit it as needed.

Fit it:  snakejax fit CASE{" --skid free" if missing.switched else ""}{known} --with THIS_FILE.py:MissingForce
Found:   {values_found}
"""

import jax.numpy as jnp
import snakejax as sj


class MissingForce(sj.{"LateralForce" if drop else "Force"}):
    description = "{_SENTENCES[shape.carrier]} depends on {shape.variable}."
{chr(10).join(fields)}

    def {method}:
{body}
'''


_SENTENCES = {
    "X": "A force along the body",
    "Y": "A force across the body",
    "N": "A yaw moment",
    "world": "A force fixed in the world",
    "grip": "The lateral grip",
    "drag": "The drag of the body",
    "yaw_drag": "The damping of turning",
}


def _sum(names: Sequence[str], terms: Sequence[str]) -> str:
    return " + ".join(f"self.{n} * {t}" if t else f"self.{n}" for n, t in zip(names, terms, strict=True))


def _unit(unit: str, name: str, shape: FittedFunction) -> str:
    """The unit of one coefficient: over a metre for the slopes of a place, else that of the action."""
    if shape.variable != "world_position" or name.startswith("c"):
        return unit
    return "1/m" if unit == "-" else f"{unit}/m"


def _form(shape: FittedFunction) -> tuple[dict[str, tuple[str, np.ndarray]], np.ndarray]:
    """Terms by coefficient name, as code and as values at `shape.at`, and the coefficients (T, c) that fit best.

    Of a place c + a x + b y; of an angle two harmonics, or one for each component; of anything else
    c + p tanh(v/s) + q tanh((v/s)^2): a line, a parabola or a bend that levels off, as the scale s has it.
    """
    one = np.ones(len(shape.at))
    if shape.variable == "world_position":
        x, y = shape.at.T
        terms = {"c": ("", one), "a": ("x", x), "b": ("y", y)}
        return terms, _fitted(terms, shape.value)[0]
    if shape.variable in PERIODIC:
        terms = {"c": ("", one)}
        for k, turn in ((1, "v"), (2, "2 * v"))[: 2 if shape.value.shape[1] == 1 else 1]:
            angle = k * shape.at
            terms |= {f"p{k}": (f"jnp.cos({turn})", np.cos(angle)), f"q{k}": (f"jnp.sin({turn})", np.sin(angle))}
        return terms, _fitted(terms, shape.value)[0]
    best = None
    for s in np.abs(shape.at).max() * np.array([0.3, 0.45, 0.65, 1.0, 1.5, 3.0]):
        z = shape.at / float(f"{s:.2g}")
        odd, even = f"jnp.tanh(v / {s:.2g})", f"jnp.tanh((v / {s:.2g}) ** 2)"
        terms = {"c": ("", one), "p": (odd, np.tanh(z)), "q": (even, np.tanh(z**2))}
        coefficients, left = _fitted(terms, shape.value)
        if best is None or left < best[0]:
            best = (left, terms, coefficients)
    assert best is not None
    return best[1], best[2]


def _fitted(terms: Mapping[str, tuple[str, np.ndarray]], value: np.ndarray) -> tuple[np.ndarray, float]:
    """Least squares of `value` (m, c) on the terms, with a light ridge: coefficients and what is left."""
    A = np.stack([term for _, term in terms.values()], axis=1)
    normal = A.T @ A
    c = np.linalg.solve(normal + 1e-4 * np.diag(np.diag(normal)), A.T @ value)
    return c, float(((value - A @ c) ** 2).sum())
