"""Explain a set of recordings whose hidden effects are known, in one call of the command, and compare.

    python benchmarks/recordings.py FOLDER KEY.json OUT [CASE ...]

FOLDER holds case folders, KEY.json a list of {"case", "verdict", "effects", "values", "tyre", "depends_on"}; OUT gets
the results and reports. The seconds of each case exclude compilation, figures and report.
"""

import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any


def right(found: dict[str, Any], entry: dict[str, Any]) -> bool:
    """Whether verdict, effects and, if the key has it, the first dependence are as in the key."""
    laws = {name for name, values in found["final"]["effects"].items() if "expression" in values}
    if entry["verdict"] == "unexplained" and found["verdict"] == "explained":
        # The law of what the key says is in no library was found.
        return bool(laws) and set(found["effects"]) - laws == set(entry["effects"])
    if found["verdict"] != entry["verdict"] or set(found["effects"]) - laws != set(entry["effects"]):
        return False
    return "depends_on" not in entry or found["unexplained"]["depends_on"][0]["variable"] == entry["depends_on"]


def away(found: dict[str, Any], truth: dict[str, float]) -> str:
    """How many standard errors each value, of effects and tyre, is from the truth."""
    final, parts = found["final"], []
    parts_of = ((e, n, v) for e, values in final["effects"].items() for n, v in values.items() if n != "expression")
    known = final["parameters"] | {f"{e}.{n}": v for e, n, v in parts_of}
    for name, value in truth.items():
        estimate = known.get(name)
        if estimate is not None and estimate["sd"]:
            parts.append(f"{name} {(estimate['value'] - value) / estimate['sd']:+.1f}")
    return ", ".join(parts)


def main(folder: Path, key: Path, out: Path, names: list[str]) -> None:
    """Print what was found of each case, and the median time of those with a key."""
    known = {entry["case"]: entry for entry in json.loads(key.read_text())}
    names = names or sorted(known)
    command = [sys.executable, "-m", "snakejax", "explain", *(str(folder / name) for name in names)]
    subprocess.run([*command, "--out", str(out), "--quiet"], check=True)
    good, seconds = 0, []
    for name in names:
        entry = known[name]
        found = json.loads(((out / name if len(names) > 1 else out) / "explain.json").read_text())
        spent = found["seconds"]["total"] - found["seconds"]["compile"]
        if entry["verdict"]:
            good += right(found, entry)
            seconds.append(spent)
            print(f"{name}: {'as in the key' if right(found, entry) else 'NOT as in the key'}")
        else:
            print(f"{name}: no key")
        first = (found["unexplained"] or {}).get("depends_on") or ()
        depends = "".join(f"; depends on {one['variable']} ({one['share']:.2f})" for one in first[:1])
        print(f"  {found['verdict']} {', '.join(found['effects'])}{depends}")
        falls = [
            " -> ".join(f"{found[stage]['misfit'][role]:.4g}" for stage in ("base", "final"))
            for role in ("train", "heldout")
        ]
        print(f"  misfit train {falls[0]}, held out {falls[1]}")
        if found["verdict"] != "unexplained":
            print(f"  standard errors from the truth: {away(found, entry['values'] | entry['tyre'])}")
        print(f"  {spent:.1f} s, and {found['seconds']['compile']:.1f} s of compiling")
    print(f"{good} of the {len(seconds)} with a key as in the key; median {statistics.median(seconds):.1f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
