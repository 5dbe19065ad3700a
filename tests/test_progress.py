"""The line that moves on a terminal, read from a pseudo-terminal as a user sees it."""

import argparse
import io
import os
import re
import sys
import time
from pathlib import Path

import pytest

from snakejax._cli import _setup
from snakejax._cli._setup import Outcome, each_case, progress

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
    monkeypatch.setattr(_setup, "time", made)
    return made


def test_of_several_cases_the_bar_is_over_the_cases(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    seen = []

    def work(case, say) -> Outcome:
        say("fitting")
        seen.append(terminal.line())
        clock.now += 60
        say("tuning", 3, 4)
        say("drawing")
        seen.append(terminal.line())
        clock.now += 40
        return Outcome({}, "")

    options = argparse.Namespace(cases=CASES, quiet=False, json=None, out=None, command="fit")
    assert each_case(options, work) == 0
    assert "level-board (1/3): fitting" in seen[0] and seen[0].endswith("left -:--:--")
    # After one of three in 100 s, 200 s are left, and 140 s a minute later, whatever else was counted meanwhile.
    assert "spring-board (2/3): fitting" in seen[2] and seen[2].endswith("left 0:03:20")
    # Half a cell of a bar that is filled to a third; one of unknown length moves in whole ones.
    assert "╸" in seen[2]
    assert "spring-board (2/3): drawing" in seen[3] and "tilted-floor (3/3): fitting" in seen[4]
    assert seen[4].endswith("left 0:01:40")


def test_what_a_command_counts_itself_wins(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 3) as say:
        say("a: sweeping", 0, 40, case=1)
        clock.now += 10
        say("a: sweeping", 10, 40, case=1)
        assert terminal.line().endswith("left 0:00:30")


def test_a_single_case_has_a_spinner_and_the_time_gone(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 1) as say:
        say("a: fitting")
        clock.now += 30
        say("a: drawing")
        line = terminal.line()
        assert "a: drawing" in line and line.endswith("left -:--:--") and re.search(r"0:00:0\d", line)
        assert "╸" not in line and "╺" not in line


def test_nothing_moves_in_a_pipe(monkeypatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with progress(False, 3) as say:
        say("a: fitting", 1, 3, case=1)
    assert pipe.getvalue() == ""
