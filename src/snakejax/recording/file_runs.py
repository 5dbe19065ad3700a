"""Runs from whole files: `[[runs]] files = "pattern"`, each file a recording that is cut into short windows."""

import glob
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.parameter import Domain
from snakejax.core.toml_table import Table
from snakejax.dynamics.sampled_signals import AHEAD, HISTORY, Held, samples_between
from snakejax.dynamics.signals import Logged
from snakejax.dynamics.vehicle import AbstractVehicle

from .annotations import annotations_of
from .case_inputs import KINDS, RawInputs, Signal
from .continuous import LEAST_MOTION, chosen_windows, jumps, mean_speed
from .quality import smoothed
from .readers import FEWEST_SAMPLES, FileAnnotations, PoseTrack, read_capture
from .readers.capture import X_AXIS_DIRECTIONS, Body
from .readers.planar_pose import body_of, planar, up_by
from .readers.table_inputs import ENABLE, STAMP, TableInputs, input_columns, read_table, table_inputs

FILE_KEYS = ("files", "inputs", "kind", "windows", "each")
WINDOW_KEYS = ("length_s", "most", "rate_hz")
FILES_EXAMPLE = 'files = "0909_*.csv"'
WINDOWS_EXAMPLE = "windows = {length_s = 1.5, most = 20}"
USUAL_LENGTH, USUAL_MOST = 1.5, 20
COASTING = 1.0
"""A vehicle that moves longer than this [s] after its safety went off is carried, or creeps."""


class Recorded(NamedTuple):
    """One recording: its `name`, the motion seen, the inputs on its clock, and what reading it found."""

    name: str
    track: PoseTrack
    inputs: TableInputs
    measured: bool
    notes: tuple[str, ...]


class PoseReading(NamedTuple):
    """How the poses of a file are read: what points `up`, the user's `hints`, and which `object` is the vehicle."""

    up: str | Sequence[float]
    hints: FileAnnotations
    object: str


class Cut(NamedTuple):
    """A window of a recording, or the whole: `times` [s] (n,) from 0, `pose` (n, 3), and its inputs on that clock."""

    name: str
    times: np.ndarray
    pose: np.ndarray
    inputs: RawInputs


def files_of(row: Table, folder: Path) -> list[Path]:
    """The files that match the pattern, or list of patterns, of a row. **Raises:** `InputError` where one has none."""
    value = row.get("files", FILES_EXAMPLE)
    patterns = value if isinstance(value, list) else [value]
    if not patterns or not all(isinstance(pattern, str) and pattern for pattern in patterns):
        raise row.error("files", "must be a pattern or a list of patterns", f"write {FILES_EXAMPLE}")
    names: dict[str, None] = {}
    for pattern in patterns:
        matches = sorted(name for name in glob.glob(pattern, root_dir=folder) if (folder / name).is_file())
        if not matches:
            raise row.error("files", f'"{pattern}" matches no file', "correct the pattern or add the files")
        names |= dict.fromkeys(matches)
    return [folder / name for name in names]


def recordings_of(row: Table, folder: Path, vehicle: AbstractVehicle) -> list[Recorded]:
    """All recordings of a row. **Raises:** `InputError` with file, line and remedy."""
    kind = row.choice("kind", KINDS) if "kind" in row.values else KINDS[0]
    hints = annotations_of(row)
    named_columns = row.texts("inputs", 'inputs = {steer = "steering"}') if "inputs" in row.values else {}
    known = [one.name for one in vehicle.inputs]
    if "inputs" in row.values:
        row.table("inputs", "").require_known([*known, STAMP, ENABLE])
    recordings = []
    for path in files_of(row, folder):
        text = read_table(path)
        columns = input_columns(text, named_columns, vehicle.inputs)
        each = row.text("each", 'each = "window"') if "each" in row.values else None
        table = text.columns([*columns.values(), *([each] if each else [])])
        capture = read_capture(path, hints)
        object = row.text("object", 'object = "car"') if "object" in row.values else next(iter(capture.bodies), "")
        body, up = body_of(capture, object, hints), up_by(capture, hints)
        if len(body.times) != len(next(iter(table.values()))):
            raise InputError("Poses and inputs have not the same rows", str(path), "write one row for each frame")
        reading = PoseReading(up, hints, object)
        labels = table[each] if each else np.zeros(len(body.times))
        for label in dict.fromkeys(labels.tolist()):
            rows = np.flatnonzero(labels == label)
            name = f"{path.stem}[{label:g}]" if each else path.stem
            part = {key: values[rows] for key, values in table.items()}
            try:
                recordings.append(_recorded(name, _rows(body, rows), part, columns, reading, vehicle, kind))
            except InputError:
                raise
            except ValueError as error:
                raise InputError(f"{name} {error}", str(path), "leave this file out") from None
    return recordings


def _rows(body: Body, rows: np.ndarray) -> Body:
    heading = None if body.heading is None else body.heading[rows]
    return Body(body.times[rows], body.position[rows], body.rotation[rows], body.where, heading)


def _recorded(
    name: str,
    body: Body,
    table: Mapping[str, np.ndarray],
    columns: Mapping[str, str],
    reading: PoseReading,
    vehicle: AbstractVehicle,
    kind: str,
) -> Recorded:
    """One recording from rows of a table, its frames in order, without those in which the vehicle was carried."""
    notes = []
    kept = np.concatenate([[True], np.diff(np.maximum.accumulate(body.times)) > 0])
    if not kept.all():
        notes.append(f"{int((~kept).sum())} frames came out of order and are left out")
    arrival = body.times[kept]
    messages = table_inputs({k: v[kept] for k, v in table.items()}, columns, arrival, vehicle.inputs)
    track = planar(_rows(body, np.flatnonzero(kept)), reading.up, None, reading.object)
    pose = track.pose - np.array([0.0, 0.0, X_AXIS_DIRECTIONS[reading.hints.x_axis]])
    messages = messages._replace(times=messages.times - arrival[0])
    carried = _carried(track.times, pose, messages)
    if carried.any():
        pose[carried] = np.nan
        notes.append(f"in {np.mean(carried):.0%} of the frames it moves with the safety off: they are left out")
    gaps = np.diff(track.times)
    if gaps.max() > 0.1:
        notes.append(f"gaps of up to {gaps.max():.2f} s")
    if at := jumps(track.times, pose):
        notes.append(f"the pose jumps at {', '.join(f'{t:.1f}' for t in at[:4])} s; windows end there")
    return Recorded(name, track._replace(pose=pose), messages, kind == "measured", (*messages.notes, *notes))


def _carried(times: np.ndarray, pose: np.ndarray, messages: TableInputs) -> np.ndarray:
    """The frames more than `COASTING` after the safety went off, until it is on again, where the vehicle moves."""
    k = np.clip(np.searchsorted(messages.times, times, side="right") - 1, 0, len(messages.times) - 1)
    on = messages.enabled[k]
    if on.all() or not on.any():
        return np.zeros(len(times), bool)
    last_on = np.maximum.accumulate(np.where(on, times, -math.inf))
    off = times - last_on > COASTING
    carried = np.zeros(len(times), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]]).astype(int)))
    for a, b in edges.reshape(-1, 2):
        if b - a > 2 and np.isfinite(pose[a:b]).all() and mean_speed(times[a:b], pose[a:b]) > LEAST_MOTION / 5:
            carried[a:b] = True
    return carried


def cuts_of(row: Table, recorded: Recorded) -> list[Cut]:
    """The windows of a recording that a row asks for; the whole of one of several in a file."""
    table = row.table("windows", WINDOWS_EXAMPLE) if "windows" in row.values else None
    if table is None and "each" in row.values:
        return [whole(recorded)]
    length, most, rate = USUAL_LENGTH, USUAL_MOST, None
    if table is not None:
        table.require_known(WINDOW_KEYS)
        positive = {
            key: Domain(unit, 0.0, math.inf, True, True) for key, unit in (("length_s", "s"), ("rate_hz", "Hz"))
        }
        length = table.number("length_s", positive["length_s"]) if "length_s" in table.values else length
        rate = table.number("rate_hz", positive["rate_hz"]) if "rate_hz" in table.values else None
        count = Domain("windows", 1.0, math.inf, False, True)
        most = int(table.number("most", count)) if "most" in table.values else most
    track = recorded.track
    step = 1 if rate is None else max(1, round(track.rate / rate))
    inputs = recorded.inputs.times, recorded.inputs.values
    chosen = chosen_windows(track.times, track.pose, inputs, length, most)
    cuts = [_cut(recorded, frames[::step]) for frames in chosen]
    if short := [cut for cut in cuts if len(cut.times) < FEWEST_SAMPLES]:
        what = f"leaves {len(short[0].times)} samples in a window, but at least {FEWEST_SAMPLES} are needed"
        raise row.error("windows", what, "write a longer length_s or a higher rate_hz")
    return cuts


def whole(recorded: Recorded) -> Cut:
    """The whole recording."""
    track = recorded.track
    return Cut(recorded.name, track.times, track.pose, _signals(recorded, 0.0, -math.inf, math.inf))


def _cut(recorded: Recorded, frames: np.ndarray) -> Cut:
    track = recorded.track
    start, end = float(track.times[frames[0]]), float(track.times[frames[-1]])
    inputs = _signals(recorded, start, start - HISTORY, end + AHEAD)
    return Cut(f"{recorded.name}@{start:.2f}", track.times[frames] - start, track.pose[frames], inputs)


def _signals(recorded: Recorded, zero: float, first: float, last: float) -> RawInputs:
    """The inputs from `first` to `last` [s], on a clock that starts at `zero`."""
    times = recorded.inputs.times
    kept = samples_between(times, first, last, fewest=4)
    signals: dict[str, Signal] = {}
    for name, values in recorded.inputs.values.items():
        at, value = times[kept] - zero, values[kept]
        if recorded.measured:
            signals[name] = Logged.of(at, *smoothed(at, value))
        else:
            # A sample that repeats the last one changes nothing, and a simulation need not stop there.
            changes = np.concatenate([[True], np.diff(value) != 0])
            signals[name] = Held.of(at[changes], value[changes])
    return RawInputs(signals, exact=recorded.measured)


def require_differing(names: Sequence[str], row: Table) -> None:
    """**Raises:** `InputError` where two runs have one name."""
    if len(set(names)) < len(names):
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise row.error("files", f'names "{twice}" twice', "let each file match one pattern only")
