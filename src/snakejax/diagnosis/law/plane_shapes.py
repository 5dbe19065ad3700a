"""Where forms of law of the place begin: the parameters of their shape, from what was seen of the place."""

from typing import NamedTuple

import numpy as np

from .terms import Range, ShapeParameter
from .units import Unit

METRE: Unit = {"m": 1}
"""The unit of a place."""
SMALL = 0.05
"""The width of a small spot, as a share of the size of what was seen. A lattice over all places would be large: it is
looked for where the vehicle was."""


class PlaneShapes(NamedTuple):
    """Parameters of the shape of what is in the plane, over the `size` [m] of what was seen of it.

    `point`: (x0, y0); `width` s; of a line the direction q, over half a turn or `around` a whole one, and the distance
    d from the origin; `corner` s: over what a corner is round. `small_spots`: x0, y0 and s of those near a path.
    """

    size: float
    point: tuple[ShapeParameter, ShapeParameter]
    width: ShapeParameter
    direction: ShapeParameter
    around: ShapeParameter
    distance: ShapeParameter
    corner: ShapeParameter
    small_spots: tuple[tuple[float, float, float], ...]

    @staticmethod
    def of(x: Range, y: Range, places: np.ndarray) -> "PlaneShapes":
        """Those of a place of which `x` and `y` were seen, and the `places` (M, 2) of a path."""
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
        corner, small = s._replace(starts=(0.05 * size,), low=0.002 * size), SMALL * size
        spots = tuple((*place, small) for place in _lattice_near(places, small))
        return PlaneShapes(size, (x0, y0), s, q, around, d, corner, spots)


def _lattice_near(places: np.ndarray, spacing: float) -> list[tuple[float, float]]:
    """The points of a square lattice of this `spacing` around which one of the `places` (M, 2) is in the square of
    three spacings."""
    at = np.unique(np.round(places / spacing).astype(int), axis=0)
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    near = np.unique((at[:, None] + steps).reshape(-1, 2), axis=0)
    return [(float(a), float(b)) for a, b in spacing * near]
