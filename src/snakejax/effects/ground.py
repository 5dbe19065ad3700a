"""Slope of the ground, and position of the centre of mass."""

from typing import TYPE_CHECKING

import jax.numpy as jnp

from snakejax.core.parameter import Scalar, param
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.contact import Motion, Wrench
from snakejax.dynamics.ports import Force, Geometry
from snakejax.dynamics.vehicle import AbstractVehicle

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model


class GroundSlope(Force):
    """Component of the weight along a floor that is not level, at the centre of mass, g = 9.81 m/s^2.

        (force along world x, force along world y) = -m g (sx, sy)

    Positive sx: the floor rises along the x axis of the cameras, so the force points to smaller x. The same for sy
    and y.
    """

    description = "The ground is not level: it rises by sx along x and by sy along y."
    sx: Scalar = param("rad", default=0.0)
    sy: Scalar = param("rad", default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        weight = motion.board.mass * GRAVITY
        X, Y = motion.into_body(-weight * self.sx, -weight * self.sy)
        return X, Y, jnp.zeros_like(X)


class ComOffset(Geometry):
    """The centre of mass, whose position is (x, y), lies ahead of the middle between the wheelsets.

        arm of the front wheelset = L - a        arm of the back wheelset = -L - a

    Positive a: the centre of mass is nearer to the front wheelset.
    """

    description = "The centre of mass is not in the middle between the wheelsets."
    a: Scalar = param("m", default=0.0)

    def board(self, board: AbstractVehicle) -> AbstractVehicle:
        return board.with_centre_moved(self.a)

    def inapplicable_because(self, model: "Model") -> str | None:
        if type(model.board).with_centre_moved is AbstractVehicle.with_centre_moved:
            return f"the centre of mass of a {model.board.noun} cannot be moved."
        if not model.constraint.allows_offset:
            return "the coupled structure has its wheelsets at +L and -L; use skid `free` for an offset."
        return None
