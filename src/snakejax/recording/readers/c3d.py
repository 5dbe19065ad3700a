"""C3D, by ezc3d (extra `c3d`): markers. NaN or a residual below zero is lost; other residuals are not to be trusted.

X_SCREEN and Y_SCREEN say how a display shows the axes. That Y_SCREEN points along z or -z tells that z is vertical; its
sign is about the display, and which end is up is found from where the markers are.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from snakejax.core.errors import InputError

from .capture import LENGTH, Capture, Source, repeated
from .cells import shown
from .subprocess_reader import read_in_subprocess
from .upward import AXES, Upward, side_of, upward

MAGIC = 0x50
BLOCK = 512
SATURATED = 65535
SLOWEST, FASTEST = 0.01, 1e6
FARTHEST = 1e5
"""A camera sees nothing so far [m] away: such numbers are none, read in another format than they were written."""
CONVERT = "or open it in Mokka (of BTK) and save it as a new C3D or as TRC, which snakejax reads"
REMEDY = f"export it again, {CONVERT}"
OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Groups of labels, of POINT, under which programs list what a model computed: numbers of three, but no places."""


def recognises(source: Source) -> bool:
    """Whether the first bytes point to a block of parameters and carry the format's key, or the name ends in .c3d."""
    head = source.head
    if len(head) >= BLOCK and head[1] == MAGIC and 1 < head[0] < 9:
        return True
    # A damaged C3D is no text: the other readers would complain of its encoding.
    return source.path.suffix.lower() == ".c3d" and not head.isascii()


def read(source: Source) -> Capture:
    """All markers. **Raises:** `InputError`."""
    path = source.path
    facts, arrays = read_in_subprocess("c3d", path, "ezc3d", REMEDY)
    if (unit := facts["units"]) not in LENGTH:
        what = f'Unknown unit "{shown(unit)}" of its points'
        raise InputError(what, str(path), f"export it with POINT:UNITS {' or '.join(LENGTH)}")
    if not SLOWEST < facts["rate"] < FASTEST:
        raise InputError(f"The frame rate of {facts['rate']:.2g} Hz is impossible", str(path), REMEDY)
    names = facts["labels"]
    points = arrays["points"]
    distances = np.abs(points[np.isfinite(points)])
    if distances.size and not np.median(distances) * LENGTH[unit] < FARTHEST:
        raise InputError(f"Its points are {np.median(distances) * LENGTH[unit]:.2g} m away", str(path), REMEDY)
    markers = {name: points[i] * LENGTH[unit] for i, name in reversed([*enumerate(names)])}
    times = np.arange(points.shape[1]) / facts["rate"]
    doubled = repeated(names)
    ordered = {name: markers[name] for name in names}
    axis = facts["up"].lower().lstrip("+-")
    known = axis in AXES
    up = _along(ordered, axis, facts["up"]) if known else upward(ordered, "z", "a guess")
    return Capture(
        "C3D",
        path,
        str(path),
        facts["rate"],
        unit,
        {},
        ordered,
        times,
        up=up.up,
        up_known=known,
        up_said=up.reason,
        up_open=up.open,
        doubled=doubled,
        notes=_notes(facts["outputs"]),
    )


def _notes(outputs: list[str]) -> list[str]:
    if not outputs:
        return []
    listed = ", ".join(outputs[:6]) + (", ..." if len(outputs) > 6 else "")
    return [f"{len(outputs)} outputs of a model are not markers and are ignored: {listed}"]


def _along(markers: dict[str, np.ndarray], axis: str, screen: str) -> Upward:
    """The end of `axis` that points up, where the file's Y_SCREEN is `screen`."""
    side = side_of(markers, axis)
    if side is None:
        reason = "the file names this axis; neither it nor the markers show which direction is up; change it with --up"
        return Upward(axis, reason)
    reason = "the file names this axis, and its markers lie above the floor in this direction"
    if (side[0] == "-") != screen.startswith("-"):
        reason += f"; the sign in Y_SCREEN {shown(screen)} describes a display and is not used"
    return Upward(side, reason)


def load(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The facts and the points (marker, frame, 3) of the file, as ezc3d reads it."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    point = file["parameters"].get("POINT", {})

    def value(group: Any, name: str, usual: Any) -> Any:
        values = group.get(name, {}).get("value", [])
        return values[0] if len(values) else usual

    data = file["data"]["points"]
    residuals = np.asarray(file["data"]["meta_points"]["residuals"]).reshape(data.shape[1:])
    points = np.moveaxis(data[:3], 0, -1).copy()
    points[(residuals < 0) | ~np.isfinite(points).all(axis=-1)] = np.nan
    rate = float(value(point, "RATE", 0.0))
    stated_frames = _stated_frames(path, file["parameters"].get("TRIAL", {}))
    if not data.shape[2]:
        what = (
            f"ezc3d finds none of the {stated_frames} frames that the C3D's header says"
            if stated_frames > 0
            else "The C3D has no frames"
        )
        raise InputError(what, str(path), REMEDY)
    if data.shape[2] < stated_frames:
        what = f"The C3D is cut short: its header says {stated_frames} frames, but {data.shape[2]} are there"
        raise InputError(what, str(path), f"copy it again, {CONVERT}")
    labels = _listed(point, ("LABELS",))[: len(points)]
    labels += [""] * (len(points) - len(labels))
    computed = set(_listed(point, OUTPUTS))
    places = [i for i, label in enumerate(labels) if label not in computed or not label]
    facts = {
        "labels": [labels[i] or f"marker {i + 1}" for i in places],
        "outputs": [label for label in labels if label and label in computed],
        "rate": rate,
        "units": str(value(point, "UNITS", "mm")).strip(),
        "up": str(value(point, "Y_SCREEN", "")).strip(),
    }
    return facts, {"points": points[places]}


def _listed(point: Any, names: tuple[str, ...]) -> list[str]:
    """What the parameters `names` of the group POINT list, and those that go on with a number behind the name."""
    labels = [part["value"] for key, part in point.items() if key.rstrip("0123456789") in names]
    return [str(label).strip() for value in labels for label in value]


def _stated_frames(path: Path, trial: Any) -> int:
    """How many frames the header has; ezc3d reports those it could read. Numbers above 65534 stand in TRIAL."""
    with path.open("rb") as file:
        first, last = struct.unpack("<HH", file.read(10)[6:])
    if last < SATURATED:
        return last - first + 1
    ends = [trial.get(f"ACTUAL_{end}_FIELD", {}).get("value", []) for end in ("START", "END")]
    if any(len(end) != 2 for end in ends):
        return 0
    first, last = (int(low) % 65536 + 65536 * (int(high) % 65536) for low, high in ends)
    return last - first + 1
