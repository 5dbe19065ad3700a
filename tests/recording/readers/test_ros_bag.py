"""Bags of ROS 1 and 2, written by rosbags: the same motion comes out, by the stamps in the headers."""

import numpy as np
import pytest
from helpers.exports import motion

from snakejax import InputError, load_case
from snakejax.commands.cli import main
from snakejax.recording.capture_summary import summary_text
from snakejax.recording.readers import pose_track, read_capture, read_track

rosbags = pytest.importorskip("rosbags")
M = motion()
START = 1_721_384_116_962_754_965
STAMPS = [START + round(t * 1e9) + (i % 3) * 100_000 for i, t in enumerate(M.times)]
EXPECTED = np.column_stack([M.position[:, :2], M.heading])


def messages(store, ros1):
    """(topic, type, message) of frame i: each kind that is read, and one that is not."""
    t = store.types
    kind = {name.split("/")[-1]: cls for name, cls in t.items() if not name.endswith(("Request", "Response"))}

    def header(i, frame, stamped=True):
        sec, nanosec = divmod(STAMPS[i] if stamped else 0, 10**9)
        time = t["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        more = {"seq": i} if ros1 else {}
        return t["std_msgs/msg/Header"](**more, stamp=time, frame_id=frame)

    def pose(i):
        p, q = M.position[i], M.rotation[i].as_quat()
        point, turn = kind["Point"](*map(float, p)), t["geometry_msgs/msg/Quaternion"](*map(float, q))
        return kind["Pose"](point, turn)

    def transform(i, child, parent="world"):
        p, q = M.position[i], M.rotation[i].as_quat()
        vector, turn = kind["Vector3"](*map(float, p)), t["geometry_msgs/msg/Quaternion"](*map(float, q))
        moved = t["geometry_msgs/msg/Transform"](vector, turn)
        return t["geometry_msgs/msg/TransformStamped"](header(i, parent), child, moved)

    zero = kind["Vector3"](0.0, 0.0, 0.0)
    spread = np.zeros(36)
    twist = kind["TwistWithCovariance"](kind["Twist"](zero, zero), spread)
    tf = "tf2_msgs/msg/TFMessage"
    for i in range(len(M.times)):
        covered = kind["PoseWithCovariance"](pose(i), spread)
        yield i, "/pose", "geometry_msgs/msg/PoseStamped", kind["PoseStamped"](header(i, "world"), pose(i))
        yield i, "/odom", "nav_msgs/msg/Odometry", kind["Odometry"](header(i, "odom"), "base", covered, twist)
        yield i, "/vicon/board", "geometry_msgs/msg/TransformStamped", transform(i, "board")
        yield i, "/tf", tf, t[tf]([transform(i, "board"), transform(i, "rotor"), transform(i, "board", "map")])
        yield i, "/late", "geometry_msgs/msg/PoseStamped", kind["PoseStamped"](header(i, "world", False), pose(i))
        flat = kind["Pose2D"](float(M.position[i, 0]), float(M.position[i, 1]), float(M.heading[i]))
        yield i, "/flat", "geometry_msgs/msg/Pose2D", flat
        yield i, "/bare", "geometry_msgs/msg/Pose", pose(i)
        yield i, "/words", "std_msgs/msg/String", kind["String"]("hello")


def bag(folder, kind):
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    path = folder / ("a.bag" if ros1 else "a")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for i, topic, kind_of, message in messages(store, ros1):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind_of, typestore=store)
            encode = store.serialize_ros1 if ros1 else store.serialize_cdr
            # The bag's own stamps jitter, by more than half a frame here.
            jitter = int(np.random.default_rng(i).integers(0, 6_000_000))
            writer.write(connections[topic], STAMPS[i] + 20_000_000 + jitter, encode(message, kind_of))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
def test_bags(tmp_path, kind):
    path = bag(tmp_path, kind)
    capture = read_capture(path)
    stamped = ["/pose", "/odom", "/vicon/board", "board in world", "rotor", "board in map"]
    received = ["/late", "/flat", "/bare"]
    assert sorted(capture.bodies) == sorted(stamped + received)
    assert "in the frame world are the poses of /pose, /vicon/board, board in world, rotor, /late" in capture.notes
    assert "topics that hold no pose and are not read: /words (std_msgs/String)" in capture.notes
    for name in received:
        assert sum(f"{name} has no stamps" in note for note in capture.notes) == 1
        np.testing.assert_allclose(pose_track(capture, name).pose, EXPECTED, atol=1e-9)
    assert "up       z" not in summary_text(capture, {"/flat": None})
    for name in stamped:
        track = pose_track(capture, name)
        np.testing.assert_allclose(track.pose, EXPECTED, atol=1e-9)
        np.testing.assert_allclose(track.times, (np.array(STAMPS) - START) * 1e-9, atol=1e-6)
    assert np.abs(np.diff(capture.bodies["/late"].times) - 0.01).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_single_files_whatever_they_are_called(tmp_path, kind):
    path = bag(tmp_path, kind)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    plain = tmp_path / "recording"
    plain.write_bytes(file.read_bytes())
    np.testing.assert_allclose(read_track(plain, "/pose").pose, EXPECTED, atol=1e-9)


@pytest.mark.slow
def test_a_bag_becomes_a_case(tmp_path):
    path = bag(tmp_path, "ros1")
    board = "mass_kg=7,rotor_inertia_kgm2=0.0238,wheelset_inertia_kgm2=0.001,half_length_m=0.25"
    options = ["--board", board, "--phi", "[[0.9, 4.0, 0.0]]", "--psi", "[]"]
    assert main(["import", str(path), "--object", "/pose", "--out", str(tmp_path / "case"), *options]) == 0
    assert sorted(file.name for file in (tmp_path / "case").iterdir()) == ["a.csv", "case.toml"]
    run = load_case(tmp_path / "case").runs[0]
    np.testing.assert_allclose(run.pose, EXPECTED, atol=1e-9)


@pytest.mark.slow
def test_damaged_bags(tmp_path):
    for kind in ("ros1", "sqlite"):
        path = bag(tmp_path, kind)
        file = path if path.is_file() else next(path.glob("*.db3"))
        raw = file.read_bytes()
        random = np.random.default_rng(0)
        for _ in range(4):
            broken = np.frombuffer(raw, np.uint8).copy()
            broken[random.integers(0, min(len(raw), 20_000), 200)] ^= 255
            file.write_bytes(broken[: int(random.integers(1000, len(raw)))].tobytes())
            try:
                read_capture(path)
            except InputError as error:
                assert "\n" not in str(error)
