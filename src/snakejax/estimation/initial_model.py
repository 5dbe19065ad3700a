"""Initial model of a fit, and the parameters that it frees."""

import fnmatch
from collections.abc import Sequence

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import parameters, short_name
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.kinds import MODEL_KINDS, TYRE_LAWS
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.tyres import AbstractTyre, Pacejka, Rayleigh
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.recording.run import Case

FITTED = ("B", "C", "D", "E", "k_s")
"""Parameters of a tyre that a fit frees by default."""


def starting_tyre(kind: str, board: AbstractVehicle) -> AbstractTyre:
    """The initial tyre: for "pacejka" the `friction` of the vehicle times half its weight, or the load of a wheel.

    C = 1.4 is the centre of its prior and B = 8 1/rad a middle stiffness; for "rayleigh" k_s = 10 s/m times the load;
    no force for "ideal". A fit tries other starts too.
    **Raises:** `InputError` for a `kind` that is not one of `MODEL_KINDS`.
    """
    load = float(board.mass) * GRAVITY / 2
    if {wheelset.axle for wheelset in board.wheelsets} == {"front", "rear"} and kind in TYRE_LAWS:
        return FrontRear(*(_of_axle(kind, board, axle) for axle in ("front", "rear")))
    if kind == "pacejka":
        return Pacejka(B=8.0, C=1.4, D=board.friction * load, E=0.0)
    if kind == "rayleigh":
        return Rayleigh(k_s=10.0 * load)
    if kind == "ideal":
        return no_traction()
    raise InputError(f"There is no model `{kind}`", "option --model", instead_of(kind, MODEL_KINDS))


def _of_axle(kind: str, vehicle: AbstractVehicle, axle: str) -> AbstractTyre:
    """The initial tyre of the wheels on `axle`, from the load of one of them."""
    load = float(next(vehicle.load(wheelset) for wheelset in vehicle.wheelsets if wheelset.axle == axle))
    return Pacejka(8.0, 1.4, vehicle.friction * load, 0.0) if kind == "pacejka" else Rayleigh(10.0 * load)


def starting_model(case: Case, kind: str = "pacejka", constraint: str | None = None) -> Model:
    """The initial model of a fit of `case`: its board and constraint, `starting_tyre`, no effects.

    **Arguments:** `kind`: "pacejka", "rayleigh" or "ideal"; `constraint`: that of the case unless given.
    **Raises:** `InputError` for another `kind`; `ValueError` for a constraint that the board does not have.
    """
    structure = "ideal" if kind == "ideal" else (constraint or case.constraint)
    return Model(case.board, starting_tyre(kind, case.board), structure)


def default_free(model: Model) -> list[str]:
    """The parameters that a fit frees by default: those of the tyre and of every effect in the model."""
    names = [n for n in parameters(model) if n.startswith("effects.")]
    unknown = [f"board.{name}" for name in model.board.estimated if _acts(model, name)]
    if isinstance(model.tyre, FrontRear):
        shapes = [n for n in parameters(model) if n.startswith("tyre.") and n.rsplit(".", 1)[-1] in FITTED]
        return [*(shapes if model.constraint.slips else []), *unknown, *names]
    if isinstance(model.tyre, Pacejka) and model.constraint.slips:
        return ["tyre.B", "tyre.C", "tyre.D", "tyre.E", *unknown, *names]
    if isinstance(model.tyre, Rayleigh):
        return ["tyre.k_s", *unknown, *names]
    return [*unknown, *names]


def _acts(model: Model, constant: str) -> bool:
    """Whether a constant of the vehicle acts under the structure of `model`."""
    only = model.board.acts_under.get(constant)
    return only is None or model.structure == only


def select_parameters(model: Model, patterns: Sequence[str]) -> list[str]:
    """The parameters that match `patterns`: dotted names, their last parts (`B`), or wildcards (`effects.*`).

    **Raises:** `InputError` for a pattern that matches nothing.
    """
    known, selected = list(parameters(model)), []
    for pattern in patterns:
        fits = [n for n in known if fnmatch.fnmatchcase(n, pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern and n.startswith("tyre.")]
        fits = fits or [n for n in known if fnmatch.fnmatchcase(n.split(".", 1)[-1], pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern]
        if not fits:
            raise InputError(
                f"No parameter is called `{pattern}`",
                "option --free",
                instead_of(pattern, [short_name(name) for name in known]),
            )
        selected += [name for name in fits if name not in selected]
    return selected
