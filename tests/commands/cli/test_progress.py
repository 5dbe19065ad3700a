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
from helpers.folders import DATA

from snakejax.commands.cli import progress as _progress
from snakejax.commands.cli.pipeline import Outcome, each_case
from snakejax.commands.cli.progress import PHASES_OF, progress
from snakejax.core.progress import Phase, ProgressEvent

pty = pytest.importorskip("pty", reason="Windows has no pseudo-terminals.")

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


@pytest.mark.slow
def test_of_several_cases_the_bar_is_over_the_cases(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    seen = []

    def work(case, say) -> Outcome:
        say(ProgressEvent(Phase.FIRST_SECONDS))
        seen.append(terminal.line())
        clock.now += 60
        say(ProgressEvent(Phase.OPTIMISATION, "tuning", 3, 4))
        say(ProgressEvent(Phase.WHOLE_RUNS))
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
        say(ProgressEvent(Phase.SWEEP, "a: sweeping", 0, 40), case=1)
        clock.now += 10
        say(ProgressEvent(Phase.SWEEP, "a: sweeping", 10, 40), case=1)
        assert terminal.line().endswith("left 0:00:30")


def test_one_case_alone_has_the_time_left_too(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 1, "explain", drawing=True) as say:
        say(ProgressEvent(Phase.WINDOWS), label="a")
        first = terminal.line()
        clock.now += 30
        say(ProgressEvent(Phase.SCORE_TESTS), label="a")
        later = terminal.line()
        clock.now += 5
        say(ProgressEvent(Phase.WINDOWS), label="a")  # The bar does not go back.
        again = terminal.line()
    usual = [phase.seconds for phase in PHASES_OF["explain"] if phase.usual]
    assert re.search(r"left 0:00:(\d+)$", first)[1] == f"{sum(usual):02.0f}"
    left = 30 / sum(usual[:2]) * sum(usual[2:])
    assert later.endswith(f"left {timedelta(seconds=int(left))}")
    assert again.count("━") == later.count("━") > 0
    assert again.endswith(f"left {timedelta(seconds=int(left * 35 / 30))}")


def test_every_phase_of_a_computation_has_its_place_on_a_route() -> None:
    """What the package reports is what the routes wait for, and nothing else."""
    source = Path(_progress.__file__).parents[2]
    commands = [Path(_progress.__file__).with_name(f"{name}.py") for name in ("compare", "diagnose", "explain", "fit")]
    reporting = [*commands, *(source / "estimation").rglob("*.py"), *(source / "diagnosis").rglob("*.py")]
    reported = {name for file in reporting for name in re.findall(r"\bPhase\.(\w+)", file.read_text())}
    assert len(reported) > 15
    on_routes = {stop.phase.name for route in PHASES_OF.values() for stop in route}
    assert reported - {Phase.POSTERIOR_SAMPLES.name} == on_routes  # Samples are counted, and drawn by `tune` alone.


def test_every_phase_is_reported_somewhere() -> None:
    files = [file for file in Path(_progress.__file__).parents[2].rglob("*.py") if file.name != "progress.py"]
    text = "".join(file.read_text() for file in files)
    assert [phase.name for phase in Phase if f"Phase.{phase.name}" not in text] == []


def test_what_is_on_no_route_has_a_spinner_and_the_time_gone(clock, monkeypatch) -> None:
    terminal = Terminal(monkeypatch)
    with progress(False, 1) as say:
        say(ProgressEvent(Phase.SIMULATION), label="a")
        clock.now += 30
        say(ProgressEvent(Phase.DRAWING), label="a")
        line = terminal.line()
        assert "a: drawing" in line and line.endswith("left -:--:--") and re.search(r"0:00:0\d", line)
        assert "╸" not in line and "╺" not in line


def test_nothing_moves_in_a_pipe(monkeypatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with progress(False, 3) as say:
        say(ProgressEvent(Phase.WHOLE_RUNS, "a: fitting", 1, 3), case=1)
    assert pipe.getvalue() == ""


def test_in_a_pipe_long_work_says_every_minute_that_it_goes_on(monkeypatch, capsys) -> None:
    monkeypatch.setattr(_progress, "LINE_EVERY", 0.05)
    with progress(quiet=False) as say:
        say(ProgressEvent(Phase.WHOLE_RUNS), label="level-board")
        time.sleep(0.2)
    told = capsys.readouterr()
    lines = told.err.splitlines()
    assert told.out == "" and len(lines) >= 2
    assert set(lines) == {"snakejax: level-board: fitting whole runs, 0 min so far"}
    time.sleep(0.1)
    assert capsys.readouterr().err == ""  # It ends with the work.


def test_in_a_pipe_short_or_quiet_work_says_nothing(monkeypatch, capsys) -> None:
    with progress(quiet=False) as say:
        say(ProgressEvent(Phase.WHOLE_RUNS))
    monkeypatch.setattr(_progress, "LINE_EVERY", 0.01)
    with progress(quiet=True) as say:
        say(ProgressEvent(Phase.WHOLE_RUNS))
        time.sleep(0.05)
    assert capsys.readouterr().err == ""
