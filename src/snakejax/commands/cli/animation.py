"""Animations of the moving vehicle (`--animate`)."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError
from snakejax.core.progress import Progress

if TYPE_CHECKING:
    from snakejax.dynamics.vehicle import AbstractVehicle
    from snakejax.present.views import ModelView


def add_films(command: Any) -> None:
    """The option."""
    output = next(group for group in command._action_groups if group.title == "output")
    output.add_argument(
        "--animate", metavar="gif|mp4", help="with --out: also an animation of each run, measured and modelled"
    )


def require_films(options: argparse.Namespace) -> None:
    """**Raises:** `InputError` where `--animate` has no output folder, or its format cannot be written."""
    if options.animate is None:
        return
    if options.out is None:
        raise InputError("The animations have no output folder", "option --animate", "add --out DIR")
    from snakejax.present.plot import require_film

    require_film(options.animate, "option --animate")


def films(
    options: argparse.Namespace, model: "ModelView", vehicle: "AbstractVehicle", folder: Path, say: Progress
) -> None:
    """Write an animation of each run, COMMAND-RUN.gif or .mp4, into `folder`."""
    from snakejax.present.plot import animate

    if options.animate is None:
        return
    for replay in model.scenes:
        file = folder / f"{options.command}-{replay.run}.{options.animate}"
        animate(model, vehicle, file, replay.run, say)
