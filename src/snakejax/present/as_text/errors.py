"""Errors as text: in millimetres and milliradians, and in multiples of the noise.

A misfit is a mean square: an error ten times the noise has a misfit of 100. JSON holds the misfit, text its root.
"""

from collections.abc import Mapping
from math import sqrt

from snakejax.core.tabular import three_digits
from snakejax.estimation.goodness_of_fit import RunScore, Score

LEAST = 2e-3
"""The accuracy of `simulate`, in mm and in mrad: a smaller error is that of the solver."""
POSE_ERRORS = {"position_error_m": "position error [mm]", "heading_error_rad": "heading error [mrad]"}
"""The errors of an end pose: their keys in JSON, and their names in text, where they are 1000 times as large."""


def times_noise(misfit: float | None) -> float | None:
    """The root mean square error in multiples of the noise: sqrt(misfit)."""
    return None if misfit is None else sqrt(misfit)


def times_noise_text(misfit: float | None) -> str:
    """`times_noise` of `misfit` as text."""
    return three_digits(times_noise(misfit))


def milli_text(error: float | None) -> str:
    """An error in m or rad as a number in mm or mrad: three digits, and no more than three behind the point."""
    if error is None:
        return ""
    if abs(error) * 1e3 < LEAST:
        return f"< {LEAST:g}"
    return f"{1e3 * error:.3f}" if abs(error) * 1e3 < 1 else three_digits(1e3 * error)


def pose_error_text(position_m: float, heading_rad: float) -> str:
    """An error in position and heading: `0.567 mm and 2.50 mrad`, or `less than 0.002 mm and 0.002 mrad`."""
    position, heading = (milli_text(part).replace("<", "less than") for part in (position_m, heading_rad))
    if position == heading == f"less than {LEAST:g}":
        heading = f"{LEAST:g}"
    return f"{position} mm and {heading} mrad"


def missed_text(objective: Mapping[str, float]) -> str:
    """The error of the end pose, from the JSON of `snakejax tune`."""
    return pose_error_text(*(objective[name] for name in POSE_ERRORS))


OBJECTIVE_UNITS = {"distance": " m", "turn": " rad"}
"""The unit of the result of an objective, as text behind the number; a pose error has its own units."""


def target_pose(objective: str) -> tuple[float, float, float] | None:
    """x, y [m] and heading [rad] of the target `reach:x,y,heading`; None for another objective."""
    kind, _, numbers = objective.partition(":")
    if kind != "reach":
        return None
    x, y, heading = (float(part) for part in numbers.split(","))
    return x, y, heading


def error_text(score: Score | RunScore) -> str:
    """The root mean square error of runs: `0.567 mm and 2.50 mrad (1.00 times the noise)`."""
    pose = pose_error_text(score.position_m, score.heading_rad)
    return f"{pose} ({times_noise_text(score.misfit)} times the noise)"
