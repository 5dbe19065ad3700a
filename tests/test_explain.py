"""The score tests the loop rests on; the loop itself is tested where it is taught, in `test_studies.py`."""

import numpy as np
import pytest

from snakejax._explain import noise_band
from snakejax._score import Reduced, confusable, score
from snakejax.effects import GroundSlope, YawBias


def simulated(size, seed=0):
    """Residuals of unit noise plus `size` sd of the first of two candidates, beside one fitted column."""
    draw = np.random.default_rng(seed)
    n = 1200
    columns = np.stack([np.ones(n), np.sin(np.arange(n) / 50), np.cos(np.arange(n) / 70), draw.normal(size=n)], axis=1)
    residual = draw.normal(size=n) - size * columns[:, 1]
    return Reduced(residual, columns, np.arange(n) // 100, 0)


NAMES = ["tyre.D", "effects.slope.sx", "effects.slope.sy", "effects.bias.t"]
CANDIDATES = {"slope": NAMES[1:3], "bias": NAMES[3:]}


@pytest.fixture(scope="module")
def model():
    from snakejax import TABLE_II, Board, Model, Pacejka

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


def test_the_noise_band_is_that_of_chi_squared():
    """Misfits of pure noise lie within the band but for one in ten thousand."""
    low, high = noise_band(1000, 10)
    draws = np.random.default_rng(0).chisquare(990, 2000) / 1000
    assert np.mean((draws < low) | (draws > high)) < 0.005
