"""From markers to a body: against scipy's align_vectors frame by frame, and against motions known exactly."""

import numpy as np
import pytest
from helpers.exports import PLACES, TEMPLATE, motion, nexus
from scipy.spatial.transform import Rotation

from snakejax import InputError
from snakejax.recording.readers import FileAnnotations, read_track
from snakejax.recording.readers.marker_template import board_places, shape_of
from snakejax.recording.readers.motion_plane import arms, ground_of
from snakejax.recording.readers.rigid_body import kabsch, placed
from snakejax.recording.readers.rotations import AXES

UP = AXES["z"]
NOISE = 3e-4
NAMES = [f"board:{name}" for name in PLACES]
SWAPPED = {"two, one frame": ([17], (1, 0, 2, 3)), "two, a second": (range(20, 120), (0, 2, 1, 3))}
SWAPPED |= {"three": (range(5, 9), (1, 2, 0, 3)), "two pairs of frames": ([40, 41, 90], (3, 1, 2, 0))}


def seen(n=200, seed=0):
    points = motion(n, tilt=0.03).points
    return points + NOISE * np.random.default_rng(seed).normal(size=points.shape)


def angle_between(quaternions, rotation):
    return (Rotation.from_quat(quaternions) * rotation.inv()).magnitude()


@pytest.mark.parametrize("weights", [None, np.array([1.0, 2.0, 0.5, 3.0])])
def test_kabsch_is_that_of_scipy(weights):
    points = seen(40)
    points[3, 0], points[11, 2] = np.nan, np.nan
    R, t, residual = kabsch(TEMPLATE, points, UP, weights)
    w = np.ones(4) if weights is None else weights
    for i, frame in enumerate(points):
        there = np.isfinite(frame[:, 0])
        a, p, mine = TEMPLATE[there], frame[there], w[there]
        ca, cp = np.average(a, axis=0, weights=mine), np.average(p, axis=0, weights=mine)
        expected, root = Rotation.align_vectors(p - cp, a - ca, mine)
        # What says that z is up beside the markers weighs a millionth.
        np.testing.assert_allclose(R[i], expected.as_matrix(), atol=1e-6)
        np.testing.assert_allclose(t[i], cp - expected.apply(ca), atol=1e-6)
        np.testing.assert_allclose(residual[i], root / np.sqrt(mine.sum()), atol=1e-6)


@pytest.mark.parametrize("name", SWAPPED)
def test_swapped_labels_are_put_back(name):
    frames, order = SWAPPED[name]
    points = seen()
    clean = placed(TEMPLATE, points, UP)
    points[list(frames)] = points[list(frames)][:, list(order)]
    found = placed(TEMPLATE, points, UP)
    assert (found.swapped, found.left_out, found.lost) == (len(list(frames)), 0, 0)
    np.testing.assert_allclose(found.position, clean.position, atol=1e-12)
    assert (clean.swapped, clean.left_out, clean.lost) == (0, 0, 0)


def test_missing_markers_and_ghosts():
    points, true = seen(), motion(200, tilt=0.03)
    points[10:30, 1] = np.nan  # three are left
    points[50:60, :2] = np.nan  # two are left
    points[70:75, 1:] = np.nan  # one is left
    points[100:104, 3] += [0.0, 0.3, 0.1]  # a ghost takes the label
    points[150:152, 2:] += np.random.default_rng(1).normal(size=(2, 2, 3))  # two ghosts: nothing to be done
    found = placed(TEMPLATE, points, UP)
    lost = np.isnan(found.position[:, 0])
    assert list(np.flatnonzero(lost)) == [*range(70, 75), 150, 151]
    assert (found.left_out, found.swapped, found.lost) == (4, 0, 7)
    off = np.linalg.norm(found.position - true.position, axis=1)
    full = ~lost
    full[50:60] = False
    assert off[full].max() < 6 * NOISE and angle_between(found.rotation[full], true.rotation[full]).max() < 0.01
    # With two markers a lean cannot be seen, but the place and the heading can: the lean is 0.03 here.
    heading = Rotation.from_quat(found.rotation[50:60]).as_euler("ZYX")[:, 0]
    assert np.abs(np.angle(np.exp(1j * (heading - true.heading[50:60])))).max() < 0.02
    assert off[50:60].max() < 0.01


def test_the_spread_of_the_pose_is_what_least_squares_says():
    """4 markers of variance s^2 each: the centroid's is s^2 / 4, the heading's s^2 / sum of r^2 about it."""
    centred = TEMPLATE - TEMPLATE.mean(axis=0)
    points = motion(4000).points + NOISE * np.random.default_rng(2).normal(size=(4000, 4, 3))
    found = placed(centred, points, UP)
    true = motion(4000)
    centroid = true.position + true.rotation.apply(TEMPLATE.mean(axis=0))
    assert np.std(found.position - centroid) == pytest.approx(NOISE / 2, rel=0.05)
    turn = (true.rotation.inv() * Rotation.from_quat(found.rotation)).as_rotvec()[:, 2]
    # About an axis of the body the three turns are not independent; the inertia of unit masses says how they spread.
    inertia = (centred**2).sum() * np.eye(3) - centred.T @ centred
    assert np.std(turn) == pytest.approx(NOISE * np.sqrt(np.linalg.inv(inertia)[2, 2]), rel=0.05)


def test_the_shape_is_found_without_a_template():
    points = seen(300)
    points[::9] = points[::9][:, [1, 0, 2, 3]]
    points[5::7, 2] = np.nan
    shape = shape_of(points)
    assert shape is not None
    apart = [np.linalg.norm(s[:, None] - s[None], axis=2) for s in (shape, TEMPLATE)]
    np.testing.assert_allclose(apart[0], apart[1], atol=1e-4)
    # Not its mirror image, which has the same distances.
    volumes = [np.linalg.det(s[1:] - s[0]) for s in (shape, TEMPLATE)]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.01)
    assert shape_of(np.full((5, 4, 3), np.nan)) is None


def test_the_board_in_the_shape():
    """Turned anyhow, the shape is laid along the board by its ends; the rest follows."""
    points = seen(300)
    turned = Rotation.random(rng=3).apply(TEMPLATE - TEMPLATE.mean(axis=0))
    places = board_places(points, turned, UP, [0], [1])
    middle = TEMPLATE[:2].mean(axis=0)
    along = TEMPLATE[0] - TEMPLATE[1]
    expected = Rotation.from_rotvec([0, 0, -np.arctan2(along[1], along[0])]).apply(TEMPLATE - middle)
    np.testing.assert_allclose(places, expected, atol=2e-3)
    assert board_places(points, turned, UP, [0, 1], [1, 0]) is None


@pytest.mark.parametrize("tilt", [0.0, 0.05])
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_plane_of_motion(up, tilt):
    lean = Rotation.from_rotvec([tilt, 0, 0]) if up != "x" else Rotation.from_rotvec([0, tilt, 0])
    turn = lean * Rotation.align_vectors([AXES[up]], [UP])[0]
    m = motion(300)
    m = m._replace(position=m.position + 1e-3 * np.random.default_rng(0).normal(size=m.position.shape))
    position, rotation = turn.apply(m.position), (turn * m.rotation).as_quat()
    position[40:43] += [0, 0, 5]  # a teleport
    ground = ground_of(arms(position, rotation))
    assert ground is not None and ground.axis == up
    assert ground.tilt == pytest.approx(tilt, abs=2e-3)
    np.testing.assert_allclose(ground.up, turn.apply(UP), atol=2e-3)


def test_a_line_has_no_plane():
    line = np.outer(np.linspace(0, 1, 50), [1, 2, 0])[:, None] + 1e-4 * np.random.default_rng(0).normal(size=(50, 1, 3))
    assert ground_of(line) is None
    turning = motion(50)
    rest = turning._replace(position=0 * turning.position)
    # A body that only turns shows the plane by its arms.
    assert ground_of(arms(rest.position, rest.rotation.as_quat())) is not None


def write(folder, points):
    (folder / "a.csv").write_text(nexus(points, NAMES))
    return folder / "a.csv"


def test_a_track_from_markers(tmp_path):
    m = motion(100)
    points = m.points
    points[20:30] = points[20:30][:, [0, 3, 2, 1]]
    path = write(tmp_path, points)
    for names in (PLACES, {f"board:{name}": place for name, place in PLACES.items()}):
        track = read_track(path, "board", FileAnnotations(markers=names))
        np.testing.assert_allclose(track.pose, np.column_stack([m.position[:, :2], m.heading]), atol=1e-6)


@pytest.mark.parametrize(
    ("markers", "what"),
    [
        (None, "but not their places on the board"),
        ({"frnt": (0, 0, 0), "back": (1, 0, 0)}, 'There is no marker "frnt"'),
        ({"front": (0, 0, 0)}, "At least two markers"),
        ({name: 1000 * np.array(place) for name, place in PLACES.items()}, "mm off where the template has them"),
    ],
)
def test_complaints(tmp_path, markers, what):
    with pytest.raises(InputError, match=what):
        read_track(write(tmp_path, seen(50)), "board", FileAnnotations(markers=markers))
