"""A form of law in words: on what it acts, how it depends on its variables, and what its letters mean."""

from .terms import Family
from .units import is_sum

_VARIABLES = {
    **{"u": "the speed along the body", "w": "the speed across the body", "r": "the yaw rate", "speed": "the speed"},
    **{
        "theta": "the heading",
        "heading": "the heading",
        "slip_speed": "the slip speed of the wheel",
        "slip_angle": "the slip angle of the wheel",
    },
    **{"wheel_x": "x of the wheel", "wheel_y": "y of the wheel", "x": "x", "y": "y", "time": "time"},
    "turn_rate": "the rate at which the wheel turns on the floor",
}
ACTIONS = {
    "X": "a force along the body",
    "Y": "a force across the body",
    "N": "a yaw moment",
    "body": "a force that acts at a point of the body, with its yaw moment,",
    "world": "a force along the axes of the world",
    "east": "a force along x",
    "north": "a force along y",
    "drag": "a drag against the velocity",
    "friction": "a dry friction of the body",
    "across": "a force across the velocity",
    "yaw_drag": "a resistance to yaw",
    "grip": "a change of the grip of each wheel",
    "load": "a grip that rises behind the middle as it falls ahead of it",
    "front grip": "a change of the grip of the front wheels",
    "back grip": "a change of the grip of the back wheels",
    "front rolling": "a dry friction of the front wheels against their rolling, which begins over the speed e",
    "back rolling": "a dry friction of the back wheels against their rolling, which begins over the speed e",
    "height": "a rise of the floor under the wheels",
    "side": "a force across each wheel, beside that of its tyre,",
    "opposite sides": "a force across each wheel, beside that of its tyre, to the other side behind the middle,",
    "sliding": "a dry friction of each wheel against its lateral slip, beside the force of its tyre, which begins over"
    " the speed e",
    "rolling": "a dry friction of each wheel against its rolling, which begins over the speed e",
}
"""What acts, by the name of an action; a push of a joint is named after the joint."""
_CORNER = "the corner is round over s"
FUNCTIONS = {
    "linear": "in proportion to {0}",
    "square": "in proportion to the square of {0}",
    "absolute value": "in proportion to the size of {0}",
    "round absolute value": "that grows with the size of {0}; " + _CORNER,
    "signed square": "in proportion to the square of {0}, with its sign",
    "linear and signed square": "with a part in proportion to {0} and one in proportion to its square, with its sign",
    "affine": "with a constant part and one in proportion to {0}",
    "saturation": "that grows with {0} and levels off beyond s",
    "even saturation": "that grows with the size of {0} and levels off beyond s",
    "threshold": "that is there where {0} is above v0; it changes over s",
    "falling threshold": "that is there where {0} is below v0; it changes over s",
    "bump": "that is there where {0} is near v0, within s",
    "peak": "that is largest where {0} is v0, and half as large s away from there",
    "ramp": "that is zero below v0 and grows with {0} above it; " + _CORNER,
    "falling ramp": "that is zero above v0 and grows as {0} falls below it; " + _CORNER,
    "two ramps": "that is zero from -v0 to v0 and grows with the size of {0} beyond; " + _CORNER,
    "decay": "that dies away with {0}, to 1 / e over s",
    "logarithm": "that grows with the logarithm of {0} beyond s",
    "play": "that is zero from -v0 to v0, and in proportion to {0} beyond, with its sign; " + _CORNER,
    "square wave": "that is there and is not, in turns, as {0} grows: k is the wave number; the change takes s / k",
    "wave": "that repeats with {0}: k is the wave number",
    "harmonic": "that repeats with each turn of {0}",
    "second harmonic": "that repeats with each half turn of {0}",
    "square of a cosine": "that goes with the square of the cosine of {0} less q, with its sign, as of wind on a plate",
    "product": "in proportion to {0} times {1}",
    "sum": "with a part in proportion to {0} and one in proportion to {1}",
    "plane": "that changes in proportion to the place, {0} and {1}",
    "bump in the plane": "that is there around the point (x0, y0), within s",
    "threshold in the plane": "that is there on one side of a line: the line is d from the origin in the direction q,"
    " and the change takes s",
    "stripe in the plane": "that is there along a line, within s: the line is d from the origin in the direction q",
    "oval": "that is there on an oval around (x0, y0), as a puddle: its half axes are d in the direction q and h"
    " across, and its edge is s times as wide",
    "mat": "that is there on a rectangle with round corners around (x0, y0), as a mat: its half sides are d in the"
    " direction q and h across, and its edge is s times as wide",
    "tiles": "that is larger and smaller in turns along both axes of the cameras, as on a floor of tiles of two kinds:"
    " k is the wave number, p and q are the phases along x and y, and the change takes s",
    "wave in the plane": "that repeats along the direction q of the floor: k is the wave number",
    "constant": "with the same size at all times",
    "smooth function": "that is a smooth function of {0}",
    "smooth function of two": "that is a smooth function of {0} and {1}",
    "series": "that repeats with {0}, in several harmonics",
}
"""How it depends on its variables, by the name of a form."""
WHOLE = {
    "spring": "the pull of a spring to the point (x0, y0), k per metre",
    "hill": "the slope of a hill in the floor, or of a dip, around the point (x0, y0), of the width s",
    "whirl": "a force around the point (x0, y0), at right angles to the way there, of the width s, as of turning air",
    "trough": "a force that changes its sign at a line, over s: the line is d from the origin in the direction q",
    "fence": "the push of an elastic fence along a line: zero on one side of the line, and in proportion to how far the"
    " vehicle is beyond it on the other; the line is d from the origin in the direction q; " + _CORNER,
    "tether": "the pull of a line to the point (x0, y0): slack up to the length d, 2 k per metre beyond; " + _CORNER,
    "tether at a point": "the pull of a line from the point (x0, y0), h above the floor, on the point p ahead of the"
    " centre of the body: slack up to the length d, 2 k per metre beyond; " + _CORNER,
    "magnet": "the pull of a magnet, s below the point (x0, y0) of the floor, on the point p ahead of the centre of the"
    " body, k per metre near it",
    "cable": "a dry friction of the body in proportion to its distance from the point (x0, y0), as of a cable that is"
    " dragged along",
    "friction at a point": "the dry friction of a point of the body, p ahead of its centre and q to the left; it begins"
    " over the speed s",
    "drag at a point": "the drag of a point of the body, p ahead of its centre and q to the left",
    "friction across at a point": "the dry friction of a wheel or a runner that does not steer, p ahead of the centre,"
    " against motion across the body; it begins over the speed s",
    "drag across at a point": "the drag of a wheel or a fin that does not steer, p ahead of the centre, against motion"
    " across the body",
    "friction at an arm": "the dry friction of the end of an arm that the {0} turns, p long and q beyond its angle; it"
    " begins over the speed s",
    "drag at an arm": "the drag of the end of an arm that the {0} turns, p long and q beyond its angle",
    "unbalance": "the force of a mass off the axis of the {0}, at the angle q on it: a is the mass times its distance",
    "wind": "the drag of the air, as the square of the speed against it: the air moves with the speed v0 in the"
    " direction q",
    "friction across": "a dry friction against motion along the direction q of the floor alone; it begins over the"
    " speed s",
    "falling friction": "a dry friction of the body that falls from a + b at rest to a above the speed v0",
    "falling friction of each axis": "a dry friction along and across the body, each by its own speed, that falls from"
    " a + b at rest to a above the speed v0; it begins over the speed s",
}
"""Forms that are told as a whole, whatever their action is called."""


def in_words(family: Family) -> str:
    """What a form of law says, without a full stop."""
    if family.name in WHOLE:
        return WHOLE[family.name].format(family.variables[0].removesuffix("_rate"))
    variables = [_variable(name) for name in family.variables]
    action = ACTIONS.get(family.action, f"a {family.action}")
    return f"{action} {FUNCTIONS[family.name].format(*variables)}"


def _variable(name: str) -> str:
    """A variable in words: `(rotor_rate + r)` is the rate at which a joint turns in the world."""
    if is_sum(name):
        joint, own = name.strip("()").split(" + ")
        return f"the {joint.replace('_', ' ')} plus {_VARIABLES[own]}"
    return _VARIABLES.get(name, f"the {name.replace('_', ' ')}")
