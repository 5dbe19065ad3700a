"""What a gait is tuned for. A user's own objective is a function of what was done, `Own(function)`."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._math import safe_norm
from ._units import Parametrised, Scalar, param

CENTIMETRE, DEGREE = 0.01, np.pi / 180
FRAME_RATE = 100.0
"""Samples a second for what is an integral over a run."""


class Ran(NamedTuple):
    """A run at `times` [s] (n,) from 0 on: the reported `pose` (n, 3), x, y [m] and heading [rad], and the `effort`,
    the integral of the squared joint torques [N^2 m^2 s], NaN where the objective does not ask for it.
    """

    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    effort: Scalar


class Objective(Parametrised):
    """What to make small, and what to make zero."""

    whole: ClassVar[bool] = False
    """Whether it looks at the whole run, 100 frames a second, or at its two ends."""
    counts_effort: ClassVar[bool] = False
    """Whether it asks for the effort."""

    once: ClassVar[bool] = False
    """Whether a gait that meets it is as good as any other that does."""

    @abc.abstractmethod
    def cost(self, ran: Ran) -> Scalar:
        """What is made as small as can be."""

    def residual(self, ran: Ran) -> Float[Array, " k"]:
        """What must be zero, in units of what one would tolerate."""
        del ran
        return jnp.zeros(0)

    def together(self, runs: Ran) -> tuple[Scalar, Float[Array, " k"]]:
        """Cost and residual of the runs of one gait on several boards (M, ...): their means.

        What is zero in the mean alone is made small on each of several boards besides.
        """
        every = (None, 0, 0)
        cost, left = (jax.vmap(f, in_axes=(Ran(*every),))(runs) for f in (self.cost, self.residual))
        scatter = jnp.sum(left**2, axis=1) if left.shape[0] > 1 else jnp.zeros_like(cost)
        return jnp.mean(cost + scatter), jnp.mean(left, axis=0)

    @abc.abstractmethod
    def result(self, ran: Ran) -> Any:
        """What was achieved, as the JSON reports it."""

    def times(self, seconds: float) -> Float[np.ndarray, " n"]:
        """When it looks [s]."""
        whole = self.whole or self.counts_effort
        return np.linspace(0.0, seconds, int(np.ceil(seconds * FRAME_RATE)) + 1 if whole else 2)


class Distance(Objective):
    """The distance from start to end along a straight line [m], as far as can be."""

    def cost(self, ran: Ran) -> Scalar:
        return -distance(ran)

    def result(self, ran: Ran) -> float:
        return float(distance(ran))


class Turn(Objective):
    """The angle by which the board has turned at the end [rad], to either side, as far as can be."""

    def cost(self, ran: Ran) -> Scalar:
        return -jnp.abs(_turn(ran))

    def result(self, ran: Ran) -> float:
        return float(jnp.abs(_turn(ran)))


class Reach(Objective):
    """The pose (x [m], y [m], heading [rad]) at the end. The heading counts its turns: 2 pi is once around."""

    once: ClassVar[bool] = True
    x: Scalar = param("m")
    y: Scalar = param("m")
    heading: Scalar = param("rad")

    def _miss(self, ran: Ran) -> Float[Array, " 3"]:
        return ran.pose[-1] - jnp.stack([jnp.asarray(part) for part in (self.x, self.y, self.heading)])

    def cost(self, ran: Ran) -> Scalar:
        return jnp.zeros_like(ran.pose[-1, 0])

    def residual(self, ran: Ran) -> Float[Array, " 3"]:
        return self._miss(ran) / jnp.array([CENTIMETRE, CENTIMETRE, DEGREE])

    def result(self, ran: Ran) -> dict[str, float]:
        miss = np.asarray(self._miss(ran))
        return {"position_error_m": float(np.hypot(*miss[:2])), "heading_error_rad": float(abs(miss[2]))}


class Effort(Objective):
    """A distance [m] with the least effort."""

    counts_effort: ClassVar[bool] = True
    distance: Scalar = param("m", positive=True)

    def cost(self, ran: Ran) -> Scalar:
        return ran.effort

    def residual(self, ran: Ran) -> Float[Array, " 1"]:
        return (distance(ran) - self.distance)[None] / CENTIMETRE

    def result(self, ran: Ran) -> dict[str, float]:
        return {"effort_n2m2s": float(ran.effort), "distance_m": float(distance(ran))}


class Own(Objective):
    """A function of `Ran` that a user writes with `jax.numpy`, to be made as small as can be."""

    whole: ClassVar[bool] = True
    counts_effort: ClassVar[bool] = True
    function: Callable[[Ran], Scalar] = eqx.field(static=True)

    def cost(self, ran: Ran) -> Scalar:
        return jnp.asarray(self.function(ran))

    def result(self, ran: Ran) -> float:
        return float(self.function(ran))


def distance(ran: Ran) -> Scalar:
    """From start to end along a straight line [m]."""
    return safe_norm(ran.pose[-1, 0] - ran.pose[0, 0], ran.pose[-1, 1] - ran.pose[0, 1])


def _turn(ran: Ran) -> Scalar:
    return ran.pose[-1, 2] - ran.pose[0, 2]
