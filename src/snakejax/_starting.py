"""What a fit starts from: the model, and the parameters that it frees."""

import fnmatch
from collections.abc import Sequence

from ._board import Board
from ._errors import InputError, instead_of
from ._model import Model, no_traction
from ._recording import Case
from ._tyre import AbstractTyre, Pacejka, Rayleigh
from ._units import parameters

MODELS = ("pacejka", "rayleigh", "ideal")


def starting_tyre(kind: str, board: Board) -> AbstractTyre:
    """A tyre to start from: a friction coefficient of 0.2 under the board's weight; none for the ideal board.

    **Raises:** `InputError` for a `kind` that is not one of `MODELS`.
    """
    load = float(board.mass) * 9.81 / 2
    if kind == "pacejka":
        return Pacejka(B=8.0, C=1.4, D=0.2 * load, E=0.0)
    if kind == "rayleigh":
        return Rayleigh(k_s=10.0 * load)
    if kind == "ideal":
        return no_traction()
    raise InputError(f"There is no model `{kind}`", "option --model", instead_of(kind, MODELS))


def starting_model(case: Case, kind: str = "pacejka", skid: str | None = None) -> Model:
    """The model a fit of `case` starts from: its board and structure, `starting_tyre`, no effects."""
    structure = "ideal" if kind == "ideal" else (skid or case.skid)
    return Model(case.board, starting_tyre(kind, case.board), structure)


def default_free(model: Model) -> list[str]:
    """The parameters a fit frees unasked: the tyre's own, and those of every effect in the model."""
    names = [n for n in parameters(model) if n.startswith("effects.")]
    if isinstance(model.tyre, Pacejka) and type(model.skid).__name__ != "Ideal":
        return ["tyre.B", "tyre.C", "tyre.D", "tyre.E", *names]
    if isinstance(model.tyre, Rayleigh):
        return ["tyre.k_s", *names]
    return names


def chosen(model: Model, patterns: Sequence[str]) -> list[str]:
    """The parameters that `patterns` name: dotted names, their last parts (`B`), or wildcards (`effects.*`).

    **Raises:** `InputError` for a pattern that fits nothing.
    """
    known, found = list(parameters(model)), []
    for pattern in patterns:
        fits = [n for n in known if fnmatch.fnmatchcase(n, pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern and n.startswith("tyre.")]
        fits = fits or [n for n in known if fnmatch.fnmatchcase(n.split(".", 1)[-1], pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern]
        if not fits:
            raise InputError(f"No parameter is called `{pattern}`", "option --free", instead_of(pattern, known))
        found += [name for name in fits if name not in found]
    return found
