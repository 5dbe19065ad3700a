"""The noise of a sample without a model of the board, against noise that was put in."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.core.errors import InputError
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.recording.quality import estimate_noise, marker_noise, noise_sources
from snakejax.recording.quality.noise import SLOW_NOISE
from snakejax.recording.run import Run

SD = np.array([4e-4, 4e-4, 2.5e-3])
TIMES = np.arange(1201) / 100


def coloured(rng, n, slow):
    """Noise (n, 3) of unit variance, a share `slow` of which lasts for ten frames."""
    white, lasting = rng.normal(size=(2, n, 3))
    for k in range(1, n):
        lasting[k] = 0.9 * lasting[k - 1] + np.sqrt(1 - 0.9**2) * lasting[k]
    return np.sqrt(1 - slow) * white + np.sqrt(slow) * lasting


def run(seed, start=(0.0, 0.0, 0.0), slow=0.0, frequency=4.0, still=None, floor=0.0):
    """Twelve seconds of a smooth motion from `start`; `still`, when it ends; `floor`, a drift along the world's x."""
    rng = np.random.default_rng(seed)
    t = np.minimum(TIMES, np.inf if still is None else still)
    wave = 1 - np.cos(0.5 * t)
    path = np.stack([wave + 0.1 * np.sin(frequency * t) ** 2, 0.5 * wave, 0.6 * np.sin(2 * t) ** 2], axis=1)
    c, s = np.cos(start[2]), np.sin(start[2])
    pose = path + np.array([0.0, 0.0, start[2]])
    pose[:, :2] = path[:, :2] @ np.array([[c, s], [-s, c]]) + start[:2]
    pose[:, 0] += floor * TIMES**2
    pose += SD * coloured(rng, len(t), slow)
    moves = [[0.0 if still is not None and still == 0 else 0.9, frequency, 0.0]]
    gait = Gait(Tracked(Sines.of(moves), 100.0, 10.0), Sines.of(moves))
    return Run(f"run-{seed}", "train", jnp.asarray(TIMES), jnp.asarray(pose), gait)


def near(noise, rel):
    assert float(noise.position) == pytest.approx(SD[0], rel=rel)
    assert float(noise.heading) == pytest.approx(SD[2], rel=rel)


def test_white_noise_and_no_repeats():
    noise = estimate_noise([run(1), run(2, frequency=3.0)])
    near(noise, 0.05)
    assert noise.source == "estimated from the recordings"


@pytest.mark.parametrize("place", [(0.01, 0.02, 0.03), (1.0, -2.0, 2.5), (0.3, 0.0, -9.0)])
def test_repeated_runs_agree_where_the_noise_is_white(place):
    runs = [run(1), run(2, place), run(3, frequency=3.0)]
    source = noise_sources(runs)["repeats"]
    assert source.position == pytest.approx(SD[0], rel=0.06) and source.heading == pytest.approx(SD[2], rel=0.06)
    assert estimate_noise(runs).source == "estimated from the recordings; repeated runs agree"


def test_what_is_fixed_in_the_world_is_no_noise():
    """A floor that makes the board drift 40 cm in 12 s, in another direction of the board in each run."""
    runs = [run(1, floor=0.003), run(2, (0.0, 1.0, 2.0), floor=0.003)]
    near(estimate_noise(runs), 0.06)


@pytest.mark.parametrize(("place", "rel"), [((0.0, 0.0, 0.0), 0.12), ((1.0, 0.5, 2.0), 0.25)])
def test_coloured_noise_is_seen_in_repeated_runs(place, rel):
    """From the same start all of it; from elsewhere what is faster than half a second. Differences miss half."""
    runs = [run(1, slow=0.75), run(2, place, slow=0.75)]
    white = noise_sources(runs)["differences"]
    assert white.position < 0.65 * SD[0] and white.heading < 0.65 * SD[2]
    noise = estimate_noise(runs)
    near(noise, rel)
    assert noise.source == f"estimated from repeated runs, {SLOW_NOISE}"


def test_coloured_noise_is_seen_at_rest():
    runs = [run(1, slow=0.75), run(2, slow=0.75, still=0.0)]
    noise = estimate_noise(runs)
    near(noise, 0.2)
    assert noise.source == f"estimated from times of rest, {SLOW_NOISE}"
    quiet = estimate_noise([run(1), run(2, still=0.0)])
    near(quiet, 0.05)
    assert quiet.source == "estimated from the recordings; times of rest agree"


def test_a_board_that_glides_while_its_joints_rest_is_not_at_rest():
    gliding = run(1, still=0.0)
    moved = eqx.tree_at(lambda r: r.pose, gliding, gliding.pose.at[:, 0].add(0.02 * jnp.asarray(TIMES)))
    assert "rest" not in noise_sources([moved])


def test_runs_of_other_gaits_or_payloads_are_no_repeats():
    heavy = eqx.tree_at(lambda r: r.payload, run(2), jnp.asarray([1.0, 0.0]))
    assert "repeats" not in noise_sources([run(1), heavy, run(3, frequency=3.0)])


def test_repeats_survive_lost_frames_and_jumps():
    pose = np.array(run(2, (1.0, 0.0, 1.0)).pose)
    pose[200:300], pose[500:503] = np.nan, 9.0
    spoiled = eqx.tree_at(lambda r: r.pose, run(2), jnp.asarray(pose))
    # One of 400 numbers is wild: the estimate leaves it out.
    assert noise_sources([run(1), spoiled])["differences"].position == pytest.approx(SD[0], rel=0.06)


def markers(rng, n, sd, count=4, size=0.1):
    """A rigid body of `count` markers that turns about all axes, each coordinate with noise `sd`."""
    from scipy.spatial.transform import Rotation

    shape = rng.normal(size=(count, 3)) * size
    shape -= shape.mean(axis=0)
    t = np.arange(n) / 100
    turn = Rotation.from_euler("zyx", np.stack([t, 0.01 * np.sin(t), 0.02 * np.cos(t)], axis=1))
    place = np.stack([t, np.sin(t), 0.06 + 0 * t], axis=1)
    clean = np.einsum("nij,mj->nmi", turn.as_matrix(), shape) + place[:, None]
    return clean + sd * rng.normal(size=clean.shape), shape, turn


@pytest.mark.parametrize("count", [3, 4, 8])
def test_markers_that_move_against_each_other(count):
    """Against the scatter of the poses themselves, fitted to the true shape by scipy."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(count)
    seen, shape, turn = markers(rng, 2000, 5e-4, count)
    noise = marker_noise(seen)
    centre = seen.mean(axis=1)
    t = np.arange(2000) / 100
    scatter = (centre - np.stack([t, np.sin(t), 0.06 + 0 * t], axis=1))[:, :2].std()
    assert float(noise.position) == pytest.approx(scatter, rel=0.04)
    fitted = [Rotation.align_vectors(frame - frame.mean(axis=0), shape)[0] for frame in seen]
    headings = Rotation.concatenate(fitted).as_euler("zyx")[:, 0] - turn.as_euler("zyx")[:, 0]
    headings -= 2 * np.pi * np.round(headings / (2 * np.pi))
    assert float(noise.heading) == pytest.approx(headings.std(), rel=0.06)
    assert noise.source == "estimated from the markers"


def test_swapped_and_lost_markers_are_no_noise():
    seen, _, _ = markers(np.random.default_rng(0), 500, 5e-4)
    spoiled = seen.copy()
    spoiled[::40] = spoiled[::40][:, [1, 0, 2, 3]]
    spoiled[::30, 2] = np.nan
    assert float(marker_noise(spoiled).position) == pytest.approx(float(marker_noise(seen).position), rel=0.05)


def test_too_few_markers():
    with pytest.raises(InputError, match="give three markers or more"):
        marker_noise(np.zeros((50, 2, 3)))
    with pytest.raises(InputError, match="Only 5 frames have all 3 markers"):
        marker_noise(np.zeros((5, 3, 3)))
