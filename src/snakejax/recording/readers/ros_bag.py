"""ROS 1 and 2 bags, by rosbags (extra `ros`): poses, odometry and transforms, each by the stamp in its header.

A body is called by its topic; of a TF message by its child frame. Pose and Pose2D have no header, and the stamps of the
bag. Bags of ROS 2 are folders with metadata.yaml, or single .mcap or .db3 files.
"""

import math
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.tabular import first_few

from .capture import Body, Capture, Source
from .cells import shown
from .rotations import require_unit
from .subprocess_reader import read_in_subprocess

MAGIC = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
BARE, PLANAR = "geometry_msgs/msg/Pose", "geometry_msgs/msg/Pose2D"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
READ = (*POSES, BARE, PLANAR, TRANSFORM, *TF)
MOST_LISTED = 12
"""Topics or objects that a note lists."""


class Sample(NamedTuple):
    """One pose of one body, at a time [ns] by its header (0: it has none) and by the bag; its `heading` if planar."""

    name: str
    parent: str
    stamp: int
    received: int
    pose: tuple[float, float, float, float, float, float, float]
    heading: float = math.nan


def recognises(source: Source) -> bool:
    """Whether it is a bag, by its first bytes or, of a folder, by its metadata.yaml."""
    return _suffix(source.head) is not None or (source.path / "metadata.yaml").is_file()


def _suffix(head: bytes) -> str | None:
    return next((suffix for magic, suffix in MAGIC.items() if head.startswith(magic)), None)


def read(source: Source) -> Capture:
    """All bodies. **Raises:** `InputError`."""
    where = str(source.path)
    facts, arrays = read_in_subprocess("ros_bag", source.path, "rosbags")
    bodies: dict[str, Body] = {}
    notes = []
    for i, name in enumerate(facts["names"]):
        times, pose = arrays[f"times {i}"], arrays[f"pose {i}"].copy()
        # Nobody's orientation is 0, 0, 0, 0: some bridges say so of a body they do not see.
        pose[(pose[:, 3:] == 0).all(axis=1) | ~np.isfinite(pose).all(axis=1)] = np.nan
        require_unit(pose[:, 3:], name, where)
        heading = arrays[f"heading {i}"] if facts["planar"][i] else None
        bodies[name] = Body(times * 1e-9, pose[:, :3], pose[:, 3:], where, heading)
        if facts["unstamped"][i]:
            notes.append(f"{shown(name)} has no stamps of its own: its times are those of the bag, which jitter")
    for frame in dict.fromkeys(filter(None, facts["parents"].values())):
        inside = [shown(name) for name, parent in facts["parents"].items() if parent == frame]
        notes.append(f"in the frame {shown(frame)} are the poses of {first_few(inside, MOST_LISTED)}")
    if others := facts["others"]:
        notes.append(f"topics that hold no pose and are not read: {first_few(others, MOST_LISTED, comma=True)}")
    return Capture("ROS bag", source.path, where, None, "m", bodies, {}, np.zeros(0), notes=notes)


def load(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The names of the bodies, the frame each is seen from, and their times [ns] and poses (n, 7)."""
    if path.is_file():
        with path.open("rb") as file:
            suffix = _suffix(file.read(16)) or path.suffix
        if suffix != path.suffix:
            with tempfile.TemporaryDirectory() as folder:
                # The library goes by the ending.
                named = Path(folder) / f"bag{suffix}"
                named.symlink_to(path.resolve())
                return _load(named, path)
    return _load(path, path)


def _load(bag: Path, path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    samples: dict[tuple[str, str], list[Sample]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
        wanted = [c for c in reader.connections if c.msgtype in READ]
        others = sorted({f"{c.topic} ({_short(c.msgtype)})" for c in reader.connections if c.msgtype not in READ})
        if not wanted:
            kinds = ", ".join(others[:8]) or "nothing"
            what = f"The bag has no poses, odometry or transforms, but {kinds}"
            raise InputError(what, str(path), "record PoseStamped, Odometry, TransformStamped, TF or Pose2D")
        for connection, received, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            for sample in _samples(connection, received, message):
                samples.setdefault((sample.name, sample.parent), []).append(sample)
    several = {name for name, _ in samples if sum(other == name for other, _ in samples) > 1}
    names = [f"{name} in {parent}" if name in several else name for name, parent in samples]
    arrays, unstamped, planar = {}, [], []
    for i, part in enumerate(samples.values()):
        unstamped.append(all(sample.stamp == 0 for sample in part))
        arrays[f"times {i}"] = np.array([s.received if unstamped[-1] else s.stamp for s in part], np.int64)
        arrays[f"pose {i}"] = np.array([s.pose for s in part], float)
        arrays[f"heading {i}"] = np.array([s.heading for s in part], float)
        planar.append(bool(np.isfinite(arrays[f"heading {i}"]).any()))
    parents = {name: parent for name, (_, parent) in zip(names, samples, strict=True)}
    facts = {"names": names, "parents": parents, "unstamped": unstamped, "planar": planar, "others": others}
    return facts, arrays


def _short(kind: str) -> str:
    return kind.replace("/msg/", "/")


def _samples(connection: Any, received: int, message: Any) -> list[Sample]:
    if connection.msgtype in TF:
        return [_sample(part.child_frame_id, received, part.header, part.transform) for part in message.transforms]
    if connection.msgtype == TRANSFORM:
        return [_sample(connection.topic, received, message.header, message.transform)]
    if connection.msgtype == PLANAR:
        half = message.theta / 2
        pose = (message.x, message.y, 0.0, 0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        return [Sample(connection.topic, "", 0, received, pose, message.theta)]
    if connection.msgtype == BARE:
        return [_sample(connection.topic, received, None, message)]
    pose = message.pose if hasattr(message.pose, "position") else message.pose.pose
    return [_sample(connection.topic, received, message.header, pose)]


def _sample(name: str, received: int, header: Any, pose: Any) -> Sample:
    place, turn = (pose.position, pose.orientation) if hasattr(pose, "position") else (pose.translation, pose.rotation)
    stamp = header.stamp.sec * 10**9 + header.stamp.nanosec if header else 0
    at = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    return Sample(name, header.frame_id if header else "", stamp, received, at)
