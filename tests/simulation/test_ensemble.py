"""Many boards side by side against diffrax, board by board."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import ROOT
from helpers.many_boards import scattered

from snakejax import TABLE_II, Accuracy, Board, Model, Pacejka, Sines, preset, simulate, simulate_many
from snakejax.core.parameter import with_parameters
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.effects import BodyDrag, ClockOffset, GroundSlope, TyreRelaxation
from snakejax.simulation.ensemble import BLOCK, CHUNK, stacked
from snakejax.vehicles.car import DART, Car
from snakejax.vehicles.sleigh import ICE_SLEIGH, Sleigh

SHARP = Accuracy(rtol=1e-11, atol=1e-13, max_steps=10**6)
SHARPER = Accuracy(rtol=1e-12, atol=1e-14, max_steps=10**6)  # diffrax interpolates between its steps


def one_by_one(models: Model, gait, times, start) -> np.ndarray:
    """The same boards by diffrax, one after the other."""
    run = jax.jit(lambda model, at: simulate(model, gait, times, at, accuracy=SHARPER).pose)
    count = start.shape[0]
    return np.stack([run(jax.tree.map(lambda leaf, k=k: leaf[k], models), start[k]) for k in range(count)])


EFFECTS = {
    "none": {},
    "sensor clock and force": {"clock_offset": ClockOffset(T=0.03), "ground_slope": GroundSlope(sx=0.002)},
    "memory, sensor clock and force": {
        "tyre_relaxation": TyreRelaxation(sigma=0.05),
        "clock_offset": ClockOffset(T=0.03),
        "ground_slope": GroundSlope(sx=0.002),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("constraint", "effects", "engine"),
    [
        pytest.param("coupled", "memory, sensor clock and force", "tsit5", marks=pytest.mark.long),
        ("free", "memory, sensor clock and force", "tsit5"),
        pytest.param("ideal", "none", "tsit5", marks=pytest.mark.long),
        ("ideal", "none", "fastest"),
        pytest.param("free", "sensor clock and force", "fastest", marks=pytest.mark.long),
        ("coupled", "sensor clock and force", "fastest"),
    ],
)
def test_members_agree_with_diffrax(constraint, effects, engine) -> None:
    example = preset("paper-forward")
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(8.0, 1.4, 4.0, 0.1), constraint, EFFECTS[effects])
    models = scattered(model, 5)
    start = np.random.default_rng(1).normal(size=(5, 3))
    times = np.linspace(0.0, 4.0, 9)
    # At SHARP a stiff board is off by 1e-9 itself.
    found = simulate_many(models, example.gait, times, start, accuracy=SHARPER, engine=engine)
    np.testing.assert_allclose(found, one_by_one(models, example.gait, times, start), rtol=0, atol=1e-9)


def in_motion(kind: str) -> tuple[list[Model], Inputs]:
    """A sleigh, which goes on as it was pushed, or a car whose commands have another clock; of each, two with another
    tyre."""
    tyres = [Pacejka(4.0, 1.3, D, 0.1) for D in (3.0, 5.0)]
    if kind == "sleigh":
        return [Model(Sleigh(**ICE_SLEIGH), tyre, "free", {"body_drag": BodyDrag(c=0.4)}) for tyre in tyres], Inputs({})
    car, effects = Car(**DART, force_gain=20.0, speed_loss=2.0), {"clock_offset": ClockOffset(T=0.03)}
    inputs = {"steer": Sines.of([[0.3, 2.0, 0.4]]), "drive": Sines.of([[0.3, 1.0, 1.0]])}
    return [Model(car, FrontRear(tyre, tyre), "free", effects) for tyre in tyres], Inputs(inputs)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["tsit5", "fastest"])
@pytest.mark.parametrize("kind", ["sleigh", "car"])
def test_members_start_in_motion(kind, engine) -> None:
    members, inputs = in_motion(kind)
    models = stacked(members)
    start = np.array([[0.1, 0.2, 0.3, 0.5, 0.05, 2.0], [0.0, 0.0, 1.0, 0.8, -0.1, 1.0]])
    times = np.linspace(0.0, 2.0, 5)
    poses = simulate_many(models, inputs, times, start, accuracy=SHARPER, engine=engine)
    np.testing.assert_allclose(poses, one_by_one(models, inputs, times, start), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_number_of_lanes_and_threads_changes_no_bit() -> None:
    example = preset("paper-rotate")
    models = scattered(example.model, CHUNK + BLOCK + 3)
    times = np.linspace(0.0, 2.0, 3)
    all_ = simulate_many(models, example.gait, times, workers=2)
    assert all_.shape == (CHUNK + BLOCK + 3, 3, 3)
    np.testing.assert_array_equal(all_, simulate_many(models, example.gait, times, workers=1))
    few = simulate_many(jax.tree.map(lambda leaf: leaf[CHUNK:], models), example.gait, times)
    np.testing.assert_array_equal(all_[CHUNK:], few)


@pytest.mark.slow
def test_each_lane_can_have_a_gait_of_its_own() -> None:
    slow, fast = preset("paper-rotate"), preset("paper-forward")
    gaits = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), slow.gait, fast.gait)
    times = np.linspace(0.0, 3.0, 4)
    found = simulate_many(stacked([slow.model, slow.model]), gaits, times, own_gaits=True)
    for pose, gait in zip(found, (slow.gait, fast.gait), strict=True):
        alone = simulate_many(stacked([slow.model]), gait, times)[0]
        np.testing.assert_allclose(pose, alone, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_lane_that_gives_up_is_infinite_and_harms_no_other() -> None:
    example = preset("paper-rotate")
    models = with_parameters(stacked([example.model] * 2), {"tyre.D": jnp.array([1.0, 1e9])})
    found = simulate_many(models, example.gait, [1.0, 2.0], accuracy=Accuracy(rtol=1e-7, atol=1e-9, max_steps=5000))
    assert np.isfinite(found[0]).all() and np.isinf(found[1]).all()


@pytest.mark.long
def test_eight_devices_share_the_lanes_and_find_the_same(tmp_path: Path) -> None:
    example = preset("paper-rotate")
    times = np.linspace(0.0, 2.0, 3)
    alone = simulate_many(scattered(example.model, 2 * CHUNK + 77), example.gait, times, engine="tsit5")
    script = tmp_path / "sharded.py"
    script.write_text(
        "import snakejax, sys, numpy as np\n"
        "snakejax.prepare_jax()\n"
        "import jax\n"
        f"sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        "from helpers.many_boards import scattered\n"
        "from snakejax import preset, simulate_many\n"
        "from snakejax.simulation.ensemble import CHUNK\n"
        "assert jax.local_device_count() == 8\n"
        "example = preset('paper-rotate')\n"
        "found = simulate_many(scattered(example.model, 2 * CHUNK + 77), example.gait, np.linspace(0.0, 2.0, 3))\n"
        "np.save(sys.argv[1], found)\n"
    )
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=8"}
    subprocess.run([sys.executable, script, tmp_path / "found.npy"], env=environment, check=True)
    np.testing.assert_allclose(np.load(tmp_path / "found.npy"), alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("times", "start", "accuracy", "why"),
    [
        ([2.0, 1.0], np.zeros(3), SHARP, "increase"),
        ([], np.zeros(3), SHARP, "finite"),
        ([np.nan], np.zeros(3), SHARP, "finite"),
        ([-1.0, 1.0], np.zeros(3), SHARP, "from 0 on"),
        ([1.0], np.zeros((2, 3)), SHARP, "shape"),
        ([1.0], np.zeros(3), Accuracy(step=0.01), "fixed step"),
    ],
)
def test_what_lanes_cannot_do_is_refused(times, start, accuracy, why) -> None:
    example = preset("paper-rotate")
    with pytest.raises(ValueError, match=why):
        simulate_many(stacked([example.model]), example.gait, times, start, accuracy=accuracy)
