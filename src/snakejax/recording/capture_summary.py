"""The summary of a recording: its objects and markers, their gaps, and the axis that points up."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.tabular import first_few

from .readers import Capture
from .readers.motion_plane import Ground, arms, ground_of, is_rigid
from .readers.planar_pose import subjects

LEAST_TILT, MOST_TILT = np.deg2rad(0.5), np.deg2rad(10.0)
"""Angle between the normal of motion and an axis of the file: below the first, the axis itself is up; above the second,
the plane is not the floor."""
MOST_LISTED = 24
"""Objects or markers of a summary; the JSON has all."""
LEAST_SHARE = 0.8
"""Only markers seen in more than this share of the frames show the plane of motion."""


class Coverage(NamedTuple):
    """The number of frames of one object, of lost frames, and the longest gap [s]."""

    frames: int
    lost: int
    longest_gap: float


def coverage(times: Float[np.ndarray, " n"], position: Float[np.ndarray, "n 3"]) -> Coverage:
    """The coverage of `position` [m] at `times` [s]."""
    present = np.flatnonzero(np.isfinite(position).all(axis=1))
    frames = len(times)
    if not present.size:
        return Coverage(frames, frames, float(times[-1] - times[0]) if frames else 0.0)
    gaps = np.diff(present) > 1
    steps = np.diff(times[present])[gaps]
    return Coverage(frames, frames - present.size, float(steps.max()) if steps.size else 0.0)


def ground(capture: Capture, object: str) -> Ground | None:
    """The plane in which `object`, a body or a subject with markers, moves; None where it does not show, as of markers
    that keep no shape, or is known as the file is planar.
    """
    if object in capture.bodies:
        body = capture.bodies[object]
        return None if body.heading is not None else ground_of(arms(body.position, body.rotation))
    seen_often = [name for name in subjects(capture).get(object, []) if _share(capture.markers[name]) > LEAST_SHARE]
    if not seen_often:
        return None
    points = np.stack([capture.markers[name] for name in seen_often[:MOST_LISTED]], axis=1)
    # The plane in which a person walks is no floor.
    return ground_of(points) if len(seen_often) == 1 or is_rigid(points) else None


def _share(position: Float[np.ndarray, "n 3"]) -> float:
    return float(np.isfinite(position[:, 0]).mean()) if len(position) else 0.0


def is_floor(capture: Capture, plane: Ground) -> bool:
    """Whether the plane of motion may be the floor: it is perpendicular to the axis that the file says is up, or
    nearly to some axis where the file does not say.
    """
    return plane.tilt < MOST_TILT and (plane.axis == capture.up[-1] or not capture.up_known)


def up_of(capture: Capture, plane: Ground | None) -> str | list[float] | None:
    """Which way is up by the motion, as case.toml says it; None where the file's own, or its format's, will do."""
    if plane is None or not is_floor(capture, plane):
        return None
    # A plane has two sides: that of the file's own axis, where it is the same one.
    below = capture.up == f"-{plane.axis}"
    if plane.tilt >= LEAST_TILT:
        return [round(float(-part if below else part), 6) for part in plane.up]
    if plane.axis == capture.up[-1]:
        return capture.up if capture.up_open else None
    return plane.axis


def summary(capture: Capture) -> dict[str, Any]:
    """The summary of `capture` as plain data for JSON."""
    return {
        "format": capture.format,
        "rate_hz": rate_of(capture),
        "units": capture.units,
        "up": None if capture.up_open else capture.up,
        "objects": {name: coverage(b.times, b.position)._asdict() for name, b in capture.bodies.items()},
        "markers": {name: coverage(capture.times, p)._asdict() for name, p in capture.markers.items()},
        "angles": {name: reading.angles for name, reading in capture.angles.items()},
        "doubled": sorted(set(capture.doubled)),
        "notes": notes_of(capture),
    }


def rate_of(capture: Capture) -> float | None:
    """Frames per second: the file's own, or by the median time between samples; None where there are no two."""
    clocks = [body.times for body in capture.bodies.values()] or [capture.times]
    if capture.rate is not None or len(clocks[0]) < 2:
        return capture.rate
    step = float(np.median(np.diff(clocks[0])))
    return 1.0 / step if step > 0 else None


def summary_text(capture: Capture, grounds: Mapping[str, Ground | None], up: str | None = None) -> str:
    """The summary as text, with the `grounds` of the objects to show and the axis `up` that the user gave."""
    clocks = [body.times for body in capture.bodies.values()] or [capture.times]
    rate, span = rate_of(capture), float(clocks[0][-1] - clocks[0][0]) if len(clocks[0]) else 0.0
    clock = "frames" if capture.rate is not None else "time stamps"
    paced = f"{clock} at {rate:.6g} Hz" if rate else clock
    lines = [f"{capture.path.name}: {capture.format}, {paced} for {span:.2f} s, in {capture.units}"]
    for name, body in [*capture.bodies.items()][:MOST_LISTED]:
        called = name or next(iter(grounds), "") or "(without a name)"
        lines.append(f"  object   {called}: {_coverage_text(coverage(body.times, body.position))}")
    if len(capture.bodies) > MOST_LISTED:
        lines.append(f"  object   and {len(capture.bodies) - MOST_LISTED} more: --json FILE lists them all")
    for name, markers in subjects(capture).items():
        lines.append(f"  markers  {name or '(of no object)'}: {_listed(capture, markers)}")
    for name, reading in [*capture.angles.items()][:MOST_LISTED]:
        lines.append(f"  angles   {name}: RX, RY, RZ are {reading.description}")
    lines += [f"  up       {direction}" for direction in _ways_up(capture, grounds, up)]
    return "\n".join([*lines, *(f"  note     {note}" for note in notes_of(capture))])


def notes_of(capture: Capture) -> list[str]:
    """Remarks on the file: its notes and repeated names."""
    times = Counter(capture.doubled)
    if not times:
        return list(capture.notes)
    listed = first_few([f"{name} ({1 + count} times)" for name, count in times.items()], MOST_LISTED, comma=True)
    hidden = "only the first of each is shown, and none can be used"
    return [*capture.notes, f"repeated names: {listed}; {hidden}"]


def _ways_up(capture: Capture, grounds: Mapping[str, Ground | None], up: str | None) -> list[str]:
    planar = {name for name, body in capture.bodies.items() if body.heading is not None}
    if planar and planar >= (set(grounds) or set(capture.bodies)):
        return []
    if up is not None:
        return [f"{up}, as given"]
    if grounds:
        return [_way_up(capture, name or "the object", plane) for name, plane in grounds.items()]
    return [f"{_usual_up(capture)}; with --object it is found from the motion of the object"]


def _usual_up(capture: Capture) -> str:
    if capture.up_open:
        return f"is not known, {capture.up} is {capture.up_said}: say it with --up"
    return f"{capture.up}, {capture.up_said or f'as {capture.format} usually has it'}"


def _way_up(capture: Capture, name: str, plane: Ground | None) -> str:
    usual = _usual_up(capture)
    if plane is None:
        return f"{usual}; the motion of {name} does not determine the vertical"
    tilt = f", {np.degrees(plane.tilt):.1f} degrees off" if plane.tilt >= LEAST_TILT else ""
    if not is_floor(capture, plane):
        where = f"{name} moves in a plane across {plane.axis}{tilt}, which is not the floor"
        return f"{usual}; {where}; change the axis with --up"
    axis = capture.up if plane.axis == capture.up[-1] else plane.axis
    why = f" ({capture.up_said})" if axis == capture.up and capture.up_said and not capture.up_open else ""
    return f"{axis}: perpendicular to the plane in which {name} moves{tilt}{why}"


def _coverage_text(part: Coverage) -> str:
    gap = f", the longest gap {part.longest_gap:.2f} s" if part.longest_gap else ""
    return f"{part.frames} frames, {part.lost} lost{gap}"


def _listed(capture: Capture, names: Sequence[str]) -> str:
    words = []
    for name in names[:MOST_LISTED]:
        lost = coverage(capture.times, capture.markers[name]).lost
        words.append((name.rpartition(":")[2] or "(without a name)") + (f" ({lost} lost)" if lost else ""))
    return ", ".join(words) + (f", and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else "")
