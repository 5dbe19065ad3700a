"""The line that moves on a terminal, read from a pseudo-terminal as a user sees it."""

import argparse
import io
import os
import re
import sys
import time
from datetime import timedelta
from pathlib import Path

import pytest

from snakejax._cli import _progress
from snakejax._cli._progress import ROUTES, progress
from snakejax._cli._setup import Outcome, each_case

pty = pytest.importorskip("pty", reason="Windows has no pseudo-terminals.")

DATA = Path(__file__).resolve().parents[1] / "data"
CASES = [str(DATA / name) for name in ("level-board", "spring-board", "tilted-floor")]


class Clock:
    """Time that goes when it is told to; the rest of the module is the real one."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def __getattr__(self, name: str):
        return getattr(time, name)


class Terminal:
    """A terminal of 100 columns for standard error, and what stands in its last line by now."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ours, theirs = pty.openpty()
        self.stream = os.fdopen(theirs, "w")
        for name, value in (("COLUMNS", "100"), ("TERM", "xterm")):
            monkeypatch.setenv(name, value)
        # Not in a fixture: pytest puts its own streams in place after those.
        monkeypatch.setattr(sys, "stderr", self.stream)
        monkeypatch.setattr(sys, "stdout", io.StringIO())

    def line(self) -> str:
        time.sleep(0.3)  # Ten pictures a second.
        written = os.read(self.ours, 1 << 20).decode()
        plain = re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", written)
        return [part for part in re.split(r"[\r\n]+", plain) if part.strip()][-1].rstrip()


@pytest.fixture
def clock(monkeypatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(_progress, "time", made)
    return made


def test_of_several_cases_the_bar_is_over_the_cases(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    seen = []

    def work(case, say) -> Outcome:
        say("first seconds")
        seen.append(terminal.line())
        clock.now += 60
        say("tuning", 3, 4)
        say("fitting whole runs")
        seen.append(terminal.line())
        clock.now += 40
        return Outcome({}, "")

    options = argparse.Namespace(cases=CASES, quiet=False, json=None, out=None, command="fit")
    assert each_case(options, work) == 0
    # Usually a fit takes 3 + 0.5 + 3 s: twenty for three of them, until one of them has been seen.
    assert "level-board (1/3): first seconds" in seen[0] and seen[0].endswith("left 0:00:19")
    # After 60 s for the first 3.5 of 6.5 the other 3 will take 51, and two more cases 111 each.
    assert seen[1].endswith("left 0:04:34")
    # After one of three in 100 s, 200 s are left, whatever else was counted meanwhile.
    assert "spring-board (2/3): first seconds" in seen[2] and seen[2].endswith("left 0:03:20")
    # Half a cell of a bar that is filled to a third; one of unknown length moves in whole ones.
    assert "╸" in seen[2]
    assert "tilted-floor (3/3): first seconds" in seen[4] and seen[4].endswith("left 0:01:40")


def test_what_a_command_counts_itself_wins(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 3) as say:
        say("a: sweeping", 0, 40, case=1)
        clock.now += 10
        say("a: sweeping", 10, 40, case=1)
        assert terminal.line().endswith("left 0:00:30")


def test_one_case_alone_has_the_time_left_too(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 1, "explain", drawing=True) as say:
        say("fitting windows", label="a")
        first = terminal.line()
        clock.now += 30
        say("scoring candidates", label="a")
        later = terminal.line()
        clock.now += 5
        say("fitting windows", label="a")  # The bar does not go back.
        again = terminal.line()
    usual = [phase.seconds for phase in ROUTES["explain"] if phase.usual]
    assert re.search(r"left 0:00:(\d+)$", first)[1] == f"{sum(usual):02.0f}"
    left = 30 / sum(usual[:2]) * sum(usual[2:])
    assert later.endswith(f"left {timedelta(seconds=int(left))}")
    assert again.count("━") == later.count("━") > 0
    assert again.endswith(f"left {timedelta(seconds=int(left * 35 / 30))}")


def test_every_phase_of_a_computation_has_its_place_on_a_route() -> None:
    """What the package tells is what the routes wait for, and nothing else."""
    told = set()
    for file in sorted((Path(_progress.__file__).parents[1]).glob("_*.py")):
        told |= set(re.findall(r'\bprogress\(f?"([^"]+)"\)', file.read_text()))
    for name in ("compare", "diagnose", "explain", "fit"):
        file = Path(_progress.__file__).with_name(f"{name}.py")
        told |= set(re.findall(r'\bsay\(f?"([^"]+)"\)', file.read_text()))
    assert len(told) > 15
    phases = {phase.message for route in ROUTES.values() for phase in route}
    spoken = {re.sub(r"\{[^}]*\}", "7" if not text.startswith("fitting {") else "ideal", text) for text in told}
    assert [text for text in spoken if not any(re.match(phase, text) for phase in phases)] == []
    assert [phase for phase in phases if not any(re.match(phase, text) for text in spoken)] == []


def test_what_is_on_no_route_has_a_spinner_and_the_time_gone(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 1) as say:
        say("simulating", label="a")
        clock.now += 30
        say("drawing", label="a")
        line = terminal.line()
        assert "a: drawing" in line and line.endswith("left -:--:--") and re.search(r"0:00:0\d", line)
        assert "╸" not in line and "╺" not in line


def test_nothing_moves_in_a_pipe(monkeypatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with progress(False, 3) as say:
        say("a: fitting", 1, 3, case=1)
    assert pipe.getvalue() == ""
