"""The board from above, with its wheelsets: for the pictures of effects, and of zero and sign of each joint."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc

LENGTH = 0.25
WHEEL, TRACK = 0.045, 0.07
"""Half length of the board and of a wheel, half width of a wheelset [m]."""


def draw_board(
    axis: Axes,
    place: tuple[float, float],
    heading: float,
    wheels: Sequence[float] = (0.0, 0.0),
    colour: str = "#707070",
    label: str = "",
    body: bool = True,
) -> None:
    """A board with its middle at `place` [m], with the angles `wheels` [rad] of its front and its back wheelset."""
    turn, at = np.exp(1j * heading), complex(*place)

    def line(points: Sequence[complex], width: float) -> None:
        z = at + turn * np.asarray(points)
        axis.plot(z.real, z.imag, color=colour, lw=width, solid_capstyle="round", zorder=2)

    if body:
        line([-LENGTH, LENGTH], 4)
        line([0.8 * LENGTH + 0.03j, LENGTH, 0.8 * LENGTH - 0.03j], 2)
    for end, angle in zip((LENGTH, -LENGTH), wheels, strict=True):
        spin = np.exp(1j * angle)
        line([end - 1j * TRACK * spin, end + 1j * TRACK * spin], 2)
        for side in (-1j * TRACK, 1j * TRACK):
            line([end + spin * (side - WHEEL), end + spin * (side + WHEEL)], 5)
    if label:
        axis.plot([], [], color=colour, lw=3, label=label)
    axis.set(aspect="equal", xlim=(-0.46, 0.46), ylim=(-0.26, 0.3), xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def compass(axis: Axes, east: str = "x", north: str = "y") -> None:
    """Two arrows in the corner that name the directions of the picture."""
    arrow = {"arrowstyle": "-|>", "color": "black"}
    corner = np.array([-0.45, -0.25])
    for tip, name, where in (((0.1, 0), east, (0.11, 0)), ((0, 0.1), north, (0, 0.11))):
        axis.annotate("", corner + tip, corner, arrowprops=arrow)
        left = {"ha": "left", "va": "center"} if tip[0] else {"ha": "center", "va": "bottom"}
        axis.annotate(name, corner + where, **left)


def turn_arrow(axis: Axes, centre: complex, radius: float, first: float, last: float, colour: str) -> None:
    """An arrow along a circle from the angle `first` to `last` [rad], counter-clockwise where `last` is larger."""
    low, high = np.degrees(sorted((first, last)))
    axis.add_patch(Arc((centre.real, centre.imag), 2 * radius, 2 * radius, theta1=low, theta2=high, color=colour, lw=2))
    tip = centre + radius * np.exp(1j * last)
    before = centre + radius * np.exp(1j * (last - np.sign(last - first) * min(0.15, abs(last - first) / 3)))
    style = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (tip.real, tip.imag), (before.real, before.imag), arrowprops=style)
