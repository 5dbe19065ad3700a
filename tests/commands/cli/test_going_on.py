"""`snakejax explain --out` after it was killed: the same command goes on with the fits that were finished."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.folders import DATA

_LOGGED = """
import sys
from snakejax.commands.cli import main
from snakejax.estimation import fit_journal
written = fit_journal.write_whole

def logged(path, content):
    written(path, content)
    with open(sys.argv[1], "a") as log:
        print(path.name, file=log)

fit_journal.write_whole = logged
sys.exit(main(sys.argv[2:]))
"""
"""The program, which writes the name of each fit that it computes into a file."""


def command(log: Path, out: Path) -> list[str]:
    words = ["explain", str(DATA / "level-board"), "--out", str(out)]
    return [sys.executable, "-c", _LOGGED, str(log), *words]


def computed(log: Path) -> list[str]:
    return log.read_text().split()


def result(out: Path) -> dict:
    found = json.loads((out / "explain.json").read_text())
    assert found.pop("seconds")
    return found


@pytest.mark.long
def test_a_killed_command_goes_on_with_the_same_result(tmp_path) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    subprocess.run(command(tmp_path / "all", whole), check=True, capture_output=True, timeout=600)
    assert not (whole / "unfinished").exists()
    process = subprocess.Popen(command(tmp_path / "first", out), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    until = time.monotonic() + 300
    while len(list(out.glob("unfinished/*/*.fit"))) < 3 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    process.kill()  # SIGKILL
    process.communicate()
    assert process.returncode == -9
    kept = {path.name for path in out.glob("unfinished/*/*.fit")}
    assert len(kept) >= 3 and not (out / "explain.json").exists()
    done = subprocess.run(command(tmp_path / "second", out), check=True, capture_output=True, text=True, timeout=600)
    assert re.search(rf"^Going on: {len(kept)} fits of an earlier run are used\.$", done.stderr, flags=re.MULTILINE)
    again = computed(tmp_path / "second")
    assert kept.isdisjoint(again) and again
    assert kept | set(again) == set(computed(tmp_path / "all"))
    assert result(out) == result(whole)
    assert not (out / "unfinished").exists()
