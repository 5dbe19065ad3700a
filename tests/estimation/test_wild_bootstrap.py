"""The bootstrap of a fit, against the spread of fits to many made-up recordings."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from snakejax import TABLE_II, Board, Bootstrap, Gait, Model, Noise, Pacejka, Run, Sines, bootstrap, simulate
from snakejax.estimation.fitting import fit

NOISE = Noise(4e-4, 2.5e-3, "given")
TIMES = jnp.arange(400.0) * 0.02
TYRE = Pacejka(6.0, 1.4, 2.0, 0.0)
FREE = ["tyre.B", "tyre.D"]


def paths() -> list[tuple[Gait, np.ndarray]]:
    """Four gaits and the poses of the true board."""
    gaits = [Gait(Sines.of([[0.6, w, p]]), Sines.of([[1.2, w, 0.4]])) for w, p in ((3, 0), (4, 1), (5, 2), (6, 3))]
    model = Model(Board(**TABLE_II), TYRE, "coupled")
    return [(gait, np.asarray(simulate(model, gait, TIMES).pose)) for gait in gaits]


def fitted(true, draw: np.random.Generator, memory: float):
    """The fit to what cameras report of the `true` paths, with errors that have a memory (of 1 - memory a sample)."""
    runs = []
    for k, (gait, pose) in enumerate(true):
        errors = lfilter([np.sqrt(1 - memory**2)], [1, -memory], draw.normal(size=(450, 3)), axis=0)[50:]
        measured = jnp.asarray(pose + errors * np.asarray(NOISE.channels))
        runs.append(Run(f"run-{k}", "train", TIMES, measured, gait))
    return fit(Model(Board(**TABLE_II), Pacejka(5.5, 1.4, 2.2, 0.0), "coupled"), runs, NOISE, FREE)


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_the_spread_is_that_of_fits_to_many_recordings(memory: float) -> None:
    true, draw = paths(), np.random.default_rng(3)
    fits = [fitted(true, draw, memory) for _ in range(60)]
    actual = np.std([[one.estimates[name].value for name in FREE] for one in fits], axis=0)
    refits = [bootstrap(one, 60, seed=k) for k, one in enumerate(fits[:8])]
    spread = np.median([[np.std(one.values[name]) for name in FREE] for one in refits], axis=0)
    np.testing.assert_allclose(spread, actual, rtol=0.3)
    assert all(one.failed == 0 for one in refits)
    if memory:
        sd = [fits[0].estimates[name].sd for name in FREE]
        assert (actual > 2 * np.array(sd)).all(), "errors with a memory say less than the standard error counts"


def test_an_interval_holds_the_middle_of_the_refits() -> None:
    refits = Bootstrap({"tyre.D": np.arange(101.0)}, 0)
    assert refits.intervals() == {"tyre.D": (pytest.approx(2.5), pytest.approx(97.5))}
    assert refits.intervals(0.5) == {"tyre.D": (pytest.approx(25.0), pytest.approx(75.0))}


def test_the_same_seed_gives_the_same_refits_and_nothing_free_is_an_error() -> None:
    true = paths()[:2]
    one = fitted(true, np.random.default_rng(0), 0.0)
    first, again, other = (bootstrap(one, 4, seed=seed).values["tyre.D"] for seed in (1, 1, 2))
    np.testing.assert_allclose(first, again, rtol=1e-12)
    assert not np.allclose(first, other, rtol=1e-6)
    with pytest.raises(ValueError, match="Nothing was estimated"):
        bootstrap(fit(one.model, one.recordings, NOISE, []), 4)
