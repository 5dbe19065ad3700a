"""What was seen: recorded runs of a board, and the case that holds them."""

from typing import NamedTuple

import equinox as eqx
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar
from snakejax.core.tabular import counted
from snakejax.dynamics.conditions import codes_of
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.vehicle import AbstractVehicle


class LogClock(NamedTuple):
    """The clock of a joint log: at time t of the cameras it shows t (1 + `drift`) + `offset` [s].

    `offset_sd`, `drift_sd`: standard errors, None for given values; `source`: where the values come from. `free`: which
    of "offset" and "drift" a fit estimates.
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
    A window of a longer run is `cut_from` the run of that name. `labels`: key and label of what it is labelled with, as
    in ("floor", "rubber"). Errors of predictions are reported for each `group`.
    """

    name: str = eqx.field(static=True)
    role: str = eqx.field(static=True)
    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    gait: AbstractInputs
    payload: Float[Array, "2"] = eqx.field(default_factory=lambda: jnp.zeros(2))
    moving: bool = eqx.field(static=True, default=False)
    log: LogClock | None = eqx.field(static=True, default=None)
    wander: Float[Array, "n 3 q"] | None = None
    cut_from: str | None = eqx.field(static=True, default=None)
    labels: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())

    def __repr__(self) -> str:
        """`Run lap-3: train, 120 frames in 6 s`."""
        frames = counted(self.times.shape[-1], "frame")
        if isinstance(self.times, jax.core.Tracer) or self.times.ndim != 1 or not self.times.size:
            return f"Run {self.name}: {self.role}, {frames}"
        return f"Run {self.name}: {self.role}, {frames} in {float(self.times[-1] - self.times[0]):.3g} s"

    @property
    def group(self) -> str | None:
        """The group of the run, where it has one."""
        return dict(self.labels).get("group")

    @property
    def codes(self) -> Float[np.ndarray, "4"]:
        """The labels as numbers."""
        return codes_of(dict(self.labels))

    @property
    def recorded_as(self) -> str:
        """The name of the recorded run: of a window that of the run it is cut from."""
        return self.name if self.cut_from is None else self.cut_from


class Noise(eqx.Module):
    """Standard deviation of one sample: `position` [m] of x and of y, `heading` [rad].

    `source`: where the values come from. `correlation` [s]: time constant of correlated noise, None if it is not
    stated.
    """

    position: Scalar
    heading: Scalar
    source: str = eqx.field(static=True)
    correlation: float | None = eqx.field(static=True, default=None)

    def __repr__(self) -> str:
        """`Noise: 0.3 mm, 1 mrad (stated)`."""
        if isinstance(self.position, jax.core.Tracer) or isinstance(self.heading, jax.core.Tracer):
            return f"Noise ({self.source})"
        position, heading = 1e3 * float(self.position), 1e3 * float(self.heading)
        wander = "" if self.correlation is None else f", wanders over {self.correlation:.3g} s"
        return f"Noise: {position:.3g} mm, {heading:.3g} mrad ({self.source}){wander}"

    @property
    def channels(self) -> Float[Array, "3"]:
        """The standard deviations of x, y and heading."""
        return jnp.stack([jnp.asarray(s) for s in (self.position, self.position, self.heading)])


class NeededAccuracy(NamedTuple):
    """What a user needs of a simulation: errors of at most `position` [m] and `heading` [rad] after `horizon` [s]."""

    position: float
    heading: float
    horizon: float


class Case(eqx.Module):
    """A vehicle and its recorded runs, as a case folder describes them.

    `area`: (x, y, x, y) [m], the lowest and the highest corner of the floor, None if it is not stated. `reading`: by
    run, sentences about what the reader of its file decided. `constant_sd`: stated standard deviations of constants of
    the vehicle [SI] by field name. `needed`: the stated accuracy that a simulation must have. `search`: criteria of the
    search for effects, by name. `recordings`: the whole recordings; the runs are these or windows of them.
    """

    name: str = eqx.field(static=True)
    title: str = eqx.field(static=True)
    constraint: str = eqx.field(static=True)
    board: AbstractVehicle
    runs: tuple[Run, ...]
    noise: Noise | None = None
    sha256: dict[str, str] = eqx.field(static=True, default_factory=dict)
    area: tuple[float, float, float, float] | None = eqx.field(static=True, default=None)
    reading: dict[str, tuple[str, ...]] = eqx.field(static=True, default_factory=dict)
    constant_sd: dict[str, float] = eqx.field(static=True, default_factory=dict)
    needed: NeededAccuracy | None = eqx.field(static=True, default=None)
    search: dict[str, float] = eqx.field(static=True, default_factory=dict)
    recordings: tuple[Run, ...] = ()

    def __repr__(self) -> str:
        """`Case tilted-floor: Board, free; 5 train runs and 2 held-out runs`."""
        train, heldout = (len(self.having(role)) for role in ("train", "heldout"))
        runs = f"{counted(train, 'train run')} and {counted(heldout, 'held-out run')}"
        return f"Case {self.name}: {type(self.board).__name__}, {self.constraint}; {runs}"

    def having(self, role: str) -> tuple[Run, ...]:
        """The runs of `role` "train" or "heldout"."""
        return tuple(run for run in self.runs if run.role == role)
