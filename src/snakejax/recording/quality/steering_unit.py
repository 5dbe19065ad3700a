"""Steering angles in degrees: they then go further than any wheelset turns."""

from collections.abc import Iterator, Sequence

import numpy as np

from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import AbstractSignal, Tracked

from ..run import Run
from .finding import Finding
from .joint_motion import angles

FARTHEST = np.pi
"""No wheelset is steered further [rad] from straight ahead: half a turn later it points along the board again."""


def steering_units(runs: Sequence[Run]) -> list[Finding]:
    """The run of `runs` that steers furthest, if no wheelset steers so far in radians."""
    reached = [(angle, name, run.name) for run in runs for name, angle in farthest_steering(run)]
    angle, name, run_name = max(reached, default=(0.0, "", ""))
    if angle <= FARTHEST:
        return []
    what = f"{name} is commanded to {angle:.3g} rad in {run_name}, beyond half a turn: is this in degrees?"
    remedy = "give phi and psi in rad: 1 degree is 0.01745 rad"
    return [Finding("angle_unit", what, remedy, 0.0, 0.0, size=angle, unit="rad", severity="refused")]


def farthest_steering(run: Run) -> Iterator[tuple[str, float]]:
    """Each steering joint of `run`, and how far [rad] it is commanded from straight ahead."""
    for name in ("phi", "phi_back") if isinstance(run.gait, Gait) else ():
        signal: AbstractSignal | None = getattr(run.gait, name)
        command = signal.command if isinstance(signal, Tracked) else signal
        if command is not None:
            yield name, float(np.abs(angles(command, np.asarray(run.times))).max())
