"""Cases: a folder with `case.toml` and the recordings that it names."""

import dataclasses
import difflib
import hashlib
import math
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.jax_config import require_x64
from snakejax.core.parameter import Domain
from snakejax.core.toml_table import Table, read_toml, require_filled_in
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.kinds import CASE_STRUCTURES
from snakejax.dynamics.signals import AbstractSignal, Logged, Sines, Tracked
from snakejax.vehicles.snakeboard.board import Board

from .annotations import ANNOTATION_KEYS, annotations_of
from .quality import smoothed, with_log_clock
from .readers import FEWEST_SAMPLES, PoseTrack, read_joint_log, read_track
from .run import Case, LogClock, NeededAccuracy, Noise, Run

ROLES = ("train", "heldout")
STARTS = ("rest", "moving")
KINDS = ("commanded", "measured")

CASE_KEYS = ("title", "skid", "area_m", "board", "noise", "accuracy", "search", "actuator", "runs")
BOARD_KEYS = {
    "mass_kg": "mass",
    "rotor_inertia_kgm2": "rotor_inertia",
    "wheelset_inertia_kgm2": "wheelset_inertia",
    "half_length_m": "half_length",
    "creep_speed_mps": "creep_speed",
    "inertia_kgm2": "inertia",
}
CONSTANT_SD_KEYS = {
    "mass_sd_kg": "mass",
    "half_length_sd_m": "half_length",
    "inertia_sd_kgm2": "inertia",
    "rotor_inertia_sd_kgm2": "rotor_inertia",
}
NOISE_KEYS = {"position_m": "m", "heading_rad": "rad"}
CORRELATION = "correlation_s"
SEARCH_EXAMPLE = "[search] with criteria such as significance_level = 0.01"
ACCURACY_KEYS = {"position_m": "m", "heading_rad": "rad", "horizon_s": "s"}
ACTUATOR_KEYS = ("kp", "kd")
PAYLOAD_KEYS = {"payload_kg": "kg", "payload_inertia_kgm2": "kg m^2"}
JOINT_LOG_KEYS = ("file", "kind", "offset_s", "drift")
ESTIMATE = "estimate"
JOINTS = ("phi", "psi", "phi_back")
RUN_KEYS = ("role", "mocap", "object", *ANNOTATION_KEYS, *JOINTS, "joint_log", "window_s", *PAYLOAD_KEYS, "start")

LOOSE_CLOCK = 0.5
"""A log whose clock is yet to be fitted may end so much [s] before the run."""

_RUNS = '[[runs]] with role = "train", mocap, object, phi and psi'
_JOINT_LOG = 'joint_log = {file = "joints.csv", kind = "commanded"}'


class _Joints(NamedTuple):
    """The angles of the joints of one run before any controller; `exact` where they were measured."""

    phi: Sines | Logged
    psi: Sines | Logged
    phi_back: Sines | Logged | None
    exact: bool


def load_case(folder: Path | str) -> Case:
    """The case in `folder`, as its `case.toml` says.

    **Raises:** `InputError` for anything in it that cannot be used, with file, line and remedy.
    """
    require_x64()
    folder = Path(folder)
    table = read_toml(_case_file(folder))
    require_filled_in(table)
    table.require_known(CASE_KEYS)
    constraint = table.choice("skid", CASE_STRUCTURES)
    measures = table.table("board", "[board] with mass_kg and the other measures")
    board, constant_sd = _board(measures), _constant_sd(measures)
    noise = _noise(table.table("noise", "[noise] with position_m and heading_rad")) if "noise" in table.values else None
    gains = _gains(table.table("actuator", "[actuator] with kp and kd")) if "actuator" in table.values else None
    rows = table.tables("runs", _RUNS)
    _require_runs(rows)
    gaits = _gaits([_joints(row, folder) for row in rows], gains)
    tracks = [_track(row, folder) for row in rows]
    runs = tuple(_run(row, folder, track, gait) for row, track, gait in zip(rows, tracks, gaits, strict=True))
    reading = {run.name: tuple(track.notes) for run, track in zip(runs, tracks, strict=True) if track.notes}
    title = table.text("title", 'title = "..."') if "title" in table.values else folder.resolve().name
    area = _area(table) if "area_m" in table.values else None
    sha256 = _sha256(folder, rows)
    example = "[accuracy] with position_m, heading_rad and horizon_s"
    needed = _needed(table.table("accuracy", example)) if "accuracy" in table.values else None
    search = _search(table.table("search", SEARCH_EXAMPLE)) if "search" in table.values else {}
    name = folder.resolve().name
    return Case(name, title, constraint, board, runs, noise, sha256, area, reading, constant_sd, needed, search)


def _case_file(folder: Path) -> Path:
    path = folder / "case.toml"
    if folder.is_file():
        raise InputError("A case is a folder, but this is a file", str(folder), "give the folder with case.toml")
    if not folder.is_dir():
        raise InputError("There is no such folder", str(folder), "give the folder with case.toml")
    if not path.is_file():
        raise InputError("The folder has no case.toml", str(folder), "write one; `snakejax new` makes a template")
    return path


def _board(table: Table) -> Board:
    table.require_known([*BOARD_KEYS, *CONSTANT_SD_KEYS])
    keys = [key for key in BOARD_KEYS if key != "inertia_kgm2" or key in table.values]
    board = Board(**{BOARD_KEYS[key]: table.number(key, _domain(Board, BOARD_KEYS[key])) for key in keys})
    joints = float(board.rotor_inertia + 2 * board.wheelset_inertia)
    if float(board.total_inertia) <= joints:
        key = "inertia_kgm2" if board.inertia is not None else "half_length_m"
        what = f"makes the total inertia {float(board.total_inertia):g} kg m^2, not above {joints:g} of the joints"
        raise table.error(key, what, "give inertia_kgm2 with the rotor and the wheelsets in it")
    return board


def _constant_sd(table: Table) -> dict[str, float]:
    """The standard deviations of constants that are stated, by the field of the board."""
    stated = {key: field for key, field in CONSTANT_SD_KEYS.items() if key in table.values}
    domains = {field: Domain(_domain(Board, field).unit, 0.0, math.inf, True, True) for field in stated.values()}
    return {field: table.number(key, domains[field]) for key, field in stated.items()}


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


def _gains(table: Table) -> dict[str, float]:
    table.require_known(ACTUATOR_KEYS)
    return {key: table.number(key, _domain(Tracked, key)) for key in ACTUATOR_KEYS}


def _domain(cls: type, field: str) -> Domain:
    return next(f.metadata["domain"] for f in dataclasses.fields(cls) if f.name == field)


def _require_runs(rows: list[Table]) -> None:
    """**Raises:** `InputError` unless the keys and roles are known, the names differ, and one run is to train on."""
    names: dict[str, str] = {}
    for row in rows:
        row.require_known(RUN_KEYS)
        row.choice("role", ROLES)
        stem = _name(row)
        if stem in names:
            what = f'has the stem "{stem}", as has {names[stem]}: a stem names its run'
            raise row.error("mocap", what, "rename one of the files")
        names[stem] = row.label
    if all(row.values["role"] != "train" for row in rows):
        raise rows[0].error("role", 'is "heldout", as in all the runs: no run is to train on', 'write role = "train"')


def _name(row: Table) -> str:
    return Path(row.text("mocap", 'mocap = "file.csv"')).stem


def _file(table: Table, key: str, folder: Path) -> Path:
    name = table.text(key, f'{key} = "file.csv"')
    path = folder / name
    if not path.exists():
        files = sorted(p.relative_to(folder).as_posix() for p in folder.iterdir() if p.name != "case.toml")
        close = difflib.get_close_matches(name, files, 1)
        remedy = f'write "{close[0]}" or add the file' if close else "add the file or correct its name"
        raise table.error(key, f'names "{name}", but there is no such file', remedy)
    return path


def _log_file(row: Table, folder: Path) -> tuple[Path, str]:
    log = row.table("joint_log", _JOINT_LOG)
    log.require_known(JOINT_LOG_KEYS)
    return _file(log, "file", folder), log.choice("kind", KINDS)


def _joints(row: Table, folder: Path) -> _Joints:
    if "joint_log" in row.values:
        path, kind = _log_file(row, folder)
        times, *angles = read_joint_log(path)
        clock = _log_clock(row)
        cameras = clock.camera_times(times)
        # A joint is accelerated from rest; a command may jump.
        measured = kind == "measured"
        smoothed_angles = [None if angle is None else smoothed(cameras, angle, starts=measured) for angle in angles]
        return _Joints(
            *(None if part is None else Logged.of(cameras, *part) for part in smoothed_angles), exact=measured
        )
    keys = [key for key in JOINTS if key != "phi_back" or key in row.values]
    signals = [Sines.of(row.numbers(key, 3, f"{key} = [[amplitude, frequency, phase], ...]")) for key in keys]
    return _Joints(*signals, *[None] * (len(JOINTS) - len(keys)), exact=False)


def _log_clock(row: Table) -> LogClock:
    """What `case.toml` says of the log's clock; what it says "estimate" for is 0 and free."""
    log = row.table("joint_log", _JOINT_LOG)
    free = tuple(key for key in ("offset_s", "drift") if log.values.get(key) == ESTIMATE)
    domains = {
        "offset_s": Domain("s", -math.inf, math.inf, False, False),
        "drift": Domain("-", -0.1, 0.1, False, False),
    }
    known = {key: log.number(key, d) for key, d in domains.items() if key in log.values and key not in free}
    names = tuple(key.removesuffix("_s") for key in free)
    return LogClock(known.get("offset_s", 0.0), known.get("drift", 0.0), free=names)


def _gaits(joints: list[_Joints], gains: dict[str, float] | None) -> list[Gait]:
    """The gaits of all runs, alike in structure so that runs batch: as many sines, and a back steering all or none."""
    if any(j.phi_back is not None for j in joints):
        joints = [j if j.phi_back is not None else j._replace(phi_back=_opposite(j.phi)) for j in joints]
    sines = [s.amplitude.shape[0] for j in joints for s in j[: len(JOINTS)] if isinstance(s, Sines)]

    def driven(signal: Sines | Logged | None, exact: bool) -> AbstractSignal | None:
        if isinstance(signal, Sines):
            signal = signal.padded(max(sines))
        return signal if signal is None or exact or gains is None else Tracked(signal, **gains)

    return [Gait(*(driven(signal, j.exact) for signal in j[: len(JOINTS)])) for j in joints]


def _opposite(signal: Sines | Logged) -> Sines | Logged:
    if isinstance(signal, Logged):
        return dataclasses.replace(signal, coefficients=-signal.coefficients)
    return Sines(-signal.amplitude, signal.frequency, signal.phase)


def _track(row: Table, folder: Path) -> PoseTrack:
    object = row.text("object", 'object = "subject:segment"')
    return read_track(_file(row, "mocap", folder), object, annotations_of(row))


def _run(row: Table, folder: Path, track: PoseTrack, gait: Gait) -> Run:
    moving = "start" in row.values and row.choice("start", STARTS) == "moving"
    times, pose = track.times, track.pose
    if "window_s" in row.values:
        times, pose = _windowed(row, times, pose, 0.5 / track.rate, moving)
    domains = {key: Domain(unit, 0.0, math.inf, False, False) for key, unit in PAYLOAD_KEYS.items()}
    payload = [row.number(key, domain) if key in row.values else 0.0 for key, domain in domains.items()]
    times, pose, payload = (jnp.asarray(part, jnp.float64) for part in (times, pose, payload))
    run = Run(_name(row), row.values["role"], times, pose, gait, payload, moving)
    if "joint_log" not in row.values:
        return run
    run = with_log_clock(run, _log_clock(row), float(read_joint_log(_log_file(row, folder)[0]).times[0]))
    _require_covered(row, folder, run, 1.0 / track.rate)
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


def _require_covered(row: Table, folder: Path, run: Run, slack: float) -> None:
    path, _ = _log_file(row, folder)
    assert run.log is not None
    log = run.log.camera_times(read_joint_log(path).times)
    times = np.asarray(run.times) if run.moving else np.array([0.0, float(run.times[-1])])
    if run.log.free:
        slack += LOOSE_CLOCK
    if log[0] > times[0] + slack or log[-1] < times[-1] - slack:
        what = f"goes from {log[0]:g} to {log[-1]:g} s, but the run from {times[0]:g} to {times[-1]:g} s"
        raise row.error("joint_log", f"is shorter than the run: {path.name} {what}", "log it all, or set window_s")


def _sha256(folder: Path, rows: list[Table]) -> dict[str, str]:
    logs = [row.values["joint_log"]["file"] for row in rows if "joint_log" in row.values]
    names = ["case.toml", *(row.values["mocap"] for row in rows), *logs]
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
