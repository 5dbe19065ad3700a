"""What the name of a column says: which object it is of, what it holds of it, and in which unit.

board.x_m, board_x (mm), board [x], x_board, boardX, LASI:Y, pose.position.z, board_quat_w, yaw [deg], Time (s), %time
"""

import re
from typing import NamedTuple

from .capture import LENGTH

AXES = ("x", "y", "z")
UNIT_WORDS = {
    "mm": ("mm", "millimeter", "millimetre", "millimeters", "millimetres"),
    "cm": ("cm", "centimeter", "centimetre", "centimeters", "centimetres"),
    "m": ("m", "meter", "metre", "meters", "metres"),
    "in": ("in", "inch", "inches"),
    "ft": ("ft", "feet"),
    "rad": ("rad", "rads", "radian", "radians"),
    "deg": ("deg", "degs", "degree", "degrees", "°"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millisecond", "milliseconds"),
    "us": ("us", "µs", "usec", "usecs", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
UNIT_OF = {word: unit for unit, words in UNIT_WORDS.items() for word in words}
CLOCKS = tuple(
    word for unit in ("s", "ms", "us", "ns") for word in UNIT_WORDS[unit] if len(word) > 2 and word != "second"
)
"""Words that by themselves name a clock: ROS writes a time as header.stamp.sec and header.stamp.nanosec."""
HEADINGS = ("heading", "yaw", "theta")
TIMES = ("time", "t", "timestamp", "timestamps", "stamp", "times")
POSITION_WORDS = (
    "p",
    "pos",
    "position",
    "translation",
    "trans",
    "location",
    "loc",
    "coordinate",
    "coordinates",
    "point",
    "place",
)
ROTATION_WORDS = ("orientation", "quaternion", "quat", "rotation", "rot", "q", "ori", "attitude")
NEUTRAL_WORDS = (
    "pose",
    "field",
    "header",
    "data",
    "transform",
    "global",
    "world",
    "elapsed",
    "ros",
    "unix",
    "epoch",
    "sim",
)
"""Words that say nothing of which object a column is of."""
EXCLUDED_WORDS = (
    *(
        "vel",
        "velocity",
        "speed",
        "twist",
        "linear",
        "angular",
        "omega",
        "rate",
        "gyro",
        "delta",
        "dot",
        "ddot",
        "diff",
    ),
    *("acc", "accel", "acceleration", "jerk", "imu", "mag", "magnetometer", "force", "moment", "torque", "power"),
    *(
        "error",
        "err",
        "residual",
        "std",
        "sd",
        "cov",
        "covariance",
        "var",
        "normal",
        "scale",
        "euler",
        "angle",
        "angles",
    ),
    *("cmd", "command", "input", "cop", "emg", "likelihood", "confidence", "velocities", "forces"),
)
"""Words beside an axis or a heading that make it none."""
_LETTER = re.compile(r"[ _-]?[vwdaufgmVFM][ _-]?")
"""Letters that do, if they alone stand beside the axis and no length is stated: v_x is a speed, v.x a marker."""
_UNIT = re.compile(rf"(?:[ _]|(?P<open>[\[(]))\s*(?P<unit>{'|'.join(map(re.escape, UNIT_OF))})(?(open)[\])])$", re.I)
_SPLIT = re.compile(r"[\s_.:/\-\[\]()|,;%]+")
_CAMEL = re.compile(r"(?P<rest>.*?[a-z0-9_])(?P<role>[XYZW])")
_NUMBERED = re.compile(r"(?P<axis>[xyz])_?(?P<number>\d+)", re.I)
"""The coordinates of numbered markers: x1, y1, z1, x2."""
_INDEX = re.compile(r"(?P<rest>.+)\[(?P<index>[0-3])\]")


class Named(NamedTuple):
    """A column of `object`: its `role` x, y, z, qx, qy, qz, qw, heading or time; `plain` where no more than an axis is
    named, which beside a w may be that of a quaternion; and its `unit`, empty where the name has none.
    """

    object: str
    role: str
    plain: bool
    unit: str


def without_unit(name: str) -> tuple[str, str]:
    """`name` without the unit at its end, and that unit: "nose (mm)" is "nose" and "mm"."""
    text = name.strip()
    match = _UNIT.search(text)
    if match is None or match.start() == 0:
        return text, ""
    return text[: match.start()].rstrip(), UNIT_OF[match["unit"].lower()]


def named(name: str) -> Named | None:
    """What `name` says; None where it says nothing of a place, a turn or a time."""
    text, unit = without_unit(name)
    if match := _INDEX.fullmatch(text):
        axis = int(match["index"])
        return _of(match["rest"], AXES[axis], unit) if axis < 3 else None
    if match := _NUMBERED.fullmatch(text):
        return Named(match["number"], match["axis"].lower(), True, unit)
    words = [word for word in _SPLIT.split(text) if word]
    if not words:
        return None
    if words[-1].lower() in CLOCKS and all(word.lower() in (*NEUTRAL_WORDS, *TIMES) for word in words[:-1]):
        return Named("", "time", False, UNIT_OF[words[-1].lower()])
    if (role := _role(words[-1])) is not None:
        return _of(text[: text.rindex(words[-1])], role, unit)
    if (role := _role(words[0])) not in (None, "time"):
        return _of(text[text.index(words[0]) + len(words[0]) :], str(role), unit)
    if (match := _CAMEL.fullmatch(text)) is not None:
        return _of(match["rest"], match["role"].lower(), unit)
    return None


def _role(word: str) -> str | None:
    """What a word by itself says."""
    word = word.lower()
    if word in (*AXES, "w"):
        return word
    if word in HEADINGS:
        return "heading"
    if word in TIMES:
        return "time"
    if len(word) == 2 and word[0] in "tp" and word[1] in AXES:
        return f"place {word[1]}"
    if len(word) == 2 and word[0] == "q" and word[1] in (*AXES, "w"):
        return word
    if (match := re.fullmatch(rf"(?P<kind>{'|'.join(POSITION_WORDS)})(?P<axis>[xyz])", word)) is not None:
        return f"place {match['axis']}"
    return None


def _of(rest: str, role: str, unit: str) -> Named | None:
    """The column whose name has `rest` beside its role."""
    place, turn, role = role.startswith("place "), False, role.removeprefix("place ")
    words = [word for word in _SPLIT.split(rest) if word]
    axis = role in (*AXES, "w")
    if role != "time" and any(word.lower() in EXCLUDED_WORDS for word in words):
        return None
    if axis and _LETTER.fullmatch(rest) and unit not in LENGTH:
        return None
    kept = [word for word in words if word.lower() not in (*NEUTRAL_WORDS, *POSITION_WORDS)]
    if axis:
        turn = any(word.lower() in ROTATION_WORDS for word in kept)
        kept = [word for word in kept if word.lower() not in ROTATION_WORDS]
        place = place or any(word.lower() in POSITION_WORDS for word in words)
    # The name as it was written, where all of it is that of the object.
    object = rest.strip(" _.:/-[]()|,;%") if len(kept) == len(words) else "_".join(kept)
    if axis and turn:
        return Named(object, f"q{role}", False, unit)
    if role == "w":
        return None if place else Named(object, "qw", True, unit)
    return Named(object, role, role in AXES and not place, unit)
