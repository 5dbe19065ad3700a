"""A recording as it is, made a case: copied, and described in case.toml as far as the file can tell."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError
from snakejax.core.toml_table import read_toml
from snakejax.dynamics.vehicle_input import Input
from snakejax.vehicles.registry import VEHICLES, vehicle_class
from snakejax.vehicles.snakeboard.board import Board

from .case_template import BLANK, filled, toml_string
from .readers import Capture, FileAnnotations, pose_track, write_csv
from .readers.marker_template import board_places, shape_of
from .readers.planar_pose import fitted, subjects, up_by
from .readers.rotations import upright

LONG_GAP = 0.1
"""A gap of joint angles [s] above which the interpolation is reported: ten frames at 100 Hz."""
CONVERTED = ("ROS bag",)


class JointObjects(NamedTuple):
    """The objects, by name, whose headings against the board's are the angles of its joints."""

    rotor: str | None = None
    front: str | None = None
    back: str | None = None


class ImportRequest(NamedTuple):
    """What a user says of a run: the object, its role, what the file does not say, its joints or its gait as TOML.

    Where the file gives the object no name, it is what the user has `called` it.
    """

    object: str
    role: str
    hints: FileAnnotations
    joints: JointObjects = JointObjects()
    gait: Mapping[str, str] = {}
    called: str = ""


def places_of(
    capture: Capture, names: Sequence[str], front: Sequence[str], back: Sequence[str], up: str | Sequence[float]
) -> dict[str, list[float]]:
    """Where the markers `names` sit on the board, in m, of which those in `front` and `back` lie at its two ends.

    **Raises:** `InputError` where they keep no shape, or an end is not among them.
    """
    where = capture.where
    for name in (*front, *back):
        if name not in names:
            raise InputError(f'There is no marker "{name}"', where, f"the markers are {', '.join(names)}")
    turn = upright(up)
    points = np.stack([capture.markers[name] for name in names], axis=1) @ turn.T
    shape = shape_of(points)
    if shape is None:
        remedy = "leave out those that are rarely seen, with --markers"
        raise InputError("Some of the markers are never seen together", where, remedy)
    indices = [[names.index(name) for name in end] for end in (front, back)]
    places = board_places(points, shape, np.array([0.0, 0.0, 1.0]), *indices)
    if places is None:
        raise InputError("The front and the back are one place", where, "name markers that are apart")
    return {name: [round(float(x), 5) for x in place] for name, place in zip(names, places, strict=True)}


def joint_table(capture: Capture, request: ImportRequest) -> tuple[list[str], Float[np.ndarray, "n c"]]:
    """The columns of a joint log and its rows: times [s] from the board's first frame, and the headings of the joints'
    objects against the board's. The rotor's angle counts from its first value, and so does that of a wheelset with
    markers alone; the angle of one with a pose is as it was tracked.

    **Raises:** `InputError` where an object is not there, or one of rotor and front wheelset is missing.
    """
    joints = request.joints
    if joints.rotor is None or joints.front is None:
        what = "A joint log needs the rotor and the front wheelset"
        raise InputError(what, "options --rotor and --front-wheelset", "name both objects, or neither and give a gait")
    board = pose_track(capture, request.object, request.hints)
    start = _start(capture, request)
    complete = np.isfinite(board.pose[:, 2])
    columns = {"time_s": board.times}
    named = {"phi_rad": joints.front, "psi_rad": joints.rotor, "phi_back_rad": joints.back}
    for column, name in named.items():
        if name is None:
            continue
        other = pose_track(capture, name, request.hints._replace(markers=_joint_markers(capture, name, request.hints)))
        tracked = np.isfinite(other.pose[:, 2])
        clock = other.times + _start(capture, request._replace(object=name)) - start
        heading = np.interp(board.times, clock[tracked], other.pose[tracked, 2], np.nan, np.nan)
        # No angle is made up in a frame in which its object was lost.
        heading[~np.interp(board.times, clock, tracked.astype(float), 0.0, 0.0).astype(bool)] = np.nan
        angle = heading - board.pose[:, 2]
        complete &= np.isfinite(angle)
        columns[column] = angle
    if not complete.any():
        raise InputError("The joints are never seen with the board", capture.where, "check the names of their objects")
    table = np.column_stack([*columns.values()])[complete]
    for i, name in enumerate(columns):
        if name == "psi_rad" or (name in named and named[name] not in capture.bodies):
            table[:, i] -= table[0, i]
        elif name != "time_s":
            table[:, i] -= 2 * np.pi * np.round(table[0, i] / (2 * np.pi))
    return [*columns], table


def _joint_markers(capture: Capture, name: str, hints: FileAnnotations) -> dict[str, list[float]] | None:
    """Places for the markers of a joint that is no body: its own shape, lying level, turned anyhow."""
    names = subjects(capture).get(name, [])
    if name in capture.bodies or len(names) < 2:
        return None
    if len(names) > 2:
        return places_of(capture, names, names[:1], names[1:2], up_by(capture, hints))
    half = float(np.nanmedian(np.linalg.norm(capture.markers[names[0]] - capture.markers[names[1]], axis=1))) / 2
    return {names[0]: [half, 0.0, 0.0], names[1]: [-half, 0.0, 0.0]}


def _start(capture: Capture, request: ImportRequest) -> float:
    body = capture.bodies.get(request.object) or capture.bodies.get("")
    return float((capture.times if body is None else body.times)[0])


def add_run(
    folder: Path, capture: Capture, request: ImportRequest, title: str, board: Mapping[str, float]
) -> list[str]:
    """Put the recording into the case `folder`, made where it is not there; what a user should know.

    The file is copied as it is; a ROS bag as a table of the object alone. Where a run is under way in `case.toml`, the
    new one is added at its end.

    **Raises:** `InputError` where a file is in the way, the object cannot be read, or the folder not written.
    """
    notes: list[str] = []
    source = capture.path
    name = f"{source.stem}.csv" if capture.format in CONVERTED else source.name
    target, case = folder / name, folder / "case.toml"
    log = folder / f"{source.stem}-joints.csv"
    tracked = any(request.joints)
    for path in (target, log) if tracked else (target,):
        if path.exists():
            raise InputError(f"{path.name} already exists", str(folder), "rename the recording")
    ready = request.object in capture.bodies or "" in capture.bodies or request.hints.markers is not None
    if ready:
        pose_track(capture, request.object, request.hints)  # or complains
    if ready and request.hints.markers is not None and request.object not in capture.bodies:
        placed = fitted(capture, request.object, request.hints)[1]
        usual = 1e3 * float(np.nanmedian(placed.residual))
        notes.append(f"markers lie {usual:.2f} mm from their places on the board; in {placed.swapped} frames labels ")
        notes[-1] += f"were swapped back, in {placed.left_out} one was left out, {placed.lost} frames are lost"
    joints = joint_table(capture, request) if tracked and ready else None
    text = _run_text(name, request, log.name if joints else None, capture, _inputs_of(case))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if capture.format in CONVERTED:
            write_csv(capture, target, [request.object], request.hints)
        elif source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copyfile(source, target)
        if joints:
            header, table = joints
            np.savetxt(log, table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")
            gap = float(np.diff(table[:, 0]).max()) if len(table) > 1 else 0.0
            if gap > LONG_GAP:
                notes.append(f"the joints have a gap of {gap:.2f} s, over which their log is interpolated")
        if case.exists():
            with case.open("a", encoding="utf-8") as file:
                file.write("\n" + text)
        else:
            case.write_text(filled(title, board, [text]), encoding="utf-8")
    except OSError as error:
        where = str(error.filename or folder)
        raise InputError(f"Cannot write ({error.strerror})", where, "name a folder you may write to") from None
    return notes


def _inputs_of(case: Path) -> Sequence[Input]:
    """The inputs of the vehicle of a case; those of a snakeboard where it is still to be written."""
    vehicle = read_toml(case).values.get("vehicle") if case.exists() else None
    kind = vehicle.get("kind") if isinstance(vehicle, dict) else None
    return vehicle_class(kind).inputs if kind in VEHICLES else Board.inputs


def _run_text(name: str, request: ImportRequest, log: str | None, capture: Capture, inputs: Sequence[Input]) -> str:
    # What was converted says all but where the axes of the object point.
    hints = request.hints if capture.format not in CONVERTED else FileAnnotations(x_axis=request.hints.x_axis)
    lines = ["[[runs]]", f'role = "{request.role}"', f"mocap = {toml_string(name)}"]
    lines += [f"object = {toml_string(request.object or request.called or 'board')}"]
    if hints.columns:
        lines.append(f"columns = {_inline({key: toml_string(column) for key, column in hints.columns.items()})}")
    if hints.units:
        lines.append(f"units = {_inline({key: toml_string(unit) for key, unit in hints.units.items()})}")
    if hints.up is not None:
        lines.append(f"up = {toml_string(hints.up) if isinstance(hints.up, str) else list(hints.up)}")
    elif capture.up_open:
        lines.append(f'up = {BLANK}  # the axis that points up: "y" or "z"')
    if hints.x_axis != "forward":
        lines.append(f'x_axis = "{hints.x_axis}"')
    if hints.angles is not None:
        lines.append(f'angles = "{hints.angles}"')
    if hints.markers:
        lines.append(f"markers = {_inline({key: str(list(place)) for key, place in hints.markers.items()})}")
    elif request.object in subjects(capture) and request.object not in capture.bodies:
        lines.append(
            f"markers = {BLANK}  # where they sit on the board: {{name = [x, y, z], ...}} in m from its middle"
        )
    if log:
        lines.append(f'joint_log = {{file = {toml_string(log)}, kind = "measured"}}')
    else:
        for one in inputs:
            given = request.gait.get(one.name)
            example = f"[[amplitude {one.unit}, angular frequency rad/s, phase rad], ...]"
            if given:
                lines.append(f"{one.name} = {given}")
            elif one.follows is None:
                lines.append(f"{one.name} = {BLANK}  # commanded {one.label.replace('_', ' ')}: {example}")
    return "\n".join(lines) + "\n"


def _inline(values: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{toml_string(key)} = {value}" for key, value in values.items()) + "}"
