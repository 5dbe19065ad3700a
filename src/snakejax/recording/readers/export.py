"""Any capture as a plain CSV whose names carry the units, or one body as a TUM trajectory; z points up in both."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError

from .capture import Body, Capture, FileAnnotations
from .planar_pose import body_of, up_by
from .rotations import upright

POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
PLANAR = ("x_m", "y_m", "heading_rad")
POINT = ("x_m", "y_m", "z_m")
AT_ONCE = 100_000
"""Rows that are written at once, to limit the memory."""


def write_csv(capture: Capture, path: Path, objects: Sequence[str] = (), hints: FileAnnotations | None = None) -> None:
    """Write `objects`, or all bodies and markers, to `path`: time_s,x_m,y_m,z_m,qx,qy,qz,qw, a lost frame blank.

    With more than one the names begin with that of the object: board.x_m. What is known in a plane only has x_m, y_m
    and heading_rad.

    **Raises:** `InputError` where the objects have different clocks, or `path` cannot be written.
    """
    hints = hints or FileAnnotations()
    turn = upright(up_by(capture, hints))
    bodies = {name: body_of(capture, name, hints) for name in objects} if objects else dict(capture.bodies)
    markers = {} if objects else dict(capture.markers)
    clocks = [body.times for body in bodies.values()] + [capture.times] * bool(markers)
    if not clocks:
        raise InputError("The file holds no object and no marker", str(capture.path), "record something first")
    if any(len(c) != len(clocks[0]) or not np.array_equal(c, clocks[0]) for c in clocks[1:]):
        raise InputError("The objects have different clocks", str(capture.path), "write one at a time, with --object")
    several = len(bodies) + len(markers) > 1
    header, columns = ["time_s"], []
    for name, body in bodies.items():
        titles = POSE if body.heading is None else PLANAR
        header += [f"{_plain(name)}.{title}" if several else title for title in titles]
        columns.append(upright_pose(body, turn) if body.heading is None else _planar(body))
    for name, points in markers.items():
        header += [f"{_plain(name)}.{title}" for title in POINT]
        columns.append(points @ turn.T)
    _write(path, ",".join(header) + "\n", clocks[0], np.concatenate(columns, axis=1), ",")


def write_tum(capture: Capture, path: Path, object: str, hints: FileAnnotations | None = None) -> None:
    """Write the poses of `object` that are not lost to `path`: timestamp tx ty tz qx qy qz qw.

    **Raises:** `InputError` where there is no such object, or `path` cannot be written.
    """
    hints = hints or FileAnnotations()
    body = body_of(capture, object, hints)
    # A heading is about the axis up already.
    pose = upright_pose(body, np.eye(3) if body.heading is not None else upright(up_by(capture, hints)))
    present = np.isfinite(pose).all(axis=1)
    _write(path, "# timestamp tx ty tz qx qy qz qw\n", body.times[present], pose[present], " ")


def upright_pose(body: Body, turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n 7"]:
    """Position and quaternion of `body` after `turn` has made z point up, in the world and on the body alike."""
    return np.concatenate([body.position @ turn.T, body.rotation[:, :3] @ turn.T, body.rotation[:, 3:]], axis=1)


def _planar(body: Body) -> Float[np.ndarray, "n 3"]:
    assert body.heading is not None
    return np.concatenate([body.position[:, :2], body.heading[:, None]], axis=1)


def _plain(name: str) -> str:
    return "".join("_" if sign in ',;"\t\n' else sign for sign in name) or "object"


def _write(path: Path, header: str, times: np.ndarray, values: np.ndarray, separator: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(header)
            formats = ["%.9f", *["%.12g"] * values.shape[1]]
            for start in range(0, len(times), AT_ONCE):
                text = io.StringIO()
                part = slice(start, start + AT_ONCE)
                table = np.column_stack([times[part], values[part]])
                np.savetxt(text, table, fmt=formats, delimiter=separator)
                file.write(text.getvalue().replace("nan", ""))
    except OSError as error:
        raise InputError(f"Cannot write ({error.strerror})", str(path), "name a file you may write") from None
