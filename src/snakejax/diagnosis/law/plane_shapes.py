"""Where forms of law of the place begin: the parameters of their shape, from what was seen of the place."""

from typing import NamedTuple

import numpy as np

from .terms import Range, ShapeParameter
from .units import Unit

METRE: Unit = {"m": 1}
"""The unit of a place."""


class PlaneShapes(NamedTuple):
    """Parameters of the shape of what is in the plane, over the `size` [m] of what was seen of it.

    `point`: (x0, y0); `width` s; of a line the direction q, over half a turn or `around` a whole one, and the distance
    d from the origin; `corner` s: over what a corner is round.
    """

    size: float
    point: tuple[ShapeParameter, ShapeParameter]
    width: ShapeParameter
    direction: ShapeParameter
    around: ShapeParameter
    distance: ShapeParameter
    corner: ShapeParameter

    @staticmethod
    def of(x: Range, y: Range) -> "PlaneShapes":
        """Those of a place of which `x` and `y` were seen."""
        size = max(x.width, y.width)
        x0, y0 = (
            ShapeParameter(
                name,
                METRE,
                tuple(np.linspace(interval.low, interval.high, 6)),
                interval.low - size,
                interval.high + size,
            )
            for name, interval in (("x0", x), ("y0", y))
        )
        s = ShapeParameter("s", METRE, (0.15 * size, 0.4 * size), 0.01 * size, 5 * size)
        q = ShapeParameter("q", {"rad": 1}, tuple(np.pi * np.arange(8) / 8))
        d = ShapeParameter("d", METRE, tuple(size * np.linspace(-0.4, 0.4, 5)), -3 * size, 3 * size)
        around = q._replace(starts=tuple(np.pi * np.arange(16) / 8))
        return PlaneShapes(size, (x0, y0), s, q, around, d, s._replace(starts=(0.05 * size,), low=0.002 * size))
