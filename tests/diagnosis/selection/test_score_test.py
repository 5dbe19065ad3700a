"""The score tests the loop rests on; the loop itself is tested where it is taught, in `tests/studies`."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from snakejax import TABLE_II, Board, Case, Gait, Model, Noise, Pacejka, Run, Sines, simulate
from snakejax.core.local_polynomials import local_cubics
from snakejax.diagnosis import diagnose
from snakejax.diagnosis.selection.score_test import ProjectedResiduals, confusable, project_starts, score
from snakejax.effects import ComOffset, GripSplit, GroundSlope, YawBias
from snakejax.estimation.goodness_of_fit import largest_noise_misfit
from snakejax.estimation.linearisation import Linearised
from snakejax.estimation.multiple_shooting import SMOOTHING


def simulated(size, seed=0):
    """Residuals of unit noise plus `size` sd of the first of two candidates, beside one fitted column."""
    draw = np.random.default_rng(seed)
    n = 1200
    columns = np.stack([np.ones(n), np.sin(np.arange(n) / 50), np.cos(np.arange(n) / 70), draw.normal(size=n)], axis=1)
    residual = draw.normal(size=n) - size * columns[:, 1]
    return ProjectedResiduals(residual, columns, np.arange(n) // 100, 0)


NAMES = ["tyre.D", "effects.slope.sx", "effects.slope.sy", "effects.bias.t"]
CANDIDATES = {"slope": NAMES[1:3], "bias": NAMES[3:]}


@pytest.fixture(scope="module")
def model():
    return Model(Board(**TABLE_II), Pacejka(B=8.0, C=1.4, D=7.0, E=0.0), "free").add(
        slope=GroundSlope(), bias=YawBias()
    )


def scored(model, rest):
    values = {name: 0.0 for name in NAMES} | {"tyre.D": 7.0}
    return score(model, NAMES, rest, NAMES[:1], CANDIDATES, values)


def test_the_score_gives_the_size_of_what_is_there(model):
    best = scored(model, simulated(0.5))[0]
    assert best.effect == "slope"
    assert best.p_value < 1e-6
    assert abs(best.values["effects.slope.sx"] - 0.5) < 4 * best.sd["effects.slope.sx"]
    assert abs(best.values["effects.slope.sy"]) < 4 * best.sd["effects.slope.sy"]


def test_p_values_of_the_score_are_not_too_small_without_an_effect(model):
    """Corrected for the family, at most 5% of the best candidates of pure noise fall below 0.05."""
    smallest = [min(s.p_value for s in scored(model, simulated(0.0, seed))) for seed in range(300)]
    assert np.mean(np.array(smallest) < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 300)


def test_candidates_with_one_signature_are_confusable(model):
    rest = simulated(0.5)
    twins = rest._replace(columns=np.concatenate([rest.columns[:, :3], rest.columns[:, 1:2]], axis=1))
    found = confusable(scored(model, twins))
    assert found["bias"] == ["slope"] and found["slope"] == ["bias"]


def test_without_candidates_nothing_is_confusable():
    assert confusable([]) == {}


def test_a_weak_effect_is_confusable_with_what_is_half_like_it_and_a_strong_one_is_not(model):
    """A column at 45 degrees to the true one leaves half of what it explains: too little of 20, plenty of 2000."""
    for size, alike in ((0.19, ["slope"]), (1.9, [])):
        rest = simulated(size)
        unit = rest.columns / np.sqrt((rest.columns**2).sum(axis=0))
        half = (unit[:, 1] + unit[:, 3])[:, None] * 20
        rest = rest._replace(columns=np.concatenate([rest.columns[:, :3], half], axis=1))
        assert confusable(scored(model, rest))["bias"] == alike


def test_what_explains_far_more_is_told_from_a_weaker_likeness(model):
    """Four fifths of what the likeness explains, the other explains too: no rival where it explains the rest as well,
    and one where it does not.
    """
    slope, bias = (s for s in scored(model, simulated(0.5)))
    along, across = np.eye(slope.span.shape[0])[:2]
    slope = slope._replace(signature=along, span=along[:, None], p_value=0.0)
    likeness = np.sqrt(0.8) * along + np.sqrt(0.2) * across
    bias = bias._replace(signature=likeness, span=likeness[:, None], statistic=30.0, p_value=1e-6)
    assert confusable([slope._replace(statistic=3000.0), bias]) == {slope.effect: [], bias.effect: []}
    rivals = {slope.effect: [bias.effect], bias.effect: [slope.effect]}
    assert confusable([slope._replace(statistic=32.0), bias]) == rivals


def test_noise_alone_hardly_ever_leaves_more_than_its_largest_misfit():
    """chi^2 exceeds it less often than once in three thousand, and once in a hundred thousand or more."""
    assert 1e-5 < stats.chi2.sf(1000 * largest_noise_misfit(1000, 10), 990) < 1 / 3000


@pytest.mark.long
def test_a_candidate_that_the_runs_cannot_show_is_named_with_the_reason():
    """Under the coupled structure a split of the grip cancels where the wheelsets steer opposite ways."""
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=8.0, C=1.4, D=3.0, E=0.0), "coupled")
    times, noise = jnp.arange(200) / 50, Noise(4e-4, 2.5e-3, "given")
    gait = Gait(Sines.of([[0.6, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.3]]))
    pose = np.asarray(simulate(model, gait, times).pose)
    seen = pose + np.random.default_rng(0).normal(size=pose.shape) * np.asarray(noise.channels)
    runs = (Run("one", "train", times, jnp.asarray(seen), gait),)
    case = Case("made", "a board made up", "coupled", model.board, runs, noise)
    candidates = {"grip_split": GripSplit(), "com_offset": ComOffset(), "yaw_bias": YawBias()}
    base = diagnose(case, noise, candidates, switch=False).base
    assert [candidate.effect for candidate in base.ranking] == ["yaw_bias"]
    assert set(base.left_out) == {"grip_split", "com_offset"}
    assert "opposite wheel angles" in base.left_out["grip_split"]


def test_velocities_are_those_of_local_cubics():
    """A cubic in time comes out whole, over lost frames and at both ends; else the fit through what is near."""
    t = np.arange(1200) / 100
    cubic = np.stack([0.1 * t**3 - t, 0.5 * t**2 + 1, 0.3 * t], axis=1)
    slope = np.stack([0.3 * t**2 - 1, t, 0.3 * np.ones_like(t)], axis=1)
    wild = np.cumsum(np.random.default_rng(0).normal(size=(1200, 3)), axis=0)
    for lost in (np.zeros(1200, bool), np.isin(np.arange(1200), [0, 5, 300, *range(600, 700), 1199])):
        pose, rate = local_cubics(t, np.where(lost[:, None], np.nan, cubic), SMOOTHING)
        np.testing.assert_allclose(pose, cubic, atol=1e-9)
        np.testing.assert_allclose(rate, slope, atol=1e-8)
        pose, rate = local_cubics(t, np.where(lost[:, None], np.nan, wild), SMOOTHING)
        for k in (0, 7, 40, 298, 599, 730, 1190):
            near = (np.abs(t - t[k]) < 0.125) & ~lost
            c = np.polyfit(t[near] - t[k], wild[near], 3)
            np.testing.assert_allclose((pose[k], rate[k]), (c[-1], c[-2]), atol=1e-7)


def test_runs_are_numbered_as_they_come() -> None:
    """And not by their names: an odd run would be called by the name of another."""
    rng = np.random.default_rng(0)
    linearised = Linearised(rng.normal(size=(4, 10, 3)), rng.normal(size=(4, 10, 3, 2 + 3)))
    times = np.tile(np.arange(10) / 10, (4, 1))
    rest = project_starts(linearised, np.ones((4, 3)), [0, 2, 3], times, 1.5, ["rotate", "forward", "arc", "rotate"])
    assert rest.run is not None and rest.run.tolist() == [0] * 30 + [1] * 30 + [0] * 30
