"""Objectives of gait optimisation; `Custom(function)` is a user's own objective, a function of a `Rollout`."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.fast_math import safe_norm
from snakejax.core.parameter import Parametrised, Scalar, param

CENTIMETRE, DEGREE = 0.01, np.pi / 180
"""Tolerances [m], [rad] in which residuals are counted."""
FRAME_RATE = 100.0
"""Samples per second of integrals over a run."""


class Rollout(NamedTuple):
    """A simulated run at `times` (n,) [s] from 0: the reported `pose` (n, 3), x, y [m] and heading [rad], and `effort`,
    the integral of the squared joint torques [N^2 m^2 s] (NaN if the objective does not use it).
    """

    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    effort: Scalar


class Objective(Parametrised):
    """An objective: a cost to minimise and a residual to make zero."""

    whole: ClassVar[bool] = False
    """Whether it uses the whole run at `FRAME_RATE`, or only its first and last pose."""
    counts_effort: ClassVar[bool] = False
    """Whether it uses the effort."""

    once: ClassVar[bool] = False
    """Whether the search can stop at the first gait that satisfies the residual."""

    @abc.abstractmethod
    def cost(self, rollout: Rollout) -> Scalar:
        """The cost to minimise."""

    def residual(self, rollout: Rollout) -> Float[Array, " k"]:
        """The residual (k,) that must be zero, in units of its tolerance."""
        del rollout
        return jnp.zeros(0)

    def together(self, runs: Rollout) -> tuple[Scalar, Float[Array, " k"]]:
        """Mean cost and mean residual (k,) of the runs of one gait on M boards, arrays (M, ...).

        For several boards the sum of squared residuals is added to the cost: a zero mean residual alone would not make
        the residual of each board small.
        """
        axes = (None, 0, 0)
        cost, residual = (jax.vmap(f, in_axes=(Rollout(*axes),))(runs) for f in (self.cost, self.residual))
        scatter = jnp.sum(residual**2, axis=1) if residual.shape[0] > 1 else jnp.zeros_like(cost)
        return jnp.mean(cost + scatter), jnp.mean(residual, axis=0)

    @abc.abstractmethod
    def result(self, rollout: Rollout) -> Any:
        """The achieved result, as reported in the JSON output."""

    def times(self, seconds: float) -> Float[np.ndarray, " n"]:
        """The times (n,) [s] at which it needs the run."""
        whole = self.whole or self.counts_effort
        return np.linspace(0.0, seconds, int(np.ceil(seconds * FRAME_RATE)) + 1 if whole else 2)


class Distance(Objective):
    """Maximise the straight distance from start to end [m]."""

    def cost(self, rollout: Rollout) -> Scalar:
        return -distance(rollout)

    def result(self, rollout: Rollout) -> float:
        return float(distance(rollout))


class Turn(Objective):
    """Maximise the absolute change of heading from start to end [rad]."""

    def cost(self, rollout: Rollout) -> Scalar:
        return -jnp.abs(_turn(rollout))

    def result(self, rollout: Rollout) -> float:
        return float(jnp.abs(_turn(rollout)))


class Reach(Objective):
    """Reach the pose (x [m], y [m], heading [rad]) at the end; the heading is unwrapped, 2 pi is one full turn."""

    once: ClassVar[bool] = True
    x: Scalar = param("m")
    y: Scalar = param("m")
    heading: Scalar = param("rad")

    def _miss(self, rollout: Rollout) -> Float[Array, " 3"]:
        return rollout.pose[-1] - jnp.stack([jnp.asarray(part) for part in (self.x, self.y, self.heading)])

    def cost(self, rollout: Rollout) -> Scalar:
        return jnp.zeros_like(rollout.pose[-1, 0])

    def residual(self, rollout: Rollout) -> Float[Array, " 3"]:
        return self._miss(rollout) / jnp.array([CENTIMETRE, CENTIMETRE, DEGREE])

    def result(self, rollout: Rollout) -> dict[str, float]:
        miss = np.asarray(self._miss(rollout))
        return {"position_error_m": float(np.hypot(*miss[:2])), "heading_error_rad": float(abs(miss[2]))}


class Effort(Objective):
    """Travel a `distance` [m] with the least effort."""

    counts_effort: ClassVar[bool] = True
    distance: Scalar = param("m", positive=True)

    def cost(self, rollout: Rollout) -> Scalar:
        return rollout.effort

    def residual(self, rollout: Rollout) -> Float[Array, " 1"]:
        return (distance(rollout) - self.distance)[None] / CENTIMETRE

    def result(self, rollout: Rollout) -> dict[str, float]:
        return {"effort_n2m2s": float(rollout.effort), "distance_m": float(distance(rollout))}


class Custom(Objective):
    """Minimise a user's function of a `Rollout`, written with `jax.numpy`."""

    whole: ClassVar[bool] = True
    counts_effort: ClassVar[bool] = True
    function: Callable[[Rollout], Scalar] = eqx.field(static=True)

    def cost(self, rollout: Rollout) -> Scalar:
        return jnp.asarray(self.function(rollout))

    def result(self, rollout: Rollout) -> float:
        return float(self.function(rollout))


def distance(rollout: Rollout) -> Scalar:
    """The straight distance from start to end [m]."""
    return safe_norm(rollout.pose[-1, 0] - rollout.pose[0, 0], rollout.pose[-1, 1] - rollout.pose[0, 1])


def _turn(rollout: Rollout) -> Scalar:
    return rollout.pose[-1, 2] - rollout.pose[0, 2]
