"""Explain boards as real ones are, whose hidden effects are known, and say how often the program is right.

    python benchmarks/real_like/real_like.py SCRATCH [--set dev|final] [--kind KIND ...] [--number N] [--table FILE]

SCRATCH takes case folders, keys, and one result a board; what is there is not done again, so that it can be stopped at
any time and go on. The set `dev` is there to develop with; `final` judges, has other seeds, and nobody looks at its
boards: its table is benchmarks/real_like.txt. Kinds and their numbers of boards: boards.py; all of all kinds if
none are named. What counts as true, sure and first: judge.py.

The held-out error is compared with that of the true model, which has all hidden effects and the true constants: its
tyre, effects and start poses are refitted by this folder's own plant to the train runs and, as in the program, the
start poses alone to the held-out runs. Beside it stands the same without the law that no library holds, which is the
best that effects of a library can do; and the same with the constants and all numbers of that law estimated too, which
is what the train runs tell one who knows all effects and the form of the law. Effects above their detectable size are
those with 3.92 standard errors there.

Needs the extra `bench`: numba integrates the plant.
"""

import argparse
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from boards import KINDS, SETS, draw
from folders import measured, write
from judge import score
from table import text
from truth import refit

ROOT = Path(__file__).resolve().parents[2]


def prepare(scratch: Path, group: str, kind: str, number: int) -> str:
    """Write the case and its key if they are not there, and return the name of the board."""
    known = sorted((scratch / "keys").glob(f"{kind}-{number:02d}*.json"))
    if known:
        return known[0].stem
    board = draw(kind, group, number)
    write(board, group, scratch / "cases", scratch / "keys")
    return board.name


def explain(scratch: Path, names: list[str], options: list[str]) -> None:
    """Run the command on some boards at once; where it leaves no result, what it said is kept instead."""
    told, results = scratch / "told", scratch / "results"
    for folder in (told, results):
        folder.mkdir(parents=True, exist_ok=True)
    target = results if len(names) > 1 else results / f"{names[0]}.json"
    cases = [str(scratch / "cases" / name) for name in names]
    command = [sys.executable, "-m", "snakejax", "explain", *cases, "--json", str(target), "--quiet", *options]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode in (-signal.SIGTERM, -signal.SIGINT):
        print(f"stopped from outside, to be run again: {' '.join(names)}", flush=True)
        return
    for name in names:
        if not (results / f"{name}.json").is_file():
            (told / f"{name}.txt").write_text(f"exit status {done.returncode}\n{done.stderr}")


def truth(scratch: Path, group: str, name: str) -> dict[str, Any]:
    """What the true model refitted leaves of the board, computed once."""
    path = scratch / "truth" / f"{name}.json"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        kind, number = name.split("-")[:2]
        board = draw(kind, group, int(number))
        path.write_text(json.dumps(refit(board, measured(board, group)), indent=1) + "\n")
    return json.loads(path.read_text())


def table(scratch: Path, group: str, names: list[str]) -> str:
    """The table of all boards of which there is a result."""
    rows, failed, missing = [], [], 0
    for name in names:
        result, told = scratch / "results" / f"{name}.json", scratch / "told" / f"{name}.txt"
        if result.is_file():
            key = json.loads((scratch / "keys" / f"{name}.json").read_text())
            rows.append(score(json.loads(result.read_text()), key, truth(scratch, group, name)))
        elif told.is_file():
            failed.append(f"{name}: {' '.join(told.read_text().split())[:300]}")
        else:
            missing += 1
    return text(rows, failed, missing, group)


def main() -> None:
    """Read the options, run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--set", dest="group", choices=list(SETS), default="dev")
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="repeatable; default all")
    parser.add_argument("--number", type=int, help="no more than so many boards of each kind")
    parser.add_argument("--batch", type=int, default=4, help="boards in one call of the command (default 4)")
    parser.add_argument("--retry", action="store_true", help="run boards again that left no result")
    parser.add_argument("--only-table", action="store_true", help="run nothing")
    parser.add_argument("--table", type=Path, help="write it there too (default for `final`: benchmarks/real_like.txt)")
    parser.add_argument("--option", action="append", default=[], help="passed on to `snakejax explain`; repeatable")
    asked = parser.parse_args()
    scratch = asked.scratch / asked.group
    names = [
        prepare(scratch, asked.group, kind, number)
        for kind in asked.kind or KINDS
        for number in range(min(asked.number or KINDS[kind], KINDS[kind]))
    ]
    todo = [] if asked.only_table else [n for n in names if not (scratch / "results" / f"{n}.json").is_file()]
    todo = [n for n in todo if asked.retry or not (scratch / "told" / f"{n}.txt").is_file()]
    # A variant of another shape shares no compilation with the others, and is the likeliest to fail.
    alone = [n for n in todo if n.startswith("scale")]
    others = [n for n in todo if n not in alone]
    batches = [others[k : k + asked.batch] for k in range(0, len(others), asked.batch)] + [[n] for n in alone]
    for batch in batches:
        print("explains", *batch, flush=True)
        explain(scratch, batch, asked.option)
    found = table(scratch, asked.group, names)
    print(found, end="")
    target = asked.table or (ROOT / "benchmarks" / "real_like.txt" if asked.group == "final" else None)
    if target:
        target.write_text(found)


if __name__ == "__main__":
    main()
