"""What was seen: recorded runs of a board, and the case that holds them."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._board import Board
from ._gait import Gait
from ._units import Scalar


class Run(eqx.Module):
    """One recorded run.

    `times` [s] (n,) count from the start of the run at 0; `pose` (n, 3) holds x [m], y [m] and the unwrapped heading
    [rad], NaN where a frame was lost. `payload` is the extra mass [kg] and yaw inertia [kg m^2] this run carried.
    A run that is `moving` was already under way at its first sample `times[0]`; any other starts at rest at time 0.
    """

    name: str = eqx.field(static=True)
    role: str = eqx.field(static=True)
    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    gait: Gait
    payload: Float[Array, "2"] = eqx.field(default_factory=lambda: jnp.zeros(2))
    moving: bool = eqx.field(static=True, default=False)


class Noise(eqx.Module):
    """Standard deviation of one sample: `position` [m] of x and of y, `heading` [rad]; `source` says whence."""

    position: Scalar
    heading: Scalar
    source: str = eqx.field(static=True)

    @property
    def channels(self) -> Float[Array, "3"]:
        """The standard deviations of x, y and heading."""
        return jnp.stack([jnp.asarray(s) for s in (self.position, self.position, self.heading)])


class Case(eqx.Module):
    """A board and its recorded runs, as a case folder describes them; the `area` from (x, y) to (x, y) [m] in which it
    was recorded, where that is stated.
    """

    name: str = eqx.field(static=True)
    title: str = eqx.field(static=True)
    skid: str = eqx.field(static=True)
    board: Board
    runs: tuple[Run, ...]
    noise: Noise | None = None
    sha256: dict[str, str] = eqx.field(static=True, default_factory=dict)
    area: tuple[float, float, float, float] | None = eqx.field(static=True, default=None)

    def having(self, role: str) -> tuple[Run, ...]:
        """The runs of `role` "train" or "heldout"."""
        return tuple(run for run in self.runs if run.role == role)
