"""Cases: a folder with `case.toml` and the recordings that it names."""

import dataclasses
import hashlib
import math
import os
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.jax_config import require_x64
from snakejax.core.parameter import Domain
from snakejax.core.toml_table import Table, read_toml, require_filled_in
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.kinds import CASE_STRUCTURES, LABELS
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.vehicles.snakeboard.board import Board

from .annotations import ANNOTATION_KEYS, annotations_of
from .case_inputs import (
    Actuators,
    RawInputs,
    built_inputs,
    input_keys,
    log_clock,
    log_file,
    log_of,
    named_file,
    read_actuators,
    read_inputs,
    require_trackable,
)
from .case_vehicle import read_vehicle
from .file_runs import FILE_KEYS, Cut, cuts_of, files_of, recordings_of, require_differing, whole
from .quality import with_log_clock
from .readers import FEWEST_SAMPLES, PoseTrack, read_track
from .run import Case, NeededAccuracy, Noise, Run

ROLES = ("train", "heldout")
STARTS = ("rest", "moving")

CASE_KEYS = (
    "title",
    "skid",
    "area_m",
    "vehicle",
    "board",
    "noise",
    "accuracy",
    "search",
    "actuator",
    "runs",
)
NOISE_KEYS = {"position_m": "m", "heading_rad": "rad"}
CORRELATION = "correlation_s"
SEARCH_EXAMPLE = "[search] with criteria such as significance_level = 0.01"
ACCURACY_KEYS = {"position_m": "m", "heading_rad": "rad", "horizon_s": "s"}
PAYLOAD_KEYS = {"payload_kg": "kg", "payload_inertia_kgm2": "kg m^2"}
RUN_KEYS = (
    "name",
    "role",
    *LABELS,
    "mocap",
    "object",
    *ANNOTATION_KEYS,
    "joint_log",
    "window_s",
    *PAYLOAD_KEYS,
    "start",
)
"""Keys of a run beside those of its inputs."""

LABEL_EXAMPLES = {"group": "circles", "floor": "rubber", "day": "2024-09-04", "session": "morning"}

LOOSE_CLOCK = 0.5
"""A log whose clock is yet to be fitted may end so much [s] before the run."""


def load_case(folder: Path | str, *, to_train: bool = True) -> Case:
    """Read the case in `folder`; with `to_train`, require at least one train run.

    **Raises:** `InputError` for anything in it that cannot be used, with file, line and remedy.
    """
    require_x64()
    folder = Path(folder)
    table = read_toml(_case_file(folder))
    require_filled_in(table)
    table.require_known(CASE_KEYS)
    if "vehicle" in table.values:
        vehicle, constant_sd = read_vehicle(table)
        constraint = table.choice("skid", structures_of(vehicle))
    else:
        constraint = table.choice("skid", CASE_STRUCTURES)
        vehicle, constant_sd = read_vehicle(table)
    noise = _noise(table.table("noise", "[noise] with position_m and heading_rad")) if "noise" in table.values else None
    actuators = read_actuators(table, vehicle)
    rows = table.tables("runs", f'[[runs]] with role = "train", mocap, object, {_required_inputs(vehicle)}')
    _require_runs(rows, vehicle, to_train)
    runs, recordings, reading = _runs(rows, folder, vehicle, actuators)
    title = table.text("title", 'title = "..."') if "title" in table.values else folder.resolve().name
    area = _area(table) if "area_m" in table.values else None
    sha256 = _sha256(folder, rows)
    example = "[accuracy] with position_m, heading_rad and horizon_s"
    needed = _needed(table.table("accuracy", example)) if "accuracy" in table.values else None
    search = _search(table.table("search", SEARCH_EXAMPLE)) if "search" in table.values else {}
    name = folder.resolve().name
    known = Case(name, title, constraint, vehicle, runs, noise, sha256, area, reading, constant_sd, needed, search)
    return dataclasses.replace(known, recordings=recordings)


def _runs(
    rows: list[Table], folder: Path, vehicle: AbstractVehicle, actuators: Actuators
) -> tuple[tuple[Run, ...], tuple[Run, ...], dict[str, tuple[str, ...]]]:
    """The runs, the whole recordings, and what reading the files decided."""
    sources: list[_RunSource] = []
    reading: dict[str, tuple[str, ...]] = {}
    for row in rows:
        if "files" in row.values:
            new, notes = _of_files(row, folder, vehicle)
        else:
            track = _track(row, folder)
            new = [_RunSource(row, read_inputs(row, folder, vehicle), None, track)]
            notes = {_name(row): tuple(track.notes)} if track.notes else {}
        sources += new
        reading |= notes
    require_trackable([source.inputs for source in sources], [source.row for source in sources], actuators)
    gaits = built_inputs([source.inputs for source in sources], actuators, vehicle)
    every_run = [_run_of_source(source, folder, gait, vehicle) for source, gait in zip(sources, gaits, strict=True)]
    runs = tuple(run for run, source in zip(every_run, sources, strict=True) if source.is_fitted)
    recordings = tuple(run for run, source in zip(every_run, sources, strict=True) if source.is_recording)
    require_differing([run.name for run in runs], rows[0])
    return runs, recordings, reading


class _RunSource(NamedTuple):
    """What becomes a run: a `cut` of a file, or a `track` of its own; whether it is used in fits, and whether it is a
    whole recording."""

    row: Table
    inputs: RawInputs
    cut: Cut | None
    track: PoseTrack | None
    is_fitted: bool = True
    is_recording: bool = True


def _of_files(
    row: Table, folder: Path, vehicle: AbstractVehicle
) -> tuple[list[_RunSource], dict[str, tuple[str, ...]]]:
    """The windows of all files of a row and the whole of each, and what reading them found."""
    sources, reading = [], {}
    for recorded in recordings_of(row, folder, vehicle):
        cuts, entire = cuts_of(row, recorded), whole(recorded)
        is_whole_recording = len(cuts) == 1 and cuts[0].name == entire.name
        sources += [_RunSource(row, cut.inputs, cut, None, is_recording=is_whole_recording) for cut in cuts]
        if not is_whole_recording:
            sources.append(_RunSource(row, entire.inputs, entire, None, is_fitted=False))
        if recorded.notes:
            reading[recorded.name] = recorded.notes
    if not any(source.is_fitted for source in sources):
        raise row.error("files", "leaves no window in which the vehicle moves", "shorten windows, or leave them out")
    return sources, reading


def _run_of_source(source: _RunSource, folder: Path, gait: AbstractInputs, vehicle: AbstractVehicle) -> Run:
    """The run of a `source`, with its labels."""
    row = source.row
    labels = tuple((key, row.text(key, f'{key} = "{LABEL_EXAMPLES[key]}"')) for key in LABELS if key in row.values)
    if source.cut is None:
        assert source.track is not None
        return dataclasses.replace(_run(row, folder, source.track, gait, vehicle), labels=labels)
    cut = source.cut
    times, pose, payload = (jnp.asarray(part, jnp.float64) for part in (cut.times, cut.pose, _payload(row)))
    recording = cut.name.split("@")[0]
    run = Run(cut.name, row.values["role"], times, pose, gait, payload, True, labels=labels)
    return run if recording == cut.name else dataclasses.replace(run, cut_from=recording)


def _payload(row: Table) -> list[float]:
    domains = {key: Domain(unit, 0.0, math.inf, False, False) for key, unit in PAYLOAD_KEYS.items()}
    return [row.number(key, domain) if key in row.values else 0.0 for key, domain in domains.items()]


def _case_file(folder: Path) -> Path:
    path = folder / "case.toml"
    if folder.is_file():
        raise InputError("A case is a folder, but this is a file", str(folder), "give the folder with case.toml")
    if not folder.is_dir():
        raise InputError("There is no such folder", str(folder), "give the folder with case.toml")
    if not path.is_file():
        raise InputError("The folder has no case.toml", str(folder), "write one; `snakejax new` makes a template")
    return path


def _area(table: Table) -> tuple[float, float, float, float]:
    example = "area_m = [lowest x, lowest y, highest x, highest y]"
    left, below, right, above = table.vector("area_m", 4, example)
    if not (left < right and below < above):
        raise table.error(
            "area_m", f"is [{left:g}, {below:g}, {right:g}, {above:g}], which holds nothing", f"write {example}"
        )
    return left, below, right, above


def _noise(table: Table) -> Noise:
    table.require_known([*NOISE_KEYS, CORRELATION])
    numbers = [np.asarray(number) for number in _positive(table, NOISE_KEYS)]
    wanders = _positive(table, {CORRELATION: "s"})[0] if CORRELATION in table.values else None
    return Noise(*numbers, source="case.toml", correlation=wanders)


def _needed(table: Table) -> NeededAccuracy:
    table.require_known(ACCURACY_KEYS)
    return NeededAccuracy(*_positive(table, ACCURACY_KEYS))


def _search(table: Table) -> dict[str, float]:
    """The criteria of the search for effects; their names are known to the search alone."""
    return dict(zip(table.values, _positive(table, dict.fromkeys(table.values, "-")), strict=True))


def _positive(table: Table, units: dict[str, str]) -> list[float]:
    """The positive numbers at the keys of `units`."""
    return [table.number(key, Domain(unit, 0.0, math.inf, True, True)) for key, unit in units.items()]


def structures_of(vehicle: AbstractVehicle) -> tuple[str, ...]:
    """The structures that a case of `vehicle` may start from."""
    return CASE_STRUCTURES if isinstance(vehicle, Board) else tuple(vehicle.structures)


def _required_inputs(vehicle: AbstractVehicle) -> str:
    """The inputs that a run must have, in words."""
    names = [given.name for given in vehicle.inputs if given.follows is None]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _require_runs(rows: list[Table], vehicle: AbstractVehicle, to_train: bool) -> None:
    """**Raises:** `InputError` unless the keys and roles are known, the names differ, and, where there is something
    `to_train`, one run is to train on."""
    names: dict[str, str] = {}
    for row in rows:
        row.require_known((*RUN_KEYS, *FILE_KEYS, *input_keys(vehicle)))
        row.choice("role", ROLES)
        if "files" in row.values:
            for key in ("mocap", "name", "joint_log", "window_s", "start"):
                if key in row.values:
                    raise row.error(key, "stands beside files", "give it in rows with mocap only")
            continue
        for key in FILE_KEYS:
            if key in row.values:
                raise row.error(key, "stands without files", 'write files = "pattern" in place of mocap')
        stem = _name(row)
        if stem in names:
            what = f'has the same name "{stem}" as {names[stem]}: without `name`, a run has the name of its file'
            raise row.error("mocap", what, "rename one of the files, or set `name`")
        names[stem] = row.label
    if to_train and all(row.values["role"] != "train" for row in rows):
        raise rows[0].error(
            "role", 'is "heldout" in all runs: a fit needs a run with role = "train"', 'write role = "train"'
        )


def _name(row: Table) -> str:
    if "name" in row.values:
        return row.text("name", 'name = "first-lap"')
    return Path(row.text("mocap", 'mocap = "file.csv"')).stem


def _track(row: Table, folder: Path) -> PoseTrack:
    object = row.text("object", 'object = "subject:segment"')
    return read_track(named_file(row, "mocap", folder), object, annotations_of(row))


def _run(row: Table, folder: Path, track: PoseTrack, gait: AbstractInputs, vehicle: AbstractVehicle) -> Run:
    moving = "start" in row.values and row.choice("start", STARTS) == "moving"
    times, pose = track.times, track.pose
    if "window_s" in row.values:
        times, pose = _windowed(row, times, pose, 0.5 / track.rate, moving)
    times, pose, payload = (jnp.asarray(part, jnp.float64) for part in (times, pose, _payload(row)))
    run = Run(_name(row), row.values["role"], times, pose, gait, payload, moving)
    if "joint_log" not in row.values:
        return run
    log_times = log_of(row, folder, vehicle).times
    run = with_log_clock(run, log_clock(row), float(log_times[0]))
    _require_covered(row, folder, run, log_times, 1.0 / track.rate)
    return run


def _windowed(
    row: Table, times: np.ndarray, pose: np.ndarray, slack: float, moving: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The samples of the window. A run from rest keeps its frames before it, as lost: its time 0 stays its start."""
    example = "window_s = [first second, last second]"
    first, last = row.vector("window_s", 2, example)
    if not -slack <= first < last <= times[-1] + slack:
        what = f"is [{first:g}, {last:g}], but the run goes from 0 to {times[-1]:g} s"
        raise row.error("window_s", what, f"write {example} within the run")
    before, upto = times < first - slack, times <= last + slack
    pose = np.where(before[:, None], np.nan, pose)
    present = int(np.isfinite(pose[upto, 0]).sum())
    if present < FEWEST_SAMPLES:
        what = f"leaves {present} present samples, but at least {FEWEST_SAMPLES} are needed"
        raise row.error("window_s", what, "widen the window")
    kept = upto & ~before if moving else upto
    return times[kept], pose[kept]


def _require_covered(row: Table, folder: Path, run: Run, log_times: np.ndarray, slack: float) -> None:
    path, _ = log_file(row, folder)
    assert run.log is not None
    log = run.log.camera_times(log_times)
    # What is held lasts until the next sample.
    slack += float(np.median(np.diff(log_times))) if row.values["joint_log"].get("hold") else 0.0
    times = np.asarray(run.times) if run.moving else np.array([0.0, float(run.times[-1])])
    if run.log.free:
        slack += LOOSE_CLOCK
    if log[0] > times[0] + slack or log[-1] < times[-1] - slack:
        what = f"goes from {log[0]:g} to {log[-1]:g} s, but the run from {times[0]:g} to {times[-1]:g} s"
        raise row.error("joint_log", f"is shorter than the run: {path.name} {what}", "log it all, or set window_s")


def _sha256(folder: Path, rows: list[Table]) -> dict[str, str]:
    logs = [row.values["joint_log"]["file"] for row in rows if "joint_log" in row.values]
    files = [str(os.path.relpath(p, folder)) for row in rows if "files" in row.values for p in files_of(row, folder)]
    names = ["case.toml", *(row.values["mocap"] for row in rows if "mocap" in row.values), *files, *logs]
    return {name: _digest(folder / name) for name in names}


def _digest(path: Path) -> str:
    """The SHA-256 of a file, or of the files of a folder one after the other by name, as a ROS 2 bag has them."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    digest = hashlib.sha256()
    for name in files:
        with name.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
