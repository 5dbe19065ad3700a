"""What lies under the board, and where the board's weight lies over it."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp

from .._board import Board
from .._effect import Force, Layout, Motion, Wrench
from .._skid import Coupled, Printed
from .._units import Scalar, param

if TYPE_CHECKING:
    from .._model import Model

GRAVITY = 9.81


class GroundSlope(Force):
    """World-frame force -m g (sx, sy) at the centre of mass; positive is uphill along the axis."""

    sentence = "The floor is not level."
    sx: Scalar = param("rad", default=0.0)
    sy: Scalar = param("rad", default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        weight = motion.board.mass * GRAVITY
        X, Y = motion.into_body(-weight * self.sx, -weight * self.sy)
        return X, Y, jnp.zeros_like(X)


class ComOffset(Layout):
    """The centre of mass, which x and y track, lies a ahead of the middle: wheelsets at L - a and -(L + a)."""

    sentence = "The centre of mass is not in the middle between the wheelsets."
    a: Scalar = param("m", default=0.0)

    def board(self, board: Board) -> Board:
        return eqx.tree_at(lambda b: b.offset, board, board.offset + self.a)

    def refusal(self, model: "Model") -> str | None:
        if isinstance(model.skid, Coupled | Printed):
            return "the coupled structure has its wheelsets at +L and -L; use skid `free` for an offset."
        return None
