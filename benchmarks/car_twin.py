"""A twin of the real car with a known answer: the commands of `data/car` drive a made-up car, which is then explained.

    python benchmarks/car_twin.py SCRATCH [--number N] [--table FILE]

The plant is written here and shares no code with the program: a single-track car with saturating tyres on both axles, a
steering that acts more to one side than to the other and, on every second twin, answers late. A command changes at a
random moment in the 0.1 s before the message that first shows it, as the log of the real car samples it. Yaw rate and
speed are disturbed by first-order noise (0.05 rad/s, 0.015 m/s, 0.1 s), and each frame has camera noise (0.064 mm,
0.72 mrad). SCRATCH keeps cases and results, so that the benchmark can be stopped at any time and go on.

Equations: x ahead, y left, angles counter-clockwise, SI.

    steering   T ds/dt = command - s        delta = k (1 + a tanh(30 s)) s
    drive      F = g P(throttle - c) - b u,  P(z) = 0.01 ln(1 + exp(z / 0.01)),  0 where the safety is off
    wheels     alpha_i = atan(lateral speed / sqrt(rolling speed^2 + 0.1^2)),  Y_i = -D_i sin(C_i atan(B_i alpha_i))
    body       m (du/dt - v r), m (dv/dt + u r), I dr/dt: sums of the forces and moments of both axles
"""

import argparse
import csv
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

CAR = Path(__file__).resolve().parents[1] / "data" / "car"
MASS, FRONT, REAR, SHARE, CREEP = 1.58, 0.0805, 0.0930, 0.536, 0.1
YAW, SPEED, TIME = 0.05, 0.015, 0.1
NOISE = (6.4e-5, 6.4e-5, 7.2e-4)
STEP = 0.005
SAMPLED = 0.1
Z95 = 1.959964
CONSTANTS = {"steering_ratio": "k", "force_gain": "g", "dead_band": "c", "speed_loss": "b"}
"""The constants that a case leaves to be estimated, with their letter above."""


def draw(number: int) -> dict[str, float]:
    """The numbers of one twin."""
    rng = np.random.default_rng([20, number])
    side = rng.choice([-1.0, 1.0])
    return {
        "k": rng.uniform(0.38, 0.46),
        "a": side * rng.uniform(0.08, 0.2),
        "T": 0.12 if number % 2 else 0.0,
        "g": rng.uniform(5.5, 8.0),
        "c": rng.uniform(0.18, 0.24),
        "b": rng.uniform(0.3, 0.8),
        "I": 0.008 * math.exp(0.25 * rng.uniform(-1, 1)),
        "B_f": rng.uniform(6.0, 10.0),
        "C_f": rng.uniform(1.3, 1.5),
        "D_f": rng.uniform(5.5, 7.5),
        "B_r": rng.uniform(8.0, 12.0),
        "C_r": rng.uniform(1.3, 1.5),
        "D_r": rng.uniform(5.0, 6.5),
    }


def pulled(z: float) -> float:
    """P(z)."""
    return 0.01 * math.log1p(math.exp(min(z / 0.01, 500.0))) if z < 5 else z


def rates(p: dict[str, float], state: list[float], throttle: float, steering: float, wander: Any) -> list[float]:
    """The rates of (x, y, theta, u, v, r, s)."""
    _, _, theta, u, v, r, s = state
    held = steering if p["T"] == 0 else s
    delta = p["k"] * (1 + p["a"] * math.tanh(30 * held)) * held
    drive = p["g"] * (pulled(throttle - p["c"]) - pulled(-throttle - p["c"])) - p["b"] * u
    c, si = math.cos(delta), math.sin(delta)
    v_f = v + FRONT * r
    along, across, v_r = u * c + v_f * si, -u * si + v_f * c, v - REAR * r
    X_f, X_r = SHARE * drive, (1 - SHARE) * drive
    Y_f = -p["D_f"] * math.sin(p["C_f"] * math.atan(p["B_f"] * math.atan2(across, math.hypot(along, CREEP))))
    Y_r = -p["D_r"] * math.sin(p["C_r"] * math.atan(p["B_r"] * math.atan2(v_r, math.hypot(u, CREEP))))
    ahead, left = X_f * c - Y_f * si, X_f * si + Y_f * c
    speed = u + wander[1]
    return [
        speed * math.cos(theta) - v * math.sin(theta),
        speed * math.sin(theta) + v * math.cos(theta),
        r + wander[0],
        (ahead + X_r) / MASS + v * r,
        (left + Y_r) / MASS - u * r,
        (FRONT * left - REAR * Y_r) / p["I"],
        0.0 if p["T"] == 0 else (steering - s) / p["T"],
    ]


def driven(p: dict[str, float], at: np.ndarray, throttle: np.ndarray, steering: np.ndarray, end: float, rng: Any):
    """Times and poses (n, 3) every `STEP` under commands that change at the moments `at` (Runge-Kutta, order 4)."""
    times = np.arange(0.0, end + STEP, STEP)
    which = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 1)
    decay = math.exp(-STEP / TIME)
    wander, state, poses = np.zeros(2), [0.0] * 7, []
    for k in which:
        poses.append(state[:3])
        wander = decay * wander + math.sqrt(1 - decay**2) * rng.normal(size=2) * [YAW, SPEED]

        def slope(y: list[float], k: int = k, wander: np.ndarray = wander) -> list[float]:
            return rates(p, y, throttle[k], steering[k], wander)

        k1 = slope(state)
        k2 = slope([y + STEP / 2 * d for y, d in zip(state, k1, strict=True)])
        k3 = slope([y + STEP / 2 * d for y, d in zip(state, k2, strict=True)])
        k4 = slope([y + STEP * d for y, d in zip(state, k3, strict=True)])
        state = [y + STEP / 6 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]
    return times, np.array(poses)


def write(number: int, folder: Path) -> None:
    """The case of one twin: the files of the real car with the poses of the twin."""
    p, rng = draw(number), np.random.default_rng([21, number])
    folder.mkdir(parents=True)
    text = (CAR / "case.toml").read_text(encoding="utf-8")
    (folder / "case.toml").write_text(text.replace('"a 1:10 car on Vicon"', f'"car twin {number}"'), encoding="utf-8")
    for path in sorted(CAR.glob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
        columns = {name: k for k, name in enumerate(header)}
        arrival = np.array([float(row[columns["vicon time"]]) for row in rows])
        arrival -= arrival[0]
        stamp, safety, throttle, steering = (
            np.array([float(row[columns[name]]) for row in rows])
            for name in ("elapsed time sensors", "safety_value", "throttle", "steering")
        )
        first = np.flatnonzero(np.diff(stamp, prepend=np.nan) != 0)
        offset = np.quantile(arrival[first] - stamp[first], 0.05)
        at = np.maximum.accumulate(stamp[first] + offset - SAMPLED * rng.uniform(size=len(first)))
        allowed = throttle[first] * (safety[first] > 0.5)
        times, poses = driven(p, at, allowed, steering[first], arrival[-1], rng)
        framed = np.stack([np.interp(arrival, times, poses[:, c]) for c in range(3)], axis=1)
        framed += rng.normal(size=framed.shape) * NOISE
        framed[:, 2] = np.angle(np.exp(1j * framed[:, 2]))
        places = [columns[name] for name in ("vicon x", "vicon y", "vicon yaw")]
        with (folder / path.name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            for row, pose in zip(rows, framed, strict=True):
                for place, value in zip(places, pose, strict=True):
                    row[place] = f"{value:.6f}"
                writer.writerow(row)


def score(number: int, result: dict[str, Any]) -> dict[str, Any]:
    """What was found of one twin: effects put in that are named, or stand behind a twin of theirs; effects that are
    absent and called sure; and by number whether its 95% interval holds the truth."""
    p, final = draw(number), result["final"]
    named, sure = set(final["effects"]), {e for e, how in final["confidence"].items() if how == "sure"}
    behind = {row["effect"] for row in result["candidates"] if set(row.get("instead_of") or ()) & named}
    true = {"lateral_skid", "steering_asymmetry"} | ({"steering_lag"} if p["T"] else set())
    # A log sampled every 0.1 s shows each change 0.05 s late on average: on every twin there is a clock offset, which
    # a lag of the steering opposes.
    late = {"steering_lag", "clock_offset"}
    hit = {e for e in true if e in named | behind or (e in late and late & (named | behind))}
    estimates = {name: (final["constants"].get(name), p[letter]) for name, letter in CONSTANTS.items()}
    estimates["steering_asymmetry.a"] = (final["effects"].get("steering_asymmetry", {}).get("a"), p["a"])
    holds = {
        name: abs(one["value"] - truth) <= Z95 * one["sd"]
        for name, (one, truth) in estimates.items()
        if one is not None and one["sd"]
    }
    return {
        "twin": number,
        "first": next(iter(result["effects"] or final["effects"]), None),
        "true": true,
        "hit": hit,
        "absent sure": sure - true - late,
        "holds": holds,
        "heldout": [result["base"]["rmse"]["heldout"], final["rmse"]["heldout"]],
        "seconds": result["seconds"]["total"],
    }


def table(rows: list[dict[str, Any]]) -> str:
    """One line a twin, and the counts of all."""
    lines = []
    for row in rows:
        off = [name for name, inside in row["holds"].items() if not inside]
        before, after = row["heldout"]
        lines.append(
            f"  twin {row['twin']}: {len(row['hit'])} of {len(row['true'])} effects"
            f" (missed: {', '.join(sorted(row['true'] - row['hit'])) or 'none'});"
            f" absent and sure: {', '.join(sorted(row['absent sure'])) or 'none'};"
            f" intervals off: {', '.join(off) or 'none'} of {len(row['holds'])};"
            f" held-out windows {1e3 * before['position_m']:.0f} mm, {1e3 * before['heading_rad']:.0f} mrad ->"
            f" {1e3 * after['position_m']:.0f} mm, {1e3 * after['heading_rad']:.0f} mrad; {row['seconds']:.0f} s"
        )
    inside = [one for row in rows for one in row["holds"].values()]
    hit, true = (sum(len(row[key]) for row in rows) for key in ("hit", "true"))
    lines.append(f"Effects put in and named, or a twin of theirs: {hit} of {true}")
    lines.append(f"Twins with an absent effect called sure: {sum(bool(row['absent sure']) for row in rows)}")
    lines.append(f"95% intervals that hold the truth: {sum(inside)} of {len(inside)}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make and explain the twins that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--number", type=int, default=6, help="so many twins (default 6)")
    parser.add_argument("--table", type=Path, help="write the table there too")
    asked = parser.parse_args()
    rows = []
    for number in range(asked.number):
        folder, result = asked.scratch / f"twin-{number}", asked.scratch / f"twin-{number}.json"
        if not folder.is_dir():
            write(number, folder)
        if not result.is_file():
            command = [sys.executable, "-m", "snakejax", "explain", str(folder), "--json", str(result), "--quiet"]
            subprocess.run(command, check=True)
        rows.append(score(number, json.loads(result.read_text(encoding="utf-8"))))
        print(table(rows), flush=True)
    if asked.table:
        asked.table.write_text(table(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
