"""Films of the moving board, which `--animate` asks for."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._progress import Say

if TYPE_CHECKING:
    from .._board import Board
    from .._played import Played


def add_films(command: Any) -> None:
    """The option."""
    command.add_argument(
        "--animate", metavar="gif|mp4", help="with --out: a film of each run too, measured and modelled"
    )


def require_films(options: argparse.Namespace) -> None:
    """**Raises:** `InputError` where the films asked for cannot be made, or have nowhere to go."""
    if options.animate is None:
        return
    if options.out is None:
        raise InputError("The films have nowhere to go", "option --animate", "add --out DIR")
    from ..plot import require_film

    require_film(options.animate, "option --animate")


def films(options: argparse.Namespace, model: "Played", board: "Board", folder: Path, say: Say) -> None:
    """A film of each run in `folder`, named for it."""
    from ..plot import animate

    if options.animate is None:
        return
    for scene in model.scenes:
        what = f"filming {scene.run}"
        file = folder / f"{scene.run}.{options.animate}"
        animate(model, board, file, scene.run, lambda done, total, what=what: say(what, done, total))
