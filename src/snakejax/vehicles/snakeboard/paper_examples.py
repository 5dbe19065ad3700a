"""Examples of Salman et al., CDC 2016, by name: board, tyre, gait and duration."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.errors import InputError, instead_of
from snakejax.core.jax_config import require_x64
from snakejax.core.parameter import Scalar
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.dynamics.tyres import Bakker, Pacejka

from .board import TABLE_II, Board

FRAME_RATE = 100.0
"""Frames per second of the times of a preset."""
GAINS = dict(kp=100.0, kd=10.0)
"""Gains of the controller of eq. (8): kp [1/s^2], kd [1/s]."""

Terms = Sequence[Sequence[float]]

# Duration [s], steering and rotor in the form of `case.toml`; a constant is a sine of frequency 0 and phase pi/2.
_QUARTER = np.pi / 2
GAITS: dict[str, tuple[float, Terms, Terms]] = {
    "paper-gait1": (35.0, [[0.3, 1.0, 0.0]], [[0.5, 1.0, 0.0]]),
    "paper-gait2": (35.0, [[0.2, 0.0, _QUARTER]], [[0.5, 1.0, _QUARTER]]),
    "paper-forward": (7.7, [[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "paper-rotate": (14.0, [[0.916, 2.0, 0.0]], [[1.57, 4.0, 0.0]]),
}
LOADS = {"paper-gait1": (2.54, 0.52), "paper-gait2": (5.08, 0.3)}
"""Default load [N] on each wheelset and camber [rad]."""

PRESETS = tuple(GAITS)


class Preset(eqx.Module):
    """An example of the paper: at rest at the origin at time 0; `times` (n,) [s] at `FRAME_RATE`."""

    name: str = eqx.field(static=True)
    model: Model
    gait: Gait
    times: Float[Array, " n"]

    def __repr__(self) -> str:
        """`Preset paper-rotate: 14 s`."""
        return f"Preset {self.name}: {self.duration:.3g} s"

    @property
    def duration(self) -> float:
        """The duration [s]."""
        return float(self.times[-1])

    @property
    def creep_speed(self) -> Scalar:
        """The rolling speed [m/s] below which the slip angle is regularised."""
        return self.model.board.creep_speed


def preset(name: str, load: float | None = None, camber: float | None = None) -> Preset:
    """An example of Salman et al., CDC 2016, under the coupled structure, with the joint controller of eq. (8).

    `paper-gait1`, `paper-gait2`: the gaits of Table I, 35 s, J_r = 4 kg m^2, J_w = 1 kg m^2, L = 4 m; the mass
    m = 2 load / 9.81 and a Bakker tyre follow from the load. The camber changes the stiffness of the tyre; its offsets
    dSh and dSv are zero, because with them no Rayleigh board reproduces the trajectories of the paper.
    `paper-forward` (7.7 s), `paper-rotate` (14 s): the board and tyre of Table II, the gaits of Table III.

    **Arguments:** `load` [N] on each wheelset and `camber` [rad], only for the gaits of Table I.
    **Raises:** `InputError` for a name that is not one of `PRESETS`, or an invalid load or camber.
    """
    require_x64()
    if name not in GAITS:
        raise InputError(f"There is no preset `{name}`", "argument CASE", instead_of(name, PRESETS))
    duration, phi, psi = GAITS[name]
    gait = Gait(Tracked(Sines.of(phi), **GAINS), Tracked(Sines.of(psi), **GAINS))
    times = jnp.asarray(np.arange(round(duration * FRAME_RATE) + 1) / FRAME_RATE)
    if name in LOADS:
        model = _loaded(
            *(
                given if given is not None else default
                for given, default in zip((load, camber), LOADS[name], strict=True)
            )
        )
    elif load is not None or camber is not None:
        option = "--load" if load is not None else "--camber"
        remedy = f"leave it out, or take one of {', '.join(LOADS)}"
        raise InputError(
            f"`{name}` has the tyre of Table II, which does not depend on load or camber", f"option {option}", remedy
        )
    else:
        model = Model(Board(**TABLE_II), Pacejka(B=0.09, C=2.0, D=1.0, E=0.6), "coupled")
    return Preset(name, model, gait, times)


def _loaded(load: float, camber: float) -> Model:
    if not (np.isfinite(load) and load > 0):
        raise InputError(
            f"The load {load:g} N is not above 0", "option --load", "give the load on one wheelset in N, above 0"
        )
    if not abs(camber) < _QUARTER:
        raise InputError(
            f"The camber {camber:g} rad is out of range", "option --camber", "give it in rad, within +- pi/2"
        )
    board = Board(mass=mass_under(load), rotor_inertia=4.0, wheelset_inertia=1.0, half_length=4.0)
    tyre = Bakker(load, camber, offsets=False)
    try:
        tyre.coefficients()
    except ValueError as error:
        what = f"A load of {load:g} N with a camber of {camber:g} rad is beyond Bakker's formulas"
        remedy = "come nearer to those of the paper"
        raise InputError(f"{what}: {str(error).rstrip('.')}", "options --load and --camber", remedy) from error
    return Model(board, tyre, "coupled")


def mass_under(load):
    """The mass [kg] of a board whose weight loads each of two wheelsets with `load` [N]: 2 load / g."""
    return 2 * load / GRAVITY
