"""When known effects are kept beside a law; the search itself is that of any base (tests/diagnosis/selection)."""

import dataclasses
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from snakejax.diagnosis.law import known_effects
from snakejax.diagnosis.law.fitting import AddedLaws


@pytest.fixture
def laws() -> Any:
    """A law of a force, fitted, that leaves a misfit near 9 of each of three runs left out."""
    model = SimpleNamespace(effects={"law_1": "the law", "ground_slope": "the slope"})
    fit = SimpleNamespace(effects=("law_1",), solution=SimpleNamespace(values={"effects.law_1.a": 2.0, "tyre.D": 5.0}))
    candidate_set = SimpleNamespace(problem=SimpleNamespace(model=model))
    return AddedLaws(("X = a * u",), candidate_set, fit, np.array([9.0, 8.0, 10.0]))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("found", "left_out", "kept"),
    [
        (["slope"], [1.0, 1.1, 0.9], True),
        (["slope"], [9.0, 8.1, 9.9], False),
        (["slope"], [1.0, 40.0, 60.0], False),
        ([], [1.0, 1.0, 1.0], False),
    ],
)
def test_known_effects_are_kept_beside_a_law_where_they_predict_runs_left_out(
    monkeypatch: pytest.MonkeyPatch, laws: Any, found: list[str], left_out: list[float], kept: bool
) -> None:
    begun = {}
    neutral = {"tyre.D": 1.0, "effects.law_1.a": 0.0, "effects.ground_slope.sx": 0.0}
    problem = SimpleNamespace(values=lambda: dict(neutral))

    def candidates(case, noise, like, effects, built):
        assert effects == ("ground_slope", "yaw_bias") and built == {"law_1": "the law"}
        return SimpleNamespace(problem=problem)

    def refit(candidate_set, effects, values):
        begun.update(values)
        return "solution"

    steps_found = [SimpleNamespace(step=SimpleNamespace(solution=name)) for name in found]
    monkeypatch.setattr(known_effects, "candidate_set_with", candidates)
    monkeypatch.setattr(known_effects, "refit", refit)
    monkeypatch.setattr(known_effects, "rank", lambda *_, **__: [])
    monkeypatch.setattr(known_effects, "stepwise_selection", lambda *_: list(steps_found))
    monkeypatch.setattr(known_effects, "consistent_with_noise", lambda _: False)
    monkeypatch.setattr(known_effects, "_converged", lambda step: SimpleNamespace(step="fitted on"))
    monkeypatch.setattr(known_effects, "left_out_misfits", lambda _, step: np.array(left_out))
    like: Any = SimpleNamespace(candidates={"ground_slope": (), "yaw_bias": ()})
    taken = known_effects.known_effects_beside(None, None, like, laws, lambda _: None)  # type: ignore[arg-type]
    assert len(taken) == kept and all(each.step == "fitted on" for each in taken)
    assert begun == {"tyre.D": 5.0, "effects.law_1.a": 2.0, "effects.ground_slope.sx": 0.0}, "from the fit of the law"


@pytest.mark.parametrize(("left_out", "kept"), [([1.0, 1.1, 0.9], True), ([9.0, 8.1, 9.9], False)])
def test_a_law_is_searched_again_beside_the_effects_that_were_found_beside_it(
    monkeypatch: pytest.MonkeyPatch, laws: Any, left_out: list[float], kept: bool
) -> None:
    """The new law replaces the old one where it predicts runs left out better, and the steps lead to it."""
    asked: dict[str, Any] = {}
    values = {"tyre.D": 5.0, "effects.ground_slope.sx": 0.003, "effects.law_1.a": 2.0}
    last: Any = SimpleNamespace(
        step=SimpleNamespace(effects=("law_1", "ground_slope"), solution=SimpleNamespace(values=values, misfit=1.2)),
        candidate_set="with the old law",
    )
    neutral = {"tyre.D": 1.0, "effects.ground_slope.sx": 0.0}
    base = FakeSolution({"tyre.D": 1.0}, 300.0)
    like: Any = SimpleNamespace(
        step=SimpleNamespace(effects=(), solution=base),
        candidate_set=SimpleNamespace(problem=SimpleNamespace(values=lambda: dict(neutral))),
    )
    new = AddedLaws(
        ("X = a * phi^2",),  # type: ignore[arg-type]
        "with the new law",  # type: ignore[arg-type]
        SimpleNamespace(effects=("ground_slope", "law_1")),  # type: ignore[arg-type]
        np.array(left_out),
    )

    def estimate(candidate_set, start, progress):
        asked["start"] = start
        return Force()

    def best(case, noise, on, before, force, progress):
        asked["beside"] = force.beside
        return [new]

    monkeypatch.setattr(known_effects, "estimate_latent_force", estimate)
    monkeypatch.setattr(known_effects, "best_laws", best)
    monkeypatch.setattr(known_effects, "left_out_misfits", lambda _, step: np.array([3.0, 3.1, 2.9]))
    monkeypatch.setattr(known_effects, "fitted_laws", lambda *arguments: ("alone", arguments[3]))
    monkeypatch.setattr(known_effects, "selection_step", lambda _, change, name, fit: (change, name, fit))
    again = known_effects.law_beside_effects(None, None, like, last, laws, lambda _: None)  # type: ignore[arg-type]
    assert asked["start"].effects == ("ground_slope",) and asked["beside"] == ("ground_slope",)
    assert asked["start"].solution == FakeSolution({"tyre.D": 5.0, "effects.ground_slope.sx": 0.003}, 1.2)
    assert (again is not None) == kept
    if again is not None:
        assert again.steps == [("added", "law_1", ()), ("added", "ground_slope", new.fit)]


class FakeSolution(NamedTuple):
    values: dict[str, float]
    misfit: float


@dataclasses.dataclass
class Force:
    """A force in which laws were searched."""

    beside: tuple[str, ...] = ()

    def with_laws(self) -> "Force":
        return self
