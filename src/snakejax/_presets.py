"""The examples of the paper, by name: board, tyre, gait and duration."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._board import TABLE_II, Board
from ._errors import InputError, instead_of
from ._gait import Gait, Sines, Tracked
from ._model import Model
from ._tyre import Bakker, Pacejka
from ._units import Scalar, require_x64

GRAVITY = 9.81
FRAME_RATE = 100.0
"""Frames a second at which a preset reports."""
GAINS = dict(kp=100.0, kd=10.0)

Terms = Sequence[Sequence[float]]

# Duration [s], steering and rotor as `case.toml` writes them; a constant is a sine of frequency 0 and phase pi/2.
_QUARTER = np.pi / 2
GAITS: dict[str, tuple[float, Terms, Terms]] = {
    "paper-gait1": (35.0, [[0.3, 1.0, 0.0]], [[0.5, 1.0, 0.0]]),
    "paper-gait2": (35.0, [[0.2, 0.0, _QUARTER]], [[0.5, 1.0, _QUARTER]]),
    "paper-forward": (7.7, [[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "paper-rotate": (14.0, [[0.916, 2.0, 0.0]], [[1.57, 4.0, 0.0]]),
}
LOADS = {"paper-gait1": (2.54, 0.52), "paper-gait2": (5.08, 0.3)}
"""The load [N] on each wheelset and the camber [rad] where none are given."""

PRESETS = tuple(GAITS)


class Preset(eqx.Module):
    """An example of the paper. At rest at the origin at time 0; `times` [s] (n,) at 100 frames a second."""

    name: str = eqx.field(static=True)
    model: Model
    gait: Gait
    times: Float[Array, " n"]

    @property
    def duration(self) -> float:
        """How long it lasts [s]."""
        return float(self.times[-1])

    @property
    def creep_speed(self) -> Scalar:
        """The wheel speed below which slip forces fade out [m/s]."""
        return self.model.board.creep_speed


def preset(name: str, load: float | None = None, camber: float | None = None) -> Preset:
    """An example of the paper (CDC 2016) under the coupled structure, its joints under the controller of eq. (8).

    `paper-gait1`, `paper-gait2`: the gaits of Table I, 35 s, J_r = 4 kg m^2, J_w = 1 kg m^2, L = 4 m; the mass
    m = 2 load / 9.81 and a Bakker tyre follow from the load. The camber acts through its stiffness; the camber offsets
    dSh and dSv are left out, since with them no Rayleigh board comes near the trajectories of the paper.
    `paper-forward` (7.7 s), `paper-rotate` (14 s): the board and tyre of Table II, the gaits of Table III.

    **Arguments:** `load` [N] on each wheelset and `camber` [rad], for the gaits of Table I alone.
    **Raises:** `InputError` for a name that is not one of `PRESETS`, or a load or camber that cannot be used.
    """
    require_x64()
    if name not in GAITS:
        raise InputError(f"There is no preset `{name}`", "argument CASE", instead_of(name, PRESETS))
    duration, phi, psi = GAITS[name]
    gait = Gait(Tracked(Sines.of(phi), **GAINS), Tracked(Sines.of(psi), **GAINS))
    times = jnp.asarray(np.arange(round(duration * FRAME_RATE) + 1) / FRAME_RATE)
    if name in LOADS:
        model = _loaded(
            *(given if given is not None else usual for given, usual in zip((load, camber), LOADS[name], strict=True))
        )
    elif load is not None or camber is not None:
        option = "--load" if load is not None else "--camber"
        remedy = f"leave it out, or take one of {', '.join(LOADS)}"
        raise InputError(
            f"`{name}` has the tyre of Table II, which knows no load or camber", f"option {option}", remedy
        )
    else:
        model = Model(Board(**TABLE_II), Pacejka(B=0.09, C=2.0, D=1.0, E=0.6), "coupled")
    return Preset(name, model, gait, times)


def _loaded(load: float, camber: float) -> Model:
    if not (np.isfinite(load) and load > 0):
        raise InputError(
            f"A load of {load:g} N is none", "option --load", "give the load on one wheelset in N, above 0"
        )
    if not abs(camber) < _QUARTER:
        raise InputError(f"A camber of {camber:g} rad is none", "option --camber", "give it in rad, within +- pi/2")
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
    """The mass [kg] of a board that presses each of its two wheelsets down with `load` [N]."""
    return 2 * load / GRAVITY
