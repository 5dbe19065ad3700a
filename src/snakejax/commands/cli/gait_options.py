"""Known gaits, duration and payload, as the commands that design a gait take them from a case or preset."""

import argparse
from typing import Any, NamedTuple

from snakejax.core.errors import InputError

from .options import assignments, finite, start_pose


class GaitRequest(NamedTuple):
    """The run that is asked for: duration [s] (None: that of the first run), limits by name, start pose, and payload
    [kg, kg m^2] (None: that of the first run)."""

    seconds: float | None
    limit: dict[str, float]
    start: tuple[float, float, float]
    payload: tuple[float, float] | None


def add_gait(command: Any, objective: str, objectives: str) -> Any:
    """The options of a run that is to be found; the group of them. `objective`: the default."""
    group = command.add_argument_group("run")
    group.add_argument("--objective", metavar="WHAT", default=objective, help=objectives)
    group.add_argument("--seconds", metavar="T", help="duration of the run [s] (default: that of the first run)")
    group.add_argument(
        "--limit",
        metavar="phi=0.9,psi_rate=6.5",
        action="append",
        help="limits of the joints [rad, rad/s, rad/s^2]: phi, psi, phi_rate, psi_rate, phi_acceleration,"
        " psi_acceleration; of another vehicle by its inputs, as in handle=0.8,handle_rate=4 (default: the largest"
        " angle and rate of the gaits of CASE)",
    )
    group.add_argument(
        "--payload",
        metavar="KG[,KGM2]",
        help="payload of the board: mass [kg] and yaw inertia [kg m^2] (default: that of the first run)",
    )
    group.add_argument("--start", metavar="X,Y,HEADING", help="start pose of the board [m, m, rad] (default 0,0,0)")
    return group


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


def design_payload(payload: tuple[float, float] | None, subject: Any) -> tuple[tuple[float, float], str]:
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
