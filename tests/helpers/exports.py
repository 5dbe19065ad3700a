"""Small files as each program would export them, written here from a motion that is known exactly."""

import struct
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

RATE = 100.0
PLACES = {
    "front": (0.2, 0.05, 0.08),
    "back": (-0.25, 0.0, 0.07),
    "left": (-0.05, 0.15, 0.12),
    "mast": (0.02, -0.06, 0.3),
}
TEMPLATE = np.array([*PLACES.values()])


class Motion(NamedTuple):
    """A rigid body's way: times [s], position [m] (n, 3), orientation, and its heading [rad] before it was tilted."""

    times: np.ndarray
    position: np.ndarray
    rotation: Rotation
    heading: np.ndarray

    @property
    def points(self):
        """Where its markers are: (n, m, 3)."""
        return self.position[:, None] + np.einsum("nij,mj->nmi", self.rotation.as_matrix(), TEMPLATE)


def motion(n=60, tilt=0.0, turns=1.3):
    """A board that goes round a bend while it turns; `tilt` [rad] leans it over in its own frame."""
    t = np.arange(n) / RATE
    s = t / t[-1]
    heading = 0.4 + 2 * np.pi * turns * s
    position = np.stack([0.8 * np.sin(3 * s), 0.5 * s**2 - 0.3, 0.06 + 0 * s], axis=1)
    lean = Rotation.from_rotvec(np.outer(np.sin(7 * s), [tilt, tilt / 2, 0]))
    return Motion(t, position, Rotation.from_rotvec(np.outer(heading, [0, 0, 1])) * lean, heading)


def y_up(vectors):
    """Vectors of axes with z up, in ones with y up: x is shared."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def put(folder, content, name="recording"):
    """`content` as a file in `folder`."""
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def cells(row):
    return ["" if isinstance(x, float) and np.isnan(x) else str(x) for x in row]


def table(rows, separator=",", end="\r\n"):
    return end.join(separator.join(cells(row)) for row in rows) + end


def nexus(points, names, unit="mm"):
    scale = {"mm": 1e3, "m": 1.0}[unit]
    rows = [["Trajectories"], ["100"], ["", "", *(c for name in names for c in (name, "", ""))]]
    rows += [["Frame", "Sub Frame", *("X", "Y", "Z") * len(names)], ["", "", *[unit] * (3 * len(names))]]
    rows += [[i + 1, 0, *(float(x) for x in p.ravel() * scale)] for i, p in enumerate(points)]
    return table(rows)


def trc(points, names, separator="\t", unit="mm"):
    scale = {"mm": 1e3, "m": 1.0}[unit]
    rows = [["PathFileType", "4", "(X/Y/Z)", "trial.trc"]]
    rows += [["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"]]
    rows += [["100", "100", len(points), len(names), unit, "100"]]
    rows += [["Frame#", "Time", *(c for name in names for c in (name, "", ""))]]
    rows += [["", "", *(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ")], [""]]
    rows += [[i + 1, f"{i / RATE:.3f}", *(float(x) for x in p.ravel() * scale)] for i, p in enumerate(points)]
    return table(rows, separator, "\n")


def motive(motion, name="board", rotation="Quaternion", unit="Meters", lost=()):
    """With y up, as Motive has it; markers beside the rigid body."""
    scale = {"Meters": 1.0, "Millimeters": 1e3}[unit]
    # y_up turns the axes by -90 degrees about x, in the world and on the body alike.
    turn = Rotation.from_euler("x", -90, degrees=True)
    turned = turn * motion.rotation * turn.inv()
    angles = turned.as_quat() if rotation == "Quaternion" else turned.as_euler(rotation, degrees=True)
    axes = "XYZW" if rotation == "Quaternion" else rotation
    k = len(axes)
    kinds = ["Rigid Body"] * (k + 4) + ["Marker"] * 6
    names = [name] * (k + 4) + [f"{name}_1"] * 3 + ["Unlabeled:7"] * 3
    parts = ["Rotation"] * k + ["Position"] * 3 + ["Error Per Marker"] + ["Position"] * 6
    first = ["Format Version", "1.23", "Take Name", '"Take, one"', "Export Frame Rate", "100.000000"]
    rows = [[*first, "Rotation Type", rotation, "Length Units", unit, "Coordinate Space", "Global"], []]
    rows += [["", "", *kinds], ["", "", *names], ["", "", *['"A1"'] * len(names)], ["", "", *parts]]
    rows += [["Frame", "Time (Seconds)", *axes, "X", "Y", "Z", "", *"XYZXYZ"]]
    place, marker = y_up(motion.position) * scale, y_up(motion.points[:, 0]) * scale
    for i in range(len(motion.times)):
        numbers = [*angles[i], *place[i], 0.0001, *marker[i], *marker[i]]
        rows += [[i, f"{i / RATE:.6f}", *([""] * len(numbers) if i in lost else map(float, numbers))]]
    return table(rows)


def qualisys_markers(points, names, titled=True):
    facts = [["NO_OF_FRAMES", len(points)], ["NO_OF_CAMERAS", 8], ["NO_OF_MARKERS", len(names)], ["FREQUENCY", 100]]
    facts += [["DESCRIPTION", "--"], ["TIME_STAMP", "2026-01-31, 12:00:00.000", "1.5"], ["DATA_INCLUDED", "3D"]]
    facts += [["MARKER_NAMES", *names]]
    facts += [["Frame", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]] if titled else []
    data = np.nan_to_num(points) * 1e3
    lead = [[i + 1, f"{i / RATE:.5f}"] if titled else [] for i in range(len(points))]
    return table([*facts, *([*a, *map(float, p.ravel())] for a, p in zip(lead, data, strict=True))], "\t")


def qualisys_bodies(motions, titled=True, lost=()):
    facts = [["NO_OF_FRAMES", 60], ["FREQUENCY", 100], ["DATA_INCLUDED", "6D"], ["BODY_NAMES", *motions]]
    parts = ["Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
    facts += [["Frame", "Time", *(c for name in motions for c in (f"{name} X", *parts))]] if titled else []
    rows = []
    for i in range(60):
        row = [i + 1, f"{i / RATE:.5f}"] if titled else []
        for m in motions.values():
            R = m.rotation[i]
            # Rot runs down the columns of the matrix.
            row += [*m.position[i] * 1e3, *R.as_euler("XYZ", degrees=True), 0.3, *R.as_matrix().T.ravel()]
            if i in lost:
                row[-16:] = [0.0] * 16
        rows.append([x if isinstance(x, str) else float(x) for x in row])
    return table([*facts, *rows], "\t")


def c3d(points, names, unit="mm", rate=RATE, up="+Z", outputs=None):
    """A C3D of floating-point numbers, byte by byte: header, parameters, frames; a residual of -1 is a lost marker.

    `outputs`: names by the group, such as ANGLES, that lists them as computed by a model.
    """
    scale = {"mm": 1e3, "m": 1.0}[unit]
    n, m = points.shape[:2]

    def parameter(group, name, kind, dimensions, data):
        body = struct.pack("<bB", kind, len(dimensions)) + bytes(dimensions) + data
        return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<h", len(body) + 3) + body + b"\0"

    wide = max(map(len, names))
    listed = {"LABELS": names, **(outputs or {})}
    group = struct.pack("<bb", 5, -1) + b"POINT" + struct.pack("<h", 3) + b"\0"
    group += parameter(1, "USED", 2, [], struct.pack("<h", m))
    group += parameter(1, "FRAMES", 2, [], struct.pack("<h", n))
    group += parameter(1, "SCALE", 4, [], struct.pack("<f", -1.0))
    group += parameter(1, "RATE", 4, [], struct.pack("<f", rate))
    group += parameter(1, "UNITS", -1, [len(unit)], unit.encode())
    for key, some in listed.items():
        group += parameter(1, key, -1, [wide, len(some)], "".join(name.ljust(wide) for name in some).encode())
    group += parameter(1, "X_SCREEN", -1, [2], b"+X") + parameter(1, "Y_SCREEN", -1, [2], up.encode())
    blocks = -(-(len(group) + 4 + 40) // 512)
    data_start = 2 + blocks
    group = group.replace(b"\x05\xffPOINT", b"\x05\xffPOINT")
    start = parameter(1, "DATA_START", 2, [], struct.pack("<h", data_start))
    parameters = (struct.pack("<BBBB", 1, 0x50, blocks, 84) + group + start + b"\0\0").ljust(512 * blocks, b"\0")
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, m, 0, 1, n, 0, -1.0, data_start, 0, rate).ljust(512, b"\0")
    seen = np.isfinite(points).all(axis=2)
    numbers = np.concatenate([np.nan_to_num(points) * scale, np.where(seen, 0.0, -1.0)[..., None]], axis=2)
    return header + parameters + numbers.astype("<f4").tobytes()


def tracker(motions, lost=()):
    """Vicon Tracker: several objects with quaternions."""
    names = ["", "", *(c for name in motions for c in (f"Global Angle {name}", *[""] * 6))]
    rows = [
        ["Objects"],
        ["100"],
        names,
        ["Frame", "Sub Frame", *("RX", "RY", "RZ", "RW", "TX", "TY", "TZ") * len(motions)],
    ]
    rows += [["", "", *("", "", "", "", "mm", "mm", "mm") * len(motions)]]
    columns = [np.column_stack([m.rotation.as_quat(), m.position * 1e3]) for m in motions.values()]
    for i, row in enumerate(np.concatenate(columns, axis=1)):
        rows.append([i + 1, 0, *([""] * len(row) if i in lost else map(float, row))])
    return table(rows)
