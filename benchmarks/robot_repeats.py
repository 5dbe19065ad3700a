"""How well a skid-steer robot repeats itself: what no model of its wheel speeds can predict.

    python benchmarks/robot_repeats.py [CASE] [--table FILE]

If the robot repeated itself, two windows of CASE (`data/robot` unless given) with the same steady wheel speeds would
end in the same pose relative to their first one. Windows with the same speeds are found as
`snakejax.diagnosis.windows.repeatability` does. The difference of the ends of two windows, over the root of 2, is what
one of them deviates by. Beside it stands the error of a differential drive, v = R (l + r) / 2 and yaw rate
= R (r - l) / b, whose R and b are fitted to the windows of the train set by least squares here.
"""

import argparse
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize

import snakejax as sj
from snakejax.diagnosis.windows.repeatability import commands_of, steady_windows
from snakejax.recording.run import Run

ROOT = Path(__file__).resolve().parents[1]
ALIKE = 0.05
"""Mean wheel speeds [rad/s] that differ by less are nearly the same: 1% of a usual speed of 5 rad/s."""


class Window(NamedTuple):
    """`times` [s] (n,), the `pose` (n, 3) from its first one on, in the robot's first frame, and `speeds` (n, 2)."""

    times: np.ndarray
    pose: np.ndarray
    speeds: np.ndarray


def window(run: Run) -> Window:
    """What was measured in `run`."""
    pose = np.asarray(run.pose)
    seen = np.isfinite(pose).all(axis=1)
    moved, angle = pose[seen] - pose[seen][0], pose[seen][0, 2]
    moved[:, :2] = moved[:, :2] @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Window(np.asarray(run.times)[seen], moved, commands_of(run)[0][seen])


def differential_drive(windows: list[Window]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Radius and effective track [m] that fit the `windows` best, and the error (3,) at the end of each."""

    def errors(p: np.ndarray) -> list[np.ndarray]:
        result = []
        for times, pose, speeds in windows:
            dt = np.diff(times)[:, None]
            rates = np.column_stack([p[0] * speeds.mean(axis=1), p[0] * (speeds[:, 1] - speeds[:, 0]) / p[1]])
            distance, heading = np.pad(np.cumsum(0.5 * (rates[1:] + rates[:-1]) * dt, axis=0), ((1, 0), (0, 0))).T
            middle = 0.5 * (heading[1:] + heading[:-1])
            steps = np.diff(distance)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
            path = np.pad(np.cumsum(steps, axis=0), ((1, 0), (0, 0)))
            result.append(np.column_stack([path, heading]) - pose)
        return result

    fitted = optimize.least_squares(lambda p: np.concatenate(errors(p)).ravel(), [0.15, 1.0]).x
    return fitted, [error[-1] for error in errors(fitted)]


def row(name: str, ends: list[np.ndarray]) -> str:
    """A line of the table: medians over the `ends`."""
    position = np.median([np.hypot(*end[:2]) for end in ends])
    heading = np.median([abs(end[2]) for end in ends])
    return f"{name:58s} {len(ends):6d} {1e3 * position:8.0f} mm {1e3 * heading:8.0f} mrad"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="?", default=str(ROOT / "data" / "robot"))
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    sj.prepare_jax()
    runs = sj.load_case(options.case).having("train")
    windows = [window(run) for run in runs]
    pairs = [pair for group in steady_windows(runs) for pair in combinations(group, 2)]
    mean = [part.speeds.mean(axis=0) for part in windows]
    near = [(i, j) for i, j in pairs if np.abs(mean[i] - mean[j]).max() < ALIKE]
    radius_and_track, ends = differential_drive(windows)
    last = windows[0].times[-1]

    def differences(chosen: list[tuple[int, int]]) -> list[np.ndarray]:
        return [(windows[i].pose[-1] - windows[j].pose[-1]) / np.sqrt(2.0) for i, j in chosen]

    moved = row("motion", [part.pose[-1] for part in windows])
    drive = "differential drive, R = {:.3f} m, b = {:.2f} m".format(*radius_and_track)
    lines = [
        f"Medians {last:g} s after the first pose of a window, of the {len(windows)} train windows.",
        f"{'':58s} {'number':>6s} {'position':>11s} {'heading':>13s}",
        moved,
        row(drive, ends),
        row("one window against its repeats, pairs within 2%", differences(pairs)),
        row(f"the same, pairs within {ALIKE:g} rad/s", differences(near)),
    ]
    print("\n".join(lines))
    if options.table:
        options.table.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
