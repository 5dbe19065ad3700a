"""Explain two halves of a car's recordings apart, and compare what was found.

    python benchmarks/car_halves.py FOLDER SCRATCH [--table FILE]

FOLDER holds recordings of the car of `data/car`, one file each, named DAY_TIME.csv; those held out there are left out.
Every second file of a day makes one half. Each half is explained by itself, with nothing said of what is missing:
`snakejax explain SCRATCH/half0` (minutes each; what is in SCRATCH is not done again). The table has each parameter with
its standard deviation in both, and their difference in standard deviations of a difference. benchmarks/car_halves.txt
is that of 23 files.
"""

import argparse
import json
import math
import shutil
import subprocess
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

CASE = Path(__file__).resolve().parents[1] / "data" / "car" / "case.toml"
HELD_OUT = ("0904_121123", "0909_160402", "0916_100228")
MEASURED = ("mass", "front", "rear")
"""Constants that were measured: both halves share the statement, so that they cannot disagree."""
SLOW = "0925"
"""The day of the slow runs: short files of one command each, from which fewer windows are taken."""


def write(files: list[Path], folder: Path) -> None:
    """A case folder with copies of `files`, all of them to train on."""
    folder.mkdir(parents=True, exist_ok=True)
    text = CASE.read_text().split("[[runs]]")[0]
    for day, of_day in groupby(files, key=lambda path: path.stem[:4]):
        names = [shutil.copy(path, folder).name for path in of_day]
        most = 6 if day == SLOW else 12
        text += f'\n[[runs]]\nrole = "train"\ngroup = "{day}"\nfiles = {json.dumps(names)}\n'
        text += f"windows = {{length_s = 1.5, most = {most}, rate_hz = 20.0}}\n"
    (folder / "case.toml").write_text(text)


def explained(folder: Path) -> dict[str, Any]:
    """The result of `explain`, from its file if it is there."""
    result = folder.with_suffix(".json")
    if not result.is_file():
        command = [sys.executable, "-m", "snakejax", "explain", str(folder), "--json", str(result), "--quiet"]
        # No known effect brings a real car down to its noise: the exit status says so.
        subprocess.run(command, check=False)
    return json.loads(result.read_text())


def summary(found: dict[str, Any]) -> str:
    """The steps of a half, and its error before and after."""
    before, after = (math.sqrt(found[step]["misfit"]["train"]) for step in ("base", "final"))
    changes = [
        f"{change} {step[change]}" for step in found["steps"] for change in ("added", "dropped") if change in step
    ]
    return f"{found['case']}: {', '.join(changes)}; error {before:.2f} -> {after:.2f} times the noise"


def parameters(found: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """The parameters of the final model with a standard deviation: tyre, effects, steering and drive."""
    final = found["final"]
    named = final["parameters"] | {n: v for n, v in final["constants"].items() if n not in MEASURED}
    for effect, values in final["effects"].items():
        named |= {f"{effect}.{name}": value for name, value in values.items() if name != "expression"}
    return {name: (value["value"], value["sd"]) for name, value in named.items() if value["sd"]}


def main() -> None:
    """Write and explain the halves, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--table", type=Path, help="write it there too")
    asked = parser.parse_args()
    files = [path for path in sorted(asked.folder.glob("*.csv")) if path.stem not in HELD_OUT]
    days = [list(of_day) for _, of_day in groupby(files, key=lambda path: path.stem[:4])]
    found = []
    for half in (0, 1):
        folder = asked.scratch / f"half{half}"
        if not folder.is_dir():
            write([path for of_day in days for path in of_day[half::2]], folder)
        found.append(explained(folder))
    one, other = map(parameters, found)
    lines = [summary(result) for result in found]
    rows = []
    for name in sorted(set(one) & set(other)):
        (value, sd), (value_2, sd_2) = one[name], other[name]
        rows.append((name, value, sd, value_2, sd_2, (value - value_2) / math.hypot(sd, sd_2)))
    lines += ["", f"{'parameter':24}{'half 0':>10}{'+-':>10}{'half 1':>10}{'+-':>10}{'apart':>8}"]
    lines += [f"{name:24}{a:10.4g}{b:10.2g}{c:10.4g}{d:10.2g}{z:8.2f}" for name, a, b, c, d, z in rows]
    near = sum(abs(row[-1]) < 3 for row in rows)
    lines += ["", f"{near} of {len(rows)} parameters within 3 standard deviations of each other"]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if asked.table:
        asked.table.write_text(text)


if __name__ == "__main__":
    main()
