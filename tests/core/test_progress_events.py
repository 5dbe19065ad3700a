"""Events of progress: what a callable given by the user receives."""

import numpy as np

from snakejax.core.progress import Phase, ProgressEvent
from snakejax.design.slsqp import ProblemValue, minimise_from_starts
from snakejax.simulation.chunks import map_chunks
from snakejax.simulation.ensemble import CHUNK


def test_an_event_prints_as_its_sentence() -> None:
    assert str(ProgressEvent(Phase.WINDOWS)) == "fitting windows"
    assert str(ProgressEvent(Phase.PROFILE, "profile of tyre.D")) == "profile of tyre.D"
    assert str(ProgressEvent(Phase.SWEEP, done=3, total=4)) == "sweeping (3 of 4)"


def test_no_two_phases_have_the_same_sentence() -> None:
    assert len({phase.value for phase in Phase}) == len(Phase.__members__)


def test_print_is_a_listener(capsys) -> None:
    map_chunks(lambda columns: columns, {"a": np.zeros(CHUNK)}, progress=print)
    assert capsys.readouterr().out == f"sweeping (0 of {CHUNK})\nsweeping ({CHUNK} of {CHUNK})\n"


def test_a_minimisation_counts_its_iterations_to_the_end() -> None:
    def bowl(x: np.ndarray) -> ProblemValue:
        none = np.zeros((0, x.size))
        return ProblemValue(float(x @ x), 2 * x, np.zeros(0), none, np.ones(1), np.zeros((1, x.size)))

    events: list[ProgressEvent] = []
    ends = np.full(2, 5.0)
    minima = minimise_from_starts(bowl, [np.ones(2), -np.ones(2)], (-ends, ends), 7, events.append)
    assert all(np.abs(minimum.unknowns).max() < 1e-3 for minimum in minima)
    assert {event.phase for event in events} == {Phase.OPTIMISATION} and {event.total for event in events} == {14}
    assert events[-1].done == 14
