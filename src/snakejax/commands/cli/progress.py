"""The progress line on a terminal: current phase, share done, time left; elsewhere a line a minute."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from snakejax.core.progress import Phase, ProgressEvent


class ProgressLine(Protocol):
    """Shows an event, with `case`, the number of CASEs done, and a `label` in front of its sentence."""

    def __call__(self, event: ProgressEvent, /, case: int = 0, label: str = "") -> None: ...


class PhaseDuration(NamedTuple):
    """One phase on the route of a command: its usual duration [s], and whether it usually occurs."""

    phase: Phase
    seconds: float
    usual: bool = True


# The seconds only set the length of a bar.
_FIT = (
    PhaseDuration(Phase.FIRST_SECONDS, 3.0),
    PhaseDuration(Phase.LONGER_HORIZON, 0.5),
    PhaseDuration(Phase.WHOLE_RUNS, 3.0),
    PhaseDuration(Phase.WINDOWS, 7.0, False),
    PhaseDuration(Phase.TIGHTER_TOLERANCES, 6.0, False),
    PhaseDuration(Phase.LOG_CLOCKS, 10.0, False),
    PhaseDuration(Phase.LOG_NOISE, 40.0, False),
    PhaseDuration(Phase.LOG_CLOCK_ERRORS, 10.0, False),
)
# As above.
_DIAGNOSE = (
    PhaseDuration(Phase.WINDOWS, 5.0),
    PhaseDuration(Phase.WHOLE_RUNS, 3.0),
    PhaseDuration(Phase.FIRST_SECONDS, 4.0, False),
    PhaseDuration(Phase.LONGER_HORIZON, 0.5, False),
    PhaseDuration(Phase.TIGHTER_TOLERANCES, 6.0, False),
    PhaseDuration(Phase.LOG_NOISE, 40.0, False),
    PhaseDuration(Phase.SCORE_TESTS, 2.0),
    PhaseDuration(Phase.SCREENING, 5.0),
    PhaseDuration(Phase.SCREENING_CANDIDATES, 7.0),
    PhaseDuration(Phase.REFITTING_CANDIDATES, 5.0),
    PhaseDuration(Phase.REFITTING_OTHER_STRUCTURE, 6.0, False),
)
# As above.
_DRAWING = PhaseDuration(Phase.DRAWING, 5.0)
PHASES_OF: dict[str, tuple[PhaseDuration, ...]] = {
    "fit": (*_FIT, PhaseDuration(Phase.PROFILE, 10.0, False), PhaseDuration(Phase.BOOTSTRAP, 20.0, False), _DRAWING),
    "compare": (*_FIT, PhaseDuration(Phase.COMPARISON, 1.5), PhaseDuration(Phase.OTHER_MODELS, 10.0, False), _DRAWING),
    "diagnose": (*_DIAGNOSE, _DRAWING),
    "predict": (PhaseDuration(Phase.PREDICTION, 10.0), _DRAWING),
    "explain": (
        *_DIAGNOSE,
        PhaseDuration(Phase.TYRE_BESIDE_FORCE, 5.0, False),
        PhaseDuration(Phase.CHOOSING_EFFECTS, 15.0, False),
        PhaseDuration(Phase.FITTING_EFFECTS, 15.0, False),
        PhaseDuration(Phase.PREDICTIVE_CHECK, 4.0, False),
        PhaseDuration(Phase.PREDICTION, 4.0),
        PhaseDuration(Phase.BEAM_SEARCH, 12.0, False),
        PhaseDuration(Phase.REFITTING_SETS, 8.0, False),
        PhaseDuration(Phase.ELIMINATION, 5.0, False),
        PhaseDuration(Phase.LATENT_FORCE, 7.0, False),
        PhaseDuration(Phase.FORCE_REGRESSION, 3.0, False),
        PhaseDuration(Phase.LAW_SEARCH, 8.0, False),
        PhaseDuration(Phase.COEXISTING_EFFECTS, 20.0, False),
        PhaseDuration(Phase.LAW_FIT, 20.0, False),
        _DRAWING,
    ),
}
"""The phases of each command in order. The seconds are those of a usual recording; only their ratios matter."""


class ProgressEstimator:
    """The progress of one command, estimated from its phases, and the time at which it will end.

    The remaining phases are assumed to take as many times their usual seconds as the finished ones took. A phase that
    repeats does not move the progress back.
    """

    def __init__(self, route: tuple[PhaseDuration, ...], cases: int, now: float) -> None:
        self.route, self.cases = route, cases
        self.case, self.place, self.begun, self.first = 0, 0, now, now

    def at(self, phase: Phase, case: int, now: float) -> tuple[float, float | None]:
        """The share that is done, and the time at which all CASEs end [s], None where it is unknown."""
        if case != self.case:
            self.case, self.place, self.begun = case, 0, now
        each = (self.begun - self.first) / case if case else None
        if not self.route:
            return case / self.cases, None if each is None else self.begun + (self.cases - case) * each
        self.place = max([self.place, *(k for k, stop in enumerate(self.route) if stop.phase is phase)])
        seconds_done = sum(stop.seconds for stop in self.route[: self.place] if stop.usual)
        seconds_left = self.route[self.place].seconds
        seconds_left += sum(stop.seconds for stop in self.route[self.place + 1 :] if stop.usual)
        usual = each / (seconds_done + seconds_left) if each is not None else 1.0
        pace = (now - self.begun) / seconds_done if seconds_done else usual
        each = pace * (seconds_done + seconds_left) if each is None else each
        share = seconds_done / (seconds_done + seconds_left)
        return (case + share) / self.cases, now + pace * seconds_left + (self.cases - case - 1) * each


LINE_EVERY = 60.0
"""Seconds between the lines of a long computation whose output is no terminal."""


@contextlib.contextmanager
def _lines() -> Iterator[ProgressLine]:
    """One line every `LINE_EVERY` seconds on standard error: what is being done, and for how long."""
    begun, latest, ended = time.monotonic(), ["starting"], threading.Event()

    def report() -> None:
        while not ended.wait(LINE_EVERY):
            minutes = (time.monotonic() - begun) / 60
            with contextlib.suppress(OSError, ValueError):  # A reader that has gone does not end the work.
                print(f"snakejax: {latest[0]}, {minutes:.0f} min so far", file=sys.stderr, flush=True)

    def say(event: ProgressEvent, /, case: int = 0, label: str = "") -> None:
        count = f" ({event.done}/{event.total})" if event.total else ""
        latest[0] = f"{label}: {event.sentence}{count}" if label else f"{event.sentence}{count}"

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield say
    finally:
        ended.set()
        thread.join()


@contextlib.contextmanager
def progress(quiet: bool, cases: int = 1, command: str = "", drawing: bool = False) -> Iterator[ProgressLine]:
    """Show one progress line on a terminal, with a bar and the time left where they are known.

    An event without a count is placed on the route of the `command`; `drawing`: whether the route ends with figures.
    """
    from rich import progress as parts
    from rich.console import Console

    console = Console(stderr=True)
    if quiet:
        yield lambda _, case=0, label="": None
        return
    if not console.is_terminal:
        with _lines() as say:
            yield say
        return
    columns = (
        parts.SpinnerColumn(),
        parts.TextColumn("{task.description}"),
        parts.BarColumn(bar_width=20),
        parts.TimeElapsedColumn(),
        parts.TextColumn("left", style="dim"),
        _left_column(),
    )
    with parts.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None, ends=None)
        route = tuple(stop for stop in PHASES_OF.get(command, ()) if drawing or stop is not _DRAWING)
        estimator, begun, counted = ProgressEstimator(route, cases, time.monotonic()), 0.0, (None, None)

        def say(event: ProgressEvent, /, case: int = 0, label: str = "") -> None:
            nonlocal begun, counted
            now, count = time.monotonic(), (event.done, event.total)
            if event.total is None:
                completed, ends = estimator.at(event.phase, case, now)
                full = None if ends is None else 1.0
            else:
                completed, full = float(event.done or 0), float(event.total)
                begun = now if event.total != counted[1] else begun
                ends = bar.tasks[0].fields["ends"] if count == counted else None
                ends = now + (now - begun) * (full - completed) / completed if completed and ends is None else ends
            counted = count
            bar.tasks[0].total = full  # `update` ignores None
            sentence = f"{label}: {event.sentence}" if label else event.sentence
            bar.update(task, description=sentence, completed=completed, ends=ends)

        yield say


def _left_column():
    """The time left at the present pace; Rich's own column forgets paces below two steps in half a minute."""
    from datetime import timedelta

    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Left(ProgressColumn):
        def render(self, task: Task) -> Text:
            ends = task.fields["ends"]
            left = "-:--:--" if ends is None else str(timedelta(seconds=max(int(ends - time.monotonic()), 0)))
            return Text(left, style="progress.remaining")

    return Left()
