"""Whether constants of the vehicle explain what an effect would."""

from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import exact_checks

SAMPLES = 10_000


@pytest.mark.parametrize(
    ("reached", "explained"), [([1.5, 1.001], True), ([2.9, 1.001], False), ([1.5, 1.4, 1.0], False)]
)
def test_the_fit_of_constants_goes_on_where_it_came_much_nearer(
    monkeypatch: pytest.MonkeyPatch, reached: list[float], explained: bool
) -> None:
    """It stops where a step did little, as in a valley that bends, and begins again where it stopped."""
    misfits, starts = iter(reached), []

    class Problem(SimpleNamespace):
        def fit(self, values, names, runs, start, crawl):
            starts.append(values)
            fitted = {"board.mass": 7.0 + 0.01 * len(starts)}
            return SimpleNamespace(misfit=next(misfits), samples=SAMPLES, loose=(), values=fitted, start=start)

    freed = Problem(names=("board.mass",), model=None)
    monkeypatch.setattr(exact_checks, "_with_free_constants", lambda *_: (freed, {"board.mass": 0.03}))
    monkeypatch.setattr(exact_checks, "parameters", lambda _: {"board.mass": SimpleNamespace(value=7.0)})
    base = SimpleNamespace(misfit=3.0, values={"board.mass": 7.0}, start=None)
    candidate_set: Any = SimpleNamespace(train=(0,))
    found = exact_checks.constants_explain(candidate_set, SimpleNamespace(solution=base, effects=()), {})  # type: ignore[arg-type]
    assert found is explained
    assert starts == [{"board.mass": 7.0}, {"board.mass": 7.01}][: 1 if reached[0] > 2 else 2]
