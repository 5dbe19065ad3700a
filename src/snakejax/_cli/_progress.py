"""The line that moves on a terminal: what is being done, how far it has come, and the time left."""

import contextlib
import re
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol


class Say(Protocol):
    """Tells what is being done, and how far it has come where that is known: `done` of `total`."""

    def __call__(self, message: str, done: int | None = None, total: int | None = None) -> None: ...


class Phase(NamedTuple):
    """A part of the work: what it is told with, how many seconds it usually takes, and whether it usually comes."""

    message: str
    seconds: float
    usual: bool = True


_FIT = (
    Phase("first seconds", 3.0),
    Phase(r"first \d", 0.5),
    Phase("fitting whole runs$", 3.0),
    Phase("fitting windows", 7.0, False),
    Phase("fitting whole runs more accurately", 6.0, False),
    Phase("aligning the clocks", 10.0, False),
    Phase("what noise in the joint logs does", 40.0, False),
    Phase("what the joint logs leave open", 10.0, False),
)
_DIAGNOSE = (
    Phase("fitting windows", 5.0),
    Phase("fitting whole runs$", 3.0),
    Phase(r"first (seconds|\d)", 4.0, False),
    Phase("fitting whole runs more accurately", 6.0, False),
    Phase("what noise in the joint logs does", 40.0, False),
    Phase("scoring candidates", 2.0),
    Phase("settling on windows", 5.0),
    Phase(r"settling \d+ candidates", 7.0),
    Phase(r"refitting \d+ candidates", 5.0),
    Phase("refitting with", 6.0, False),
)
_DRAWING = Phase("drawing", 5.0)
ROUTES: dict[str, tuple[Phase, ...]] = {
    "fit": (*_FIT, Phase("profile of", 10.0, False), _DRAWING),
    "compare": (*_FIT, Phase("comparing", 1.5), Phase("fitting (pacejka|rayleigh|ideal)", 10.0, False), _DRAWING),
    "diagnose": (*_DIAGNOSE, _DRAWING),
    "explain": (
        *_DIAGNOSE,
        Phase("does .* predict", 4.0),
        Phase("who acts beside", 12.0, False),
        Phase(r"refitting \d+ sets", 8.0, False),
        Phase("can the model do without", 5.0, False),
        Phase("estimating the missing force", 7.0, False),
        Phase("what does the missing force", 3.0, False),
        Phase("does .* survive", 20.0, False),
        _DRAWING,
    ),
}
"""What a command does one after the other. The seconds are those of a usual recording; their ratios are what counts."""


class Course:
    """How far one command has come, by what it tells, and when it will end.

    The phases behind it have taken so many times their usual seconds, and those before it will take as many. A phase
    that comes again does not bring it back.
    """

    def __init__(self, route: tuple[Phase, ...], cases: int, now: float) -> None:
        self.route, self.cases = route, cases
        self.case, self.place, self.begun, self.first = 0, 0, now, now

    def at(self, message: str, case: int, now: float) -> tuple[float, float | None]:
        """The share that is done, and the time at which all will be, if anything is known of it."""
        if case != self.case:
            self.case, self.place, self.begun = case, 0, now
        each = (self.begun - self.first) / case if case else None
        if not self.route:
            return case / self.cases, None if each is None else self.begun + (self.cases - case) * each
        found = [k for k, phase in enumerate(self.route) if re.match(phase.message, message)]
        self.place = max([self.place, *found])
        behind = sum(phase.seconds for phase in self.route[: self.place] if phase.usual)
        before = self.route[self.place].seconds
        before += sum(phase.seconds for phase in self.route[self.place + 1 :] if phase.usual)
        usual = each / (behind + before) if each is not None else 1.0
        pace = (now - self.begun) / behind if behind else usual
        each = pace * (behind + before) if each is None else each
        share = behind / (behind + before)
        return (case + share) / self.cases, now + pace * before + (self.cases - case - 1) * each


@contextlib.contextmanager
def progress(quiet: bool, cases: int = 1, command: str = "", drawing: bool = False) -> Iterator[Callable[..., None]]:
    """Say what goes on: one line that moves on a terminal, with a bar and the time left where they are known.

    What it gives is a `Say` that also takes `case`, how many of several CASEs are done, and a `label` to go before the
    message. What is not counted is placed on the route of the `command`.
    """
    from rich import progress as parts
    from rich.console import Console

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield lambda message, done=None, total=None, case=0, label="": None
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
        route = tuple(phase for phase in ROUTES.get(command, ()) if drawing or phase is not _DRAWING)
        course, begun, counted = Course(route, cases, time.monotonic()), 0.0, (None, None)

        def say(
            message: str, done: int | None = None, total: int | None = None, case: int = 0, label: str = ""
        ) -> None:
            nonlocal begun, counted
            now = time.monotonic()
            if total is None:
                came, ends = course.at(message, case, now)
                whole = None if ends is None else 1.0
            else:
                came, whole = float(done or 0), float(total)
                begun = now if total != counted[1] else begun
                ends = bar.tasks[0].fields["ends"] if (done, total) == counted else None
                ends = now + (now - begun) * (whole - came) / came if came and ends is None else ends
            counted = done, total
            bar.tasks[0].total = whole  # `update` takes None for no news
            bar.update(task, description=f"{label}: {message}" if label else message, completed=came, ends=ends)

        yield say


def _left_column():
    """The time left at the pace so far; Rich's own forgets a pace of less than two steps in half a minute."""
    from datetime import timedelta

    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Left(ProgressColumn):
        def render(self, task: Task) -> Text:
            ends = task.fields["ends"]
            left = "-:--:--" if ends is None else str(timedelta(seconds=max(int(ends - time.monotonic()), 0)))
            return Text(left, style="progress.remaining")

    return Left()
