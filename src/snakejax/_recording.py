"""What was seen: recorded runs of a board, and the case that holds them."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._board import Board
from ._gait import Gait
from ._units import Scalar

CHANNELS = ("x", "y", "heading")
"""What a pose holds, in the order of its columns."""
UNITS = ("m", "m", "rad")
"""Their units."""


class LogClock(NamedTuple):
    """How the clock of a run's joint log goes: it shows t (1 + `drift`) + `offset` [s] at the cameras' time t.

    `offset_sd` and `drift_sd` are standard errors, None for what was given; `source` says whence they are. `free` names
    those of "offset" and "drift" that a fit is to estimate.
    """

    offset: float = 0.0
    drift: float = 0.0
    offset_sd: float | None = None
    drift_sd: float | None = None
    source: str = "case.toml"
    free: tuple[str, ...] = ()

    def camera_times(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The cameras' times [s] at which this clock shows `times`."""
        return (times - self.offset) / (1 + self.drift)


class Run(eqx.Module):
    """One recorded run.

    `times` [s] (n,) count from the start of the run at 0; `pose` (n, 3) holds x [m], y [m] and the unwrapped heading
    [rad], NaN where a frame was lost. `payload` is the extra mass [kg] and yaw inertia [kg m^2] this run carried.
    A run that is `moving` was already under way at its first sample `times[0]`; any other starts at rest at time 0.
    `log`, where its joints were logged, is how the log's clock goes; the gait is on the cameras' already. `wander`
    (n, 3, q): where that log has noise, the model's pose is off by wander z with z standard normal, in m and rad.
    """

    name: str = eqx.field(static=True)
    role: str = eqx.field(static=True)
    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    gait: Gait
    payload: Float[Array, "2"] = eqx.field(default_factory=lambda: jnp.zeros(2))
    moving: bool = eqx.field(static=True, default=False)
    log: LogClock | None = eqx.field(static=True, default=None)
    wander: Float[Array, "n 3 q"] | None = None


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
