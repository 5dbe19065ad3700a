"""Explain a set of recordings whose hidden effects are known, and compare.

    python benchmarks/recordings.py FOLDER KEY.json [CASE ...]

FOLDER holds case folders, KEY.json a list of {"case", "verdict", "effects", "values", "tyre", "depends_on"}. One
process explains all of them, as `snakejax explain` does with several CASEs; the seconds are those of each, less
compilation.
"""

import json
import statistics
import sys
from pathlib import Path

from snakejax import prepare_jax

prepare_jax()

from snakejax import explain, load_case, noise_of  # noqa: E402
from snakejax._cli._setup import Clock, start_jax  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402


def away(found, truth) -> str:
    """How many standard errors each value, of effects and tyre, is from the truth."""
    parts = []
    for name, value in truth.items():
        estimate = found.final.estimates.get(name)
        if estimate is not None and estimate.sd:
            parts.append(f"{name.split('.', 1)[1]} {(estimate.value - value) / estimate.sd:+.1f}")
    return ", ".join(parts)


def main(folder: Path, key: Path, names: list[str]) -> None:
    """Print one line a case, and the median time."""
    start_jax()
    known = {entry["case"]: entry for entry in json.loads(key.read_text())}
    right, keyed, seconds = 0, 0, []
    for name in names or sorted(known):
        entry, case = known[name], load_case(folder / name)
        clock = Clock()
        found = explain(case, noise_of(case), {n: kind() for n, kind in LIBRARY.items()})
        spent = clock.seconds()
        seconds.append(spent["total"] - spent["compile"])
        first = found.missing.depends_on[0] if found.missing is not None else None
        good = found.verdict == entry["verdict"] and set(found.effects) == set(entry["effects"] or ())
        good &= "depends_on" not in entry or (first is not None and first[0] == entry["depends_on"])
        right += good
        keyed += entry["verdict"] is not None
        base, final = found.base, found.final
        held = ["-" if s.heldout is None else f"{s.heldout.misfit:.4g}" for s in (base, final)]
        print(
            f"{name}: {'as in the key' if good else 'NOT as in the key' if entry['verdict'] else 'no key'}", flush=True
        )
        print(
            f"  {found.verdict} {', '.join(found.effects)}"
            + (f"; depends on {first[0]} ({first[1]:.2f})" if first else "")
        )
        print(f"  misfit train {base.train.misfit:.4g} -> {final.train.misfit:.4g}, held out {held[0]} -> {held[1]}")
        truth = {f"effects.{n}": v for n, v in entry["values"].items()}
        truth |= {f"tyre.{n}": v for n, v in entry["tyre"].items()}
        if found.verdict != "unexplained":
            print(f"  standard errors from the truth: {away(found, truth)}")
        print(f"  {seconds[-1]:.1f} s, and {spent['compile']:.1f} s of compiling")
    print(f"{right} of the {keyed} with a key as in the key; median {statistics.median(seconds):.1f} s after compilation")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
