"""A board as a case folder: case.toml and one Vicon Tracker file a run, and beside it the key to what it hides."""

import json
from pathlib import Path

import numpy as np
from boards import KINDS, SETS
from hidden import Hidden, Run
from layout import EFFECTS, STRANGE


def measured(board: Hidden, group: str) -> dict[str, np.ndarray]:
    """What motion capture sees in each run, (n, 3): the same on every call."""
    kind, number = board.name.split("-")[:2]
    found = {}
    for k, run in enumerate(board.runs):
        rng = np.random.default_rng([SETS[group], list(KINDS).index(kind), int(number), 1 + k])
        found[run.name] = run.path(board.values) + board.noise.draw(rng, run.times)
    return found


def write(board: Hidden, group: str, cases: Path, keys: Path) -> Path:
    """Write the case into `cases` and its key into `keys`, and return the folder of the case."""
    folder = cases / board.name
    folder.mkdir(parents=True, exist_ok=True)
    keys.mkdir(parents=True, exist_ok=True)
    for run, pose in zip(board.runs, measured(board, group).values(), strict=True):
        (folder / f"{run.name}.csv").write_text(_tracker(run, pose, board.stated["L"] / 0.25))
    (keys / f"{board.name}.json").write_text(json.dumps(key(board), indent=1) + "\n")
    (folder / "case.toml").write_text(_toml(board))
    return folder


def key(board: Hidden) -> dict:
    """What the board hides, in the names of effects.md."""
    values = board.values
    hidden = [name for name in (board.strong, *board.weak) if name]
    return {
        "case": board.name,
        "kind": board.name.split("-")[0],
        "strong": board.strong,
        "weak": list(board.weak),
        "strange": board.strange,
        "effects": {n: {p: values[f"{n}.{p}"] for p in EFFECTS.get(n, ()) if f"{n}.{p}" in values} for n in hidden},
        "stranger": {p: values[f"{board.strange}.{p}"] for p in STRANGE.get(board.strange or "", ())},
        "tyre": {n: values[n] for n in "BCDE"},
        "constants": {n: values[n] for n in ("m", "I", "Jr", "L")},
        "off": {n: values[n] / board.stated[n] - 1 for n in ("m", "I", "Jr", "L")},
        "odd": {run.name: run.odd for run in board.runs if run.odd},
        "noise": {"white": board.noise.white, "wander": board.noise.wander, "correlation_s": board.noise.correlation},
    }


def _tracker(run: Run, pose: np.ndarray, length: float) -> str:
    """Vicon Tracker's export of the poses: mm, and the heading in [-pi, pi); tilt and height are noise alone."""
    rng = np.random.default_rng(len(run.name))
    tilt, height = 1e-3 * rng.normal(size=(len(pose), 2)), length * (62.0 + 0.3 * rng.normal(size=len(pose)))
    heading = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    head = [
        "Objects",
        f"{1 / (run.times[1] - run.times[0]):.0f}",
        ",,Global Angle board:board,,,,,",
        "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ",
        ",,rad,rad,rad,mm,mm,mm",
    ]
    rows = [
        f"{k + 1},0,{rx:.6f},{ry:.6f},{rz:.6f},{1e3 * x:.4f},{1e3 * y:.4f},{z:.4f}"
        for k, ((rx, ry), rz, (x, y), z) in enumerate(zip(tilt, heading, pose[:, :2], height, strict=True))
    ]
    return "\n".join(head + rows) + "\n"


def _toml(board: Hidden) -> str:
    """What the user knows of the board."""
    said = board.stated
    lines = [
        f'title = "snakeboard recording {board.name}"',
        f'skid = "{board.skid}"',
        "\n[board]",
        f"mass_kg = {said['m']:.6g}",
        f"rotor_inertia_kgm2 = {said['Jr']:.6g}",
        f"wheelset_inertia_kgm2 = {said['Jw']:.6g}",
        f"half_length_m = {said['L']:.6g}",
        f"creep_speed_mps = {said['creep']:.6g}",
    ]
    if abs(said["I"] / (said["m"] * said["L"] ** 2) - 1) > 1e-3:
        lines.append(f"inertia_kgm2 = {said['I']:.6g}")
    if board.noise_stated:
        lines += ["\n[noise]", f"position_m = {board.noise.scale[0]:.6g}", f"heading_rad = {board.noise.scale[2]:.6g}"]
    lines += ["\n[actuator]", f"kp = {said['kp']}", f"kd = {said['kd']}"]
    for run in board.runs:
        lines += ["\n[[runs]]", f'role = "{run.role}"', f'mocap = "{run.name}.csv"', 'object = "board:board"']
        lines += [f"phi = {run.phi}", f"psi = {run.psi}"]
    return "\n".join(lines) + "\n"
