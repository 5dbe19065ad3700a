"""Whether a law is passive: a resistance resists, and no engine aboard pushes the vehicle by the clock."""

from collections.abc import Mapping, Sequence

import numpy as np

from snakejax.core.formula import evaluated, parsed
from snakejax.dynamics.contact import STICKING_SPEED

from .search import ProposedLaw
from .terms import BODY_ACTION, OF_FACING, Term
from .windows import ForceWindows

DRIVEN = 0.1
"""Of the energy that a resistance exchanges with the vehicle, at most this share may go to the vehicle: what a fit is
wrong by can make a resistance negative where it is small."""
OF_TURNING = {
    "yaw_damping": Term("c", {}, (("N", "-r"),)),
    "yaw_friction": Term("t", {}, (("N", "-tanh(r / 0.02)"),)),
}
"""The known effects that resist turning, as terms of a law."""
OF_TRAVEL = {
    "longitudinal_slip": Term("k", {}, (("resistance", "rolling_speed"),)),
    "rolling_resistance": Term("f", {}, (("resistance", f"tanh(rolling_speed / {STICKING_SPEED})"),)),
    "body_drag": Term("c", {}, (("X", "-u"), ("Y", "-w"))),
    "quadratic_drag": Term("c", {}, (("X", "-speed * u"), ("Y", "-speed * w"))),
}
"""Those that resist the motion of the body or the rolling of its wheels."""
LESSENED: dict[str, Mapping[str, Term]] = {
    **dict.fromkeys(("drag", "friction", "rolling", "front rolling", "back rolling"), OF_TRAVEL),
    "yaw_drag": OF_TURNING,
}
"""The actions that resist motion, with the known effects of which such a law may take something away."""
OF_OWN_SPEED = {("X", ("u",)): OF_TRAVEL, ("Y", ("w",)): OF_TRAVEL, ("N", ("r",)): OF_TURNING}
"""A force that depends on the speed along itself alone resists too: by action and variables, likewise."""
DRIVEN_BY_OTHERS = ("wind", "friction at an arm", "drag at an arm")
"""The names of forms of such an action that may drive the vehicle: air that moves, and a joint."""


def is_passive(windows: ForceWindows, law: ProposedLaw, known: Mapping[str, float]) -> bool:
    """Whether `law` is no push along or across the body that depends on the time alone; and, if it resists motion,
    takes energy from the vehicle in the `windows`, together with what known effects take: `known` has the values of
    parameters, `effects.body_drag.c`."""
    family = law.family
    if family.action in (*OF_FACING, BODY_ACTION) and family.variables == ("time",):
        return False
    lessened = LESSENED.get(family.action) or OF_OWN_SPEED.get((family.action, family.variables))
    if lessened is None or family.name in DRIVEN_BY_OTHERS:
        return True
    own = [(term.formulas, law.values[term.amplitude]) for term in family.terms]
    power = _power(windows, [(family.together, 1.0)] if family.together else own, law.values)
    resisting = [
        (term.formulas, known[name])
        for effect, term in lessened.items()
        if (name := f"effects.{effect}.{term.amplitude}") in known
    ]
    driving = np.maximum(power + _power(windows, resisting, {}), 0.0)
    return float(driving.sum()) <= DRIVEN * float(np.abs(power).sum())


def _power(
    windows: ForceWindows,
    terms: Sequence[tuple[tuple[tuple[str, str], ...], float]],
    values: Mapping[str, float],
) -> np.ndarray:
    """What `terms`, formulas by component and their multipliers, bring to the vehicle [W] at each sample, with the
    `values` of what else the formulas name."""
    total = np.zeros_like(windows.theta)
    for side in (0, 1):
        variables = {name: history[side] for name, history in windows.variables.items()} | dict(values)
        of_body = {} if side else {"X": variables["u"], "Y": variables["w"], "N": variables["r"]}
        speeds = of_body | {"resistance": -variables["rolling_speed"]}
        for formulas, multiplier in terms:
            for component, formula in formulas:
                if component in speeds:
                    total = total + multiplier * evaluated(parsed(formula or "1"), variables, np) * speeds[component]
    return total
