"""Known gaits, duration and payload, as the commands that design a gait take them from a case or preset."""

import argparse
from typing import TYPE_CHECKING, Any, NamedTuple

from snakejax.core.errors import InputError

from .options import assignments, finite, start_pose

if TYPE_CHECKING:
    from snakejax.dynamics.inputs import Gait


class GaitRequest(NamedTuple):
    """The run that is asked for: duration [s] (None: that of the first run), limits by name, start pose, and payload
    [kg, kg m^2] (None: that of the first run)."""

    seconds: float | None
    limit: dict[str, float]
    start: tuple[float, float, float]
    payload: tuple[float, float] | None


def gait_request(options: argparse.Namespace) -> GaitRequest:
    """What the options ask for. **Raises:** `InputError`."""
    return GaitRequest(
        None if options.seconds is None else finite(options.seconds, "option --seconds", f"`{options.seconds}`"),
        assignments(",".join(options.limit or ()), "option --limit"),
        start_pose(options.start) or (0.0, 0.0, 0.0),
        payload_of(options.payload),
    )


def payload_of(text: str | None) -> tuple[float, float] | None:
    """Mass [kg] and yaw inertia [kg m^2] from `KG` or `KG,KGM2`. **Raises:** `InputError`."""
    if text is None:
        return None
    where = "option --payload"
    parts = [finite(part, where, f"`{text}`") for part in text.split(",")]
    if len(parts) > 2 or min(parts) < 0:
        raise InputError(
            f"`{text}` is not a payload", where, "write mass in kg and yaw inertia in kg m^2, as in 2,0.01"
        )
    return parts[0], parts[1] if len(parts) == 2 else 0.0


def carried(payload: tuple[float, float] | None, subject: Any) -> tuple[tuple[float, float], str]:
    """The payload [kg, kg m^2] of the design (by default of the first run), and the words that describe it."""
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    runs = () if isinstance(subject, Preset) else subject.runs
    each = [(float(run_.payload[0]), float(run_.payload[1])) for run_ in runs]
    mass, inertia = (each[0] if each else (0.0, 0.0)) if payload is None else payload
    words = f", carrying {mass:g} kg and {inertia:g} kg m^2" if mass or inertia else ", carrying nothing"
    as_run = f" as in {runs[0].name}" if payload is None and runs else ""
    return (mass, inertia), f"{words}{as_run}" if any(any(pair) for pair in [*each, (mass, inertia)]) else ""


def payload_json(payload: tuple[float, float]) -> dict[str, Any]:
    """The payload [kg, kg m^2] as JSON."""
    return {"payload": {"mass_kg": payload[0], "inertia_kgm2": payload[1]}}


def gaits_of(subject: Any) -> "tuple[list[Gait], float]":
    """The gaits of the runs from rest, and the duration of the first run [s].

    **Raises:** `InputError` for another vehicle than a snakeboard.
    """
    from snakejax.dynamics.inputs import Gait
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    if isinstance(subject, Preset):
        return [subject.gait], subject.duration
    if not isinstance(subject.runs[0].gait, Gait):
        what = f"Gaits are those of a snakeboard, but the vehicle is a {subject.board.noun}"
        raise InputError(what, "argument CASE", "`tune` and the design of runs take snakeboards only, so far")
    return [run_.gait for run_ in subject.runs if not run_.moving], float(subject.runs[0].times[-1])
