"""Whether a law that resists motion does so: nothing passive drives a vehicle."""

from collections.abc import Iterable

import numpy as np

from snakejax.core.formula import evaluated, parsed

from .search import ProposedLaw
from .windows import ForceWindows

DRIVEN = 0.1
"""Of the energy that a resistance exchanges with the vehicle, at most this share may go to the vehicle: what a fit is
wrong by can make a resistance negative where it is small."""
LESSENED = {
    "drag": ("body_drag", "quadratic_drag"),
    "friction": ("rolling_resistance",),
    "rolling": ("rolling_resistance",),
    "front rolling": ("rolling_resistance",),
    "back rolling": ("rolling_resistance",),
    "yaw_drag": ("yaw_damping", "yaw_friction"),
}
"""The actions that resist motion, with the known effects of which such a law may take something away."""
DRIVEN_BY_OTHERS = ("wind", "friction at an arm", "drag at an arm")
"""The names of forms of such an action that may drive the vehicle: air that moves, and a joint."""


def is_passive(windows: ForceWindows, law: ProposedLaw, effects: Iterable[str]) -> bool:
    """Whether `law`, if it resists motion, takes energy from the vehicle in the `windows`; or may take something away
    from a resistance among the known `effects`."""
    family = law.family
    if family.action not in LESSENED or family.name in DRIVEN_BY_OTHERS:
        return True
    if set(LESSENED[family.action]) & set(effects):
        return True
    power = _power(windows, law)
    return float(np.maximum(power, 0.0).sum()) <= DRIVEN * float(np.abs(power).sum())


def _power(windows: ForceWindows, law: ProposedLaw) -> np.ndarray:
    """What `law` brings to the vehicle [W] at each sample."""
    terms = [(f"{term.amplitude} * ", term.formulas) for term in law.family.terms]
    total = np.zeros_like(windows.theta)
    for side in (0, 1):
        known = {name: values[side] for name, values in windows.variables.items()} | law.values
        of_body = {} if side else {"X": known["u"], "Y": known["w"], "N": known["r"]}
        speeds = of_body | {"resistance": -known["rolling_speed"]}
        for amplitude, formulas in [("", law.family.together)] if law.family.together else terms:
            for component, formula in formulas:
                if component in speeds:
                    force = evaluated(parsed(f"{amplitude}({formula or '1'})"), known, np)
                    total = total + force * speeds[component]
    return total
