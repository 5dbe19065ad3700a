"""Effects that were chosen are chosen again where they are fitted: on made-up searches, and on a board with play."""

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.small_case import small

from snakejax.core.parameter import with_parameters
from snakejax.diagnosis.inexact import revision
from snakejax.diagnosis.inexact.candidate_model import candidate_model, movable_parameters
from snakejax.diagnosis.inexact.search import Point, Search
from snakejax.diagnosis.inexact.subsets import Subsets
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Pacejka
from snakejax.effects import SteeringBacklash, TyreRelaxation
from snakejax.estimation.discrepancy.least_squares import Prior
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.discrepancy.strength import scales_of
from snakejax.recording.run import Run
from snakejax.simulation.integrate import simulate

PLAY = 0.03
"""The play of the steering of the made-up board [rad]."""


def at(*effects: str) -> Any:
    return SimpleNamespace(effects=effects)


def made_up(monkeypatch: pytest.MonkeyPatch, again: dict[tuple[str, ...], list[str]], beside: dict) -> tuple[Any, list]:
    """A search whose fit of a set of effects proposes the set `again`, and an effect without a slope `beside` it."""
    fits: list[tuple[str, ...]] = []

    def refit(point, effects):
        fits.append(tuple(effects))
        point = SimpleNamespace(effects=tuple(effects), _replace=lambda effects: at(*effects))
        return SimpleNamespace(point=point, subsets=SimpleNamespace(without=lambda _: None))

    monkeypatch.setattr(revision, "slopeless", lambda *_: [])
    monkeypatch.setattr(revision, "masked_by_force", lambda *_: [])
    monkeypatch.setattr(revision, "choose", lambda _, effects: again.get(tuple(effects), list(effects)))

    def with_one(_, linear, tried):
        effect = beside.get(linear.point.effects)
        return None if effect is None or effect in tried else at(*linear.point.effects, effect)

    monkeypatch.setattr(revision, "with_slopeless_effect", with_one)
    monkeypatch.setattr(revision, "from_further_values", lambda *_: None)
    return SimpleNamespace(progress=lambda _: None, refit=refit), fits


def test_an_effect_without_a_slope_is_tried_at_the_end(monkeypatch) -> None:
    search, fits = made_up(monkeypatch, {("a",): ["a", "b"], ("a", "b", "play"): ["b", "play"]}, {("a", "b"): "play"})
    assert revision.revised(search, at("a")).point.effects == ("b", "play")
    assert fits == [("a",), ("a", "b"), ("a", "b", "play"), ("b", "play")]


def test_an_effect_without_a_slope_that_does_not_stay_is_tried_once(monkeypatch) -> None:
    search, fits = made_up(monkeypatch, {("a", "play"): ["a"]}, {("a",): "play"})
    assert revision.revised(search, at("a")).point.effects == ("a", "play")
    assert fits == [("a",), ("a", "play")], "the set without it was fitted, and is not fitted again"


def test_sets_that_propose_each_other_are_fitted_once(monkeypatch) -> None:
    search, fits = made_up(monkeypatch, {("a",): ["b"], ("b",): ["a"]}, {})
    assert revision.revised(search, at("a")).point.effects == ("b",)
    assert fits == [("a",), ("b",)]


@pytest.mark.parametrize(
    ("end", "converged", "other", "kept"),
    [
        (90.0, True, 50.0, "rounds"),
        (110.0, True, 50.0, "chosen"),
        (110.0, True, 120.0, "rounds"),
        (90.0, False, 50.0, "chosen"),
    ],
)
def test_rounds_that_lead_astray_are_left(monkeypatch, end: float, converged: bool, other: float, kept: str) -> None:
    """The model without effects at which they began has a -2 log likelihood of 100. Where they end above it, or did not
    end `converged`, effects are chosen there, and the likelier end is kept."""
    ends = {("rounds",): end, ("chosen",): other}
    search = SimpleNamespace(
        progress=lambda _: None,
        begin=lambda: at(),
        linearise=lambda point: SimpleNamespace(
            point=SimpleNamespace(effects=(), discrepancy=None, _replace=lambda effects: at(*effects)),
            subsets=SimpleNamespace(without=lambda _: None),
        ),
    )
    monkeypatch.setattr(revision, "rounds", lambda *_: at("rounds"))
    monkeypatch.setattr(revision, "revised", lambda _, point: SimpleNamespace(point=point, has_converged=converged))
    monkeypatch.setattr(revision, "choose", lambda *_: ["chosen"])
    monkeypatch.setattr(revision, "slopeless", lambda *_: [])
    monkeypatch.setattr(revision, "_penalised", lambda linear: ends[linear.point.effects])
    monkeypatch.setattr(revision, "_deviance", lambda *_: 100.0)
    found: Any = revision.search_effects(search)  # type: ignore[arg-type]
    assert found.point.effects == (kept,)


@pytest.mark.parametrize(
    ("needed", "found"), [({"a"}, ["a"]), ({"a", "b"}, ["a", "b"]), ({"a", "b", "g"}, [])], ids=["one", "two", "none"]
)
def test_effects_whose_place_a_random_force_has_taken_are_found_together(monkeypatch, needed, found) -> None:
    """It is as large as before until all that are `needed` are there; a and b act, and nothing says that g does."""
    subsets = Subsets(
        gram=np.diag([3000.0, 1.0, 1.0, 1.0, 1.0]) + LOADED,
        always=(),
        candidates=OrderedDict(a=(0,), b=(1,), c=(2,), g=(3,)),
        prior=Prior(np.zeros(4), np.full(4, 1e-6)),
        low=np.full(4, -np.inf),
        high=np.full(4, np.inf),
    )
    linear: Any = SimpleNamespace(
        point=SimpleNamespace(effects=("c",), discrepancy=None), subsets=subsets, under=lambda _: subsets
    )
    monkeypatch.setattr(revision, "slopeless", lambda *_: [])
    monkeypatch.setattr(revision, "_estimated", lambda *_: None)
    monkeypatch.setattr(revision, "_deviance", lambda _, __, effects: 0.0 if needed <= set(effects) else 1000.0)
    assert revision.masked_by_force(None, linear) == found  # type: ignore[arg-type]


LOADED = np.zeros((5, 5))
LOADED[0, 1:4] = LOADED[1:4, 0] = 30.0
"""Of a, b and c, each of which lowers chi^2 by 900."""


@pytest.mark.parametrize(("value", "found"), [(0.0029, 0.0042), (0.0042, None)])
def test_a_second_optimum_further_away_is_found(monkeypatch, value: float, found: float | None) -> None:
    """A tyre that relaxes over 4.2 mm; every fit from below 3 mm ends at 2.9 mm. The slope of the floor has a
    derivative at zero, and is not tried."""

    def refit(point: Point, effects: tuple[str, ...]) -> Any:
        ends = 0.0042 if point.values[0] > 0.003 else 0.0029
        return SimpleNamespace(point=point._replace(values=np.array([ends, point.values[1]])))

    segments = SimpleNamespace(with_steady_memories=lambda values, z, effect: z)
    model = SimpleNamespace(candidates={"tyre_relaxation": (0,), "ground_slope": (1,)}, probes={0: 0.002})
    search: Any = SimpleNamespace(segments=segments, model=model, criteria=CRITERIA, refit=refit)
    likelier = {0.0029: -336_321.0, 0.0042: -338_789.0}
    monkeypatch.setattr(revision, "_penalised", lambda linear: likelier[linear.point.values[0]])
    point = Point(np.array([value, 0.003]), np.zeros(1), None, ("tyre_relaxation", "ground_slope"))  # type: ignore[arg-type]
    linear: Any = revision.from_further_values(search, SimpleNamespace(point=point))  # type: ignore[arg-type]
    assert (None if linear is None else tuple(linear.point.values)) == (None if found is None else (found, 0.003))


def test_the_memories_of_a_tyre_stay_while_another_effect_is_tried() -> None:
    """Set to those of a steady slip, they are 16 000 in chi^2 off at a fine noise."""
    case, _, _ = small()
    effects = OrderedDict(steering_backlash=SteeringBacklash(), tyre_relaxation=TyreRelaxation())
    model = Model(case.board, Pacejka(8.0, 1.3, 0.9, 0.2), "free", effects)
    segments = Segments(model, case.having("train"), ["effects.steering_backlash.b", "effects.tyre_relaxation.sigma"])
    values, z = np.array([0.01, 0.02]), segments.guess()
    assert np.array_equal(segments.with_steady_memories(values, z, "steering_backlash"), z)
    steady = segments.with_steady_memories(values, z)
    assert np.array_equal(segments.with_steady_memories(values, z, "tyre_relaxation"), steady)
    assert not np.allclose(steady, z)


@pytest.mark.slow
@pytest.mark.parametrize("play", [0.0, PLAY])
def test_the_play_of_a_steering_is_found_though_it_has_no_slope(play: float) -> None:
    """Against simulations: where the board has none, none is found."""
    case, noise, _ = small()
    effects = OrderedDict(steering_backlash=SteeringBacklash(), tyre_relaxation=TyreRelaxation())
    model = Model(case.board, Pacejka(8.0, 1.3, 0.9, 0.2), "free", effects)
    true = with_parameters(model, {"effects.steering_backlash.b": play})
    rng = np.random.default_rng(0)
    runs = []
    for run in case.runs:
        pose = np.asarray(simulate(true, run.gait, run.times).pose)
        runs.append(
            Run(run.name, "train", run.times, pose + rng.normal(size=pose.shape) * np.asarray(noise.channels), run.gait)
        )
    candidates = {
        "steering_backlash": ("effects.steering_backlash.b",),
        "tyre_relaxation": ("effects.tyre_relaxation.sigma",),
    }
    names = movable_parameters(model, ("tyre.D",), candidates, ())
    segments = Segments(model, runs, names)
    scales = scales_of(segments, np.asarray(noise.channels), noise.correlation)
    search = Search(segments, candidate_model(model, ("tyre.D",), candidates, (), scales, {}), scales)
    linear = search.refit(search.begin(), ())
    found = revision.with_slopeless_effect(search, linear, ())
    if not play:
        assert found is None
        return
    assert isinstance(found, Point) and found.effects == ("steering_backlash",)
    fitted = search.refit(found, found.effects)
    k = names.index("effects.steering_backlash.b")
    assert abs(search.values(fitted)[k] - PLAY) < 4 * fitted.optimum.sd[k]
