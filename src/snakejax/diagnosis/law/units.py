"""Units of products of powers, and their text."""

from collections import Counter
from collections.abc import Mapping

ORDER = ("N", "m", "s", "rad")

Unit = Mapping[str, int]
"""The power of each base unit."""

VARIABLE_UNITS: dict[str, Unit] = {
    "time": {"s": 1},
    **{name: {"m": 1} for name in ("x", "y", "wheel_x", "wheel_y")},
    **{name: {"rad": 1} for name in ("heading", "theta", "slip_angle")},
    **{name: {"m": 1, "s": -1} for name in ("u", "w", "speed", "slip_speed", "rolling_speed")},
    "r": {"rad": 1, "s": -1},
}
"""The units of the variables of a motion; those of joints follow from their names, see `unit_of`."""


def is_sum(variable: str) -> bool:
    """Whether a variable is a sum of others, `(rotor_rate + r)`."""
    return variable.startswith("(")


def is_direction(variable: str) -> bool:
    """Whether a variable is an angle in the world, with a whole turn of which a force repeats: that of the body, or of
    a joint, `(rotor_angle + theta)`."""
    return variable.strip("()").split(" + ")[-1] in ("heading", "theta")


def unit_of(variable: str) -> Unit:
    """The unit of a variable by its name: an angle, a rate, or one of `VARIABLE_UNITS`; else a pure number; of a sum
    that of its parts."""
    if is_sum(variable):
        return unit_of(variable.strip("()").split(" + ")[0])
    if variable in VARIABLE_UNITS:
        return VARIABLE_UNITS[variable]
    if variable.endswith("_angle"):
        return {"rad": 1}
    if variable.endswith("_acceleration"):
        return {"rad": 1, "s": -2}
    return {"rad": 1, "s": -1} if variable.endswith("_rate") else {}


def product(*units: Unit) -> Unit:
    """The unit of a product."""
    total: Counter[str] = Counter()
    for unit in units:
        for base, power in unit.items():
            total[base] += power
    return {base: power for base, power in total.items() if power}


def power(unit: Unit, exponent: int) -> Unit:
    """The unit of a power."""
    return {base: exponent * own for base, own in unit.items() if exponent * own}


def unit_text(unit: Unit) -> str:
    """`N s/m`, `N/(m rad^2)`, `1/m`, and "-" for a pure number."""
    above = [_part(base, unit[base]) for base in ORDER if unit.get(base, 0) > 0]
    below = [_part(base, -unit[base]) for base in ORDER if unit.get(base, 0) < 0]
    if not below:
        return " ".join(above) or "-"
    divisor = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return f"{' '.join(above) or '1'}/{divisor}"


def _part(base: str, exponent: int) -> str:
    return base if exponent == 1 else f"{base}^{exponent}"
