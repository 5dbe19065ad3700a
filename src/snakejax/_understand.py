"""What a recording was understood to hold: its objects and markers, their gaps, and which way is up."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .readers import Capture
from .readers._ground import Ground, arms, ground_of
from .readers._track import subjects

LEAST_TILT, MOST_TILT = np.deg2rad(0.5), np.deg2rad(10.0)
MOST_LISTED = 24
LEAST_SHARE = 0.8


class Seen(NamedTuple):
    """How much of one object is there: frames, how many of them are lost, and the longest gap [s]."""

    frames: int
    lost: int
    longest_gap: float


def seen(times: Float[np.ndarray, " n"], position: Float[np.ndarray, "n 3"]) -> Seen:
    """How much of `position` is there."""
    there = np.flatnonzero(np.isfinite(position).all(axis=1))
    frames = len(times)
    if not there.size:
        return Seen(frames, frames, float(times[-1] - times[0]) if frames else 0.0)
    gaps = np.diff(there) > 1
    steps = np.diff(times[there])[gaps]
    return Seen(frames, frames - there.size, float(steps.max()) if steps.size else 0.0)


def ground(capture: Capture, object: str) -> Ground | None:
    """The plane in which `object`, a body or a subject with markers, moves; None where it does not show, or is known
    as the file is planar.
    """
    if object in capture.bodies:
        body = capture.bodies[object]
        return None if body.heading is not None else ground_of(arms(body.position, body.rotation))
    seen_often = [name for name in subjects(capture).get(object, []) if _share(capture.markers[name]) > LEAST_SHARE]
    names = seen_often[:MOST_LISTED]
    return ground_of(np.stack([capture.markers[name] for name in names], axis=1)) if names else None


def _share(position: Float[np.ndarray, "n 3"]) -> float:
    return float(np.isfinite(position[:, 0]).mean()) if len(position) else 0.0


def is_floor(capture: Capture, found: Ground) -> bool:
    """Whether the plane of motion may be the floor: it lies across the axis the file says is up, or nearly across some
    axis where the file does not say.
    """
    return found.tilt < MOST_TILT and (found.axis == capture.up or not capture.up_known)


def up_of(capture: Capture, found: Ground | None) -> str | list[float] | None:
    """Which way is up by the motion, as case.toml says it; None where the file's own, or its format's, will do."""
    if found is None or not is_floor(capture, found):
        return None
    if found.tilt >= LEAST_TILT:
        return [round(float(part), 6) for part in found.up]
    return None if found.axis == capture.up else found.axis


def facts(capture: Capture) -> dict[str, Any]:
    """What was understood, for JSON."""
    return {
        "format": capture.format,
        "rate_hz": rate_of(capture),
        "units": capture.units,
        "up": capture.up,
        "objects": {name: seen(b.times, b.position)._asdict() for name, b in capture.bodies.items()},
        "markers": {name: seen(capture.times, p)._asdict() for name, p in capture.markers.items()},
        "notes": list(capture.notes),
    }


def rate_of(capture: Capture) -> float | None:
    """Frames per second: the file's own, or by the median time between samples; None where there are no two."""
    clocks = [body.times for body in capture.bodies.values()] or [capture.times]
    if capture.rate is not None or len(clocks[0]) < 2:
        return capture.rate
    step = float(np.median(np.diff(clocks[0])))
    return 1.0 / step if step > 0 else None


def understood(capture: Capture, grounds: Mapping[str, Ground | None]) -> str:
    """What was understood, as text; `grounds` of the objects that matter."""
    clocks = [body.times for body in capture.bodies.values()] or [capture.times]
    rate, span = rate_of(capture), float(clocks[0][-1] - clocks[0][0]) if len(clocks[0]) else 0.0
    clock = "frames" if capture.rate is not None else "time stamps"
    paced = f"{clock} at {rate:.6g} Hz" if rate else clock
    lines = [f"{capture.path.name}: {capture.format}, {paced} for {span:.2f} s, in {capture.units}"]
    for name, body in capture.bodies.items():
        lines.append(f"  object   {name or '(without a name)'}: {_said(seen(body.times, body.position))}")
    for name, of in subjects(capture).items():
        lines.append(f"  markers  {name or '(of no object)'}: {_listed(capture, of)}")
    for name, found in grounds.items():
        lines.append(f"  up       {_way_up(capture, name or 'the object', found)}")
    return "\n".join([*lines, *(f"  note     {note}" for note in capture.notes)])


def _way_up(capture: Capture, name: str, found: Ground | None) -> str:
    usual = f"{capture.up}, as {'the file says' if capture.up_known else f'{capture.format} usually has it'}"
    if found is None:
        return f"{usual}; the motion of {name} does not show it"
    tilt = f", {np.degrees(found.tilt):.1f} degrees off" if found.tilt >= LEAST_TILT else ""
    if not is_floor(capture, found):
        return f"{usual}; {name} moves in a plane across {found.axis}{tilt}, which is no floor: --up says otherwise"
    return f"{found.axis}: the plane in which {name} moves lies across it{tilt}"


def _said(part: Seen) -> str:
    gap = f", the longest gap {part.longest_gap:.2f} s" if part.longest_gap else ""
    return f"{part.frames} frames, {part.lost} lost{gap}"


def _listed(capture: Capture, names: Sequence[str]) -> str:
    words = []
    for name in names[:MOST_LISTED]:
        lost = seen(capture.times, capture.markers[name]).lost
        words.append(name.rpartition(":")[2] + (f" ({lost} lost)" if lost else ""))
    return ", ".join(words) + (f", and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else "")
