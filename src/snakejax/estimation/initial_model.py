"""Initial model of a fit, and the parameters that it frees."""

import fnmatch
from collections.abc import Sequence

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import parameters
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.kinds import MODEL_KINDS
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.tyres import AbstractTyre, Pacejka, Rayleigh
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.recording.run import Case


def starting_tyre(kind: str, board: AbstractVehicle) -> AbstractTyre:
    """The initial tyre: for "pacejka" a friction coefficient of 0.2 under half the weight of the board.

    C = 1.4 is the centre of its prior and B = 8 1/rad a middle stiffness; for "rayleigh" k_s = 10 s/m times the load;
    no force for "ideal". A fit tries other starts too.
    **Raises:** `InputError` for a `kind` that is not one of `MODEL_KINDS`.
    """
    load = float(board.mass) * GRAVITY / 2
    if kind == "pacejka":
        return Pacejka(B=8.0, C=1.4, D=0.2 * load, E=0.0)
    if kind == "rayleigh":
        return Rayleigh(k_s=10.0 * load)
    if kind == "ideal":
        return no_traction()
    raise InputError(f"There is no model `{kind}`", "option --model", instead_of(kind, MODEL_KINDS))


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
    if isinstance(model.tyre, Pacejka) and model.constraint.slips:
        return ["tyre.B", "tyre.C", "tyre.D", "tyre.E", *names]
    if isinstance(model.tyre, Rayleigh):
        return ["tyre.k_s", *names]
    return names


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
            raise InputError(f"No parameter is called `{pattern}`", "option --free", instead_of(pattern, known))
        selected += [name for name in fits if name not in selected]
    return selected
