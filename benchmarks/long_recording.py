"""A long recording: seconds and peak memory to read each format, and to load and fit a case, at several lengths.

    python benchmarks/long_recording.py [FRAMES ...]

prints one table; each row is a process of its own. Memory is the peak of the process; the first row is the memory with
JAX imported and nothing read.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RATE = 1000.0
PLACES = ((0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.2))
FRAMES = (10_000, 100_000, 1_000_000)
BOARD = """\
skid = "free"
[board]
mass_kg = 7.0
rotor_inertia_kgm2 = 0.0238
wheelset_inertia_kgm2 = 0.001
half_length_m = 0.25
creep_speed_mps = 0.01
[noise]
position_m = 0.0004
heading_rad = 0.0025
[[runs]]
role = "train"
mocap = "long.csv"
object = "board"
phi = [[0.9, 4.0, 0.0]]
psi = [[1.5, 4.0, 0.3]]
"""


def motion(n: int) -> np.ndarray:
    """Time, x, y, z [m] and a quaternion (n, 8) of something that goes round and round, with noise."""
    t = np.arange(n) / RATE
    heading = 0.3 * t
    rng = np.random.default_rng(0)
    place = np.stack([np.sin(t), np.cos(0.7 * t), 0.06 + 0 * t], axis=1) + 4e-4 * rng.normal(size=(n, 3))
    zero = np.zeros(n)
    return np.column_stack([t, place, zero, zero, np.sin(heading / 2), np.cos(heading / 2)])


def tracker(path: Path, n: int) -> None:
    table = motion(n)
    head = "Objects\r\n1000\r\n,,Global Angle board,,,,,,\r\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\r\n,,,,,,mm,mm,mm\r\n"
    rows = np.column_stack([np.arange(n) + 1, np.zeros(n), table[:, 4:], 1e3 * table[:, 1:4]])
    with path.open("w", newline="") as file:
        file.write(head)
        np.savetxt(file, rows, fmt=["%d", "%d", *["%.9f"] * 4, *["%.4f"] * 3], delimiter=",", newline="\r\n")


def nexus(path: Path, n: int) -> None:
    """Four markers."""
    place = motion(n)[:, 1:4]
    names = "".join(f"board:{i},,," for i in range(4))
    points = np.concatenate(
        [place + offset for offset in ([0.2, 0, 0], [-0.2, 0, 0], [0, 0.1, 0], [0, 0, 0.2])], axis=1
    )
    with path.open("w", newline="") as file:
        file.write(f"Trajectories\r\n1000\r\n,,{names}\r\nFrame,Sub Frame,{'X,Y,Z,' * 4}\r\n,,{'mm,' * 12}\r\n")
        rows = np.column_stack([np.arange(n) + 1, np.zeros(n), 1e3 * points])
        np.savetxt(file, rows, fmt=["%d", "%d", *["%.4f"] * 12], delimiter=",", newline="\r\n")


def plain(path: Path, n: int) -> None:
    np.savetxt(path, motion(n), fmt="%.9g", delimiter=",", header="time_s,x_m,y_m,z_m,qx,qy,qz,qw", comments="")


def parquet(path: Path, n: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    pq.write_table(pa.table(dict(zip(names, motion(n).T, strict=True))), path)


def simulated(path: Path, n: int) -> None:
    """What `BOARD` with tyres of its own does, written as motion capture at RATE would have seen it."""
    from snakejax import Pacejka, load_case, prepare_jax, simulate, starting_model

    prepare_jax()
    import equinox as eqx

    plain(path / "long.csv", 20)
    (path / "case.toml").write_text(BOARD)
    case = load_case(path)
    model = eqx.tree_at(lambda m: m.tyre, starting_model(case), Pacejka(B=6.0, C=1.4, D=2.0, E=0.0))
    t = np.arange(n) / RATE
    pose = np.asarray(simulate(model, case.runs[0].gait, t, start=np.zeros(3)).pose)
    pose = pose + np.random.default_rng(0).normal(size=pose.shape) * [4e-4, 4e-4, 2.5e-3]
    header = "time_s,x_m,y_m,heading_rad"
    np.savetxt(path / "long.csv", np.column_stack([t, pose]), fmt="%.9g", delimiter=",", header=header, comments="")


def measured(work: str, path: str) -> None:
    """Do it in this process and print seconds and MiB."""
    from snakejax import load_case, noise_of, prepare_jax, read_track, starting_model
    from snakejax.estimation import fit
    from snakejax.recording.readers import FileAnnotations

    places = {f"board:{i}": place for i, place in enumerate(PLACES)}
    prepare_jax()
    import jax

    jax.numpy.zeros(1).block_until_ready()
    begun = time.perf_counter()
    more = ""
    if work == "read":
        read_track(path, "board", FileAnnotations(markers=places if "nexus" in path else None))
    elif work != "start":
        case = load_case(path)
        if work == "fit":
            found = fit(starting_model(case), case.runs, noise_of(case))
            more = ", ".join(f"{name} {e.value:.4g}" for name, e in found.estimates.items())
            more += f", misfit {found.train_score.misfit:.4f}"
    seconds = time.perf_counter() - begun
    print(f"{seconds:9.1f} s {peak():9.0f} MiB  {more}")


def peak() -> float:
    """The most memory [MiB] this process ever held. What `getrusage` says includes the process that started it."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1024


def main() -> None:
    if sys.argv[1:2] == ["--measure"]:
        measured(*sys.argv[2:])
        return
    row("nothing", "start", "")
    for n in [int(word) for word in sys.argv[1:]] or FRAMES:
        with tempfile.TemporaryDirectory() as folder:
            for format in (tracker, nexus, plain, parquet):
                path = Path(folder) / format.__name__
                format(path, n)
                row(f"read {n} frames of {format.__name__}, {os.path.getsize(path) / 2**20:.0f} MiB", "read", path)
            simulated(Path(folder), n)
            row(f"load a case of {n} frames", "load", folder)
            row(f"load and fit a case of {n} frames", "fit", folder)


def row(what: str, *work: object) -> None:
    command = [sys.executable, __file__, "--measure", *map(str, work)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(f"{what:<56} {done.stdout.rstrip() or done.stderr.strip().splitlines()[-1]}", flush=True)


if __name__ == "__main__":
    main()
