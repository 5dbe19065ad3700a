"""C3D, by ezc3d (extra `c3d`): markers. NaN or a residual below zero is lost; other residuals are not to be trusted."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from ._apart import read_apart
from ._capture import LENGTH, Capture, Source, repeated
from ._text import shown
from ._turn import UPRIGHT

MAGIC = 0x50
BLOCK = 512
SATURATED = 65535


def recognises(source: Source) -> bool:
    """Whether the first bytes point to a block of parameters and carry the format's key."""
    return len(source.head) >= BLOCK and source.head[1] == MAGIC and 1 < source.head[0] < 9


def read(source: Source) -> Capture:
    """All markers. **Raises:** `InputError`."""
    path = source.path
    facts, arrays = read_apart("c3d", path, "ezc3d", "c3d")
    if (unit := facts["units"]) not in LENGTH:
        what = f'Unknown unit "{shown(unit)}" of its points'
        raise InputError(what, str(path), f"export it with POINT:UNITS {' or '.join(LENGTH)}")
    if not 0 < facts["rate"] < 1e6:
        raise InputError(f"A frame rate of {facts['rate']:g} is none", str(path), "export it again")
    names = facts["labels"]
    points = arrays["points"]
    markers = {name: points[i] * LENGTH[unit] for i, name in reversed([*enumerate(names)])}
    times = np.arange(points.shape[1]) / facts["rate"]
    doubled = repeated(names)
    up = facts["up"].lower().removeprefix("+")
    known = up in UPRIGHT
    ordered = {name: markers[name] for name in names}
    return Capture(
        "C3D", path, str(path), facts["rate"], unit, {}, ordered, times, up if known else "z", known, doubled
    )


def load(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The facts and the points (marker, frame, 3) of the file, as ezc3d reads it."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    point = file["parameters"].get("POINT", {})

    def value(group: Any, name: str, usual: Any) -> Any:
        found = group.get(name, {}).get("value", [])
        return found[0] if len(found) else usual

    seen = file["data"]["points"]
    residuals = np.asarray(file["data"]["meta_points"]["residuals"]).reshape(seen.shape[1:])
    points = np.moveaxis(seen[:3], 0, -1).copy()
    points[(residuals < 0) | ~np.isfinite(points).all(axis=-1)] = np.nan
    rate = float(value(point, "RATE", 0.0))
    said = _frames_said(path, file["parameters"].get("TRIAL", {}))
    if seen.shape[2] < said:
        what = f"The C3D is cut short: its header says {said} frames, but {seen.shape[2]} are there"
        raise InputError(what, str(path), "copy or export it again")
    if not seen.shape[2]:
        raise InputError("The C3D has no frames", str(path), "export it again with its points")
    labels = [label for name, part in point.items() if name.startswith("LABELS") for label in part["value"]]
    labels = [str(label).strip() for label in labels][: len(points)]
    labels += [f"marker {i + 1}" for i in range(len(labels), len(points))]
    facts = {
        "labels": [label or f"marker {i + 1}" for i, label in enumerate(labels)],
        "rate": rate,
        "units": str(value(point, "UNITS", "mm")).strip(),
        "up": str(value(point, "Y_SCREEN", "")).strip(),
    }
    return facts, {"points": points}


def _frames_said(path: Path, trial: Any) -> int:
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
