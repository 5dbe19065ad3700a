"""The steps of an explanation whose model is not exact: effect after effect, fitted to whole runs."""

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from snakejax.diagnosis.inexact import steps


@pytest.mark.parametrize("second", [3.0, 9.0])
def test_a_step_before_the_last_starts_at_the_values_of_the_assessment(
    monkeypatch: pytest.MonkeyPatch, second: float
) -> None:
    """What is absent is neutral there. Where a step ends with more than the step before, which ends at 5, it is fitted
    again from where that one ended; the last step is not fitted, but has the values of the assessment."""
    starts: list[dict[str, float]] = []
    misfits = iter([5.0, second, 4.0])

    class Problem(SimpleNamespace):
        def fit(self, settings, free, runs):
            return SimpleNamespace(misfit=1.0, free=free)

    def to_whole_runs(assessment, known, free):
        starts.append(known)
        reached = known | {"tyre.D": known["tyre.D"] + 1.0}
        return steps._FittedStep(None, reached, SimpleNamespace(misfit=next(misfits), free=free), True)  # type: ignore[arg-type]

    names = ("tyre.D", "board.mass", "effects.a.k", "effects.b.k", "effects.c.k")
    model = SimpleNamespace(
        names=names,
        neutral=np.array([5.0, 7.0, 0.0, 0.0, 1.0]),
        candidates=OrderedDict(a=(2,), b=(3,), c=(4,)),
        constants=(1,),
    )
    candidate_set = SimpleNamespace(
        switched=False,
        free=lambda effects: ["tyre.D", *(f"effects.{effect}.k" for effect in effects)],
        problem=SimpleNamespace(values=dict),
        train=(0,),
    )

    class Assessed(SimpleNamespace):
        values = property(lambda self: np.array([6.0, 7.5, 0.1, 0.2, 0.9]))

    events: list[str] = []
    search = SimpleNamespace(model=model, progress=lambda event: events.append(str(event)))
    assessment: Any = Assessed(
        base=(), effects=("a", "b", "c"), candidate_set=candidate_set, converged=True, search=search
    )
    monkeypatch.setattr(steps, "_to_whole_runs", to_whole_runs)
    monkeypatch.setattr(steps, "_problem", lambda assessment, known: Problem())
    monkeypatch.setattr(steps, "_step", lambda assessment, name, effects, fitted: (name, effects, fitted.known))

    shown: Any = steps.steps_of(assessment)

    assert events == [f"refitting sets of effects on whole runs ({k} of 3)" for k in (1, 2, 3)]
    first = dict(zip(names, (6.0, 7.5, 0.1, 0.0, 1.0), strict=True))
    assert starts[:2] == [first, first | {"effects.b.k": 0.2}]
    assert starts[2:] == ([] if second < 5.0 else [first | {"tyre.D": 7.0}])
    assert [(name, effects) for name, effects, _ in shown] == [("a", ("a",)), ("b", ("a", "b")), ("c", ("a", "b", "c"))]
    assert shown[-1][2] == dict(zip(names, (6.0, 7.5, 0.1, 0.2, 0.9), strict=True))

    misfits, starts[:] = iter([6.0]), []
    alone: Any = steps.beside_stated_constants(assessment, ("a",))
    assert alone[1] == ("a",) and starts == [first | {"board.mass": 7.0}], "the mass has its stated value"
