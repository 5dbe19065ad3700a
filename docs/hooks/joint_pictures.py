"""Zero and sign of each joint, and of the heading, on the board from above: with the angles that the code gives it."""

import io

import numpy as np
from effect_pictures import BOARD, WITH, WITHOUT
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from plan_view import LENGTH, compass, draw_board, turn_arrow

PHI, PSI, RADIUS = 0.45, 0.9, 0.11
"""Angles shown [rad], and radius of the rotor [m]."""


def joints() -> str:
    """The board with all joints at zero, and with positive phi and psi, as SVG."""
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    zero, positive = figure.subplots(1, 2)
    board(zero, 0.0, 0.0, "phi = 0, psi = 0")
    board(positive, PHI, PSI, "phi > 0, psi > 0")
    for place, angle in zip((LENGTH, -LENGTH), angles(PHI), strict=True):
        positive.plot([place, place + 0.15], [0, 0], ":", color=WITHOUT, lw=1)
        turn_arrow(positive, complex(place, 0), 0.13, 0.0, angle, WITH)
    positive.annotate("phi", (0.35, 0.06), color=WITH)
    positive.annotate("phi_back = -phi", (-0.2, -0.2), color=WITH)
    turn_arrow(positive, 0j, RADIUS + 0.03, 0.0, PSI, WITH)
    positive.annotate("psi", (0.12, 0.1), color=WITH)
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def angles(phi: float) -> list[float]:
    """The angles of the front and the back wheelset [rad]."""
    return [wheelset.steering * phi for wheelset in BOARD.wheelsets]


def board(axis: Axes, phi: float, psi: float, title: str) -> None:
    """A board with its rotor; the mark on the rotor points ahead at psi = 0."""
    draw_board(axis, (0.0, 0.0), 0.0, angles(phi))
    axis.add_patch(Circle((0, 0), RADIUS, fill=False, color=WITH, lw=2))
    mark = RADIUS * np.exp(1j * psi)
    axis.plot([0, mark.real], [0, mark.imag], color=WITH, lw=3)
    axis.set_title(title)
    compass(axis, "forward", "left")
