"""Runs of a gait that is still to be chosen, and their derivative by its unknowns."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._gait import Gait, Tracked
from ._model import Model
from ._shapes import AbstractShape
from ._simulate import Accuracy, simulate
from ._torque import effort, torques
from ._units import Parametrised, Scalar, param

ACCURACY = Accuracy(rtol=1e-6, atol=1e-8, max_steps=65536, derivative="forward")
"""Accuracy of the search; what was found is simulated again, more accurately."""


class Driver(Parametrised):
    """How joints follow their commands: by the controller of eq. (8), or exactly where it has no gains."""

    kp: Scalar | None = param("1/s^2", positive=True, default=None)
    kd: Scalar | None = param("1/s", low=0.0, default=None)

    @staticmethod
    def of(gait: Gait) -> "Driver":
        """As the joints of `gait` do."""
        return Driver(gait.phi.kp, gait.phi.kd) if isinstance(gait.phi, Tracked) else Driver()

    def driven(self, command: Gait) -> Gait:
        """The gait that `command` makes."""
        if self.kp is None:
            return command
        return Gait(Tracked(command.phi, self.kp, self.kd), Tracked(command.psi, self.kp, self.kd))


class Ask(eqx.Module):
    """What is simulated whatever the gait: how joints follow, when to look, where to start, and whether to count the
    effort.
    """

    shape: AbstractShape
    driver: Driver
    times: Float[Array, " n"]
    start: Float[Array, " 3"]
    counts_effort: bool = eqx.field(static=True)

    def gait(self, unknowns: Float[Array, " P"]) -> Gait:
        """The gait of `unknowns`."""
        return self.driver.driven(self.shape.gait(unknowns))


class Seen(NamedTuple):
    """Poses (n, 3) and effort of a run; with a further axis, of several runs, or a derivative."""

    pose: Float[Array, "n 3"]
    effort: Scalar


def ran(model: Model, gait: Gait, times, start, counts_effort: bool, accuracy: Accuracy) -> Seen:
    """One run; its poses are infinite where the simulation fails."""
    done = simulate(model, gait, times, start, accuracy=accuracy, throw=False)
    if not counts_effort:
        return Seen(done.pose, jnp.full((), jnp.nan))
    return Seen(done.pose, effort(done.times, torques(model, gait, done)))


@eqx.filter_jit
def seen(model: Model, ask: Ask, unknowns: Float[Array, "S P"]) -> Seen:
    """The runs of many gaits side by side, poses (S, n, 3)."""
    return jax.vmap(lambda z: ran(model, ask.gait(z), ask.times, ask.start, ask.counts_effort, ACCURACY))(unknowns)


@eqx.filter_jit
def sloped(model: Model, ask: Ask, unknowns: Float[Array, " P"]) -> tuple[Seen, Seen]:
    """The run of one gait, poses (n, 3), and its derivative by the unknowns, poses (n, 3, P)."""

    def of(z):
        return ran(model, ask.gait(z), ask.times, ask.start, ask.counts_effort, ACCURACY)

    def along(direction):
        return jax.jvp(of, (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(unknowns.size))
