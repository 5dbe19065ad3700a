"""JSON, text and files of a gait, as `tune` and the design of the next run deliver them."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .pipeline import Outcome, Stopwatch

if TYPE_CHECKING:
    from rich.console import RenderableType

    from snakejax.design.tuning import TuningResult


class GaitOutput(NamedTuple):
    """What is delivered of a gait: its `json` with the heading, its `text`, and which `figure` shows the JSON."""

    tuned: "TuningResult"
    json: dict[str, Any]
    text: "RenderableType"
    figure: Literal["tuned", "designed"]


def gait_outcome(
    options: argparse.Namespace, name: str, output: GaitOutput, clock: Stopwatch, say: Progress
) -> Outcome:
    """JSON, text and files of a gait for the case `name`."""
    from snakejax.core.files import write_whole
    from snakejax.present.as_json.design import toml
    from snakejax.present.as_json.values import clean

    result = {**output.json, "seconds": clock.seconds()}

    def write(folder: Path) -> None:
        from snakejax.present import plot
        from snakejax.present.report import tune_page

        draw = plot.tuned if output.figure == "tuned" else plot.designed
        say(ProgressEvent(Phase.DRAWING))
        write_whole(folder / f"{options.command}-gait.toml", toml(output.tuned, name, options.objective))
        write_whole(folder / f"{options.command}.html", tune_page(clean(result)))
        plot.save(draw(result), folder, options.command)

    return Outcome(clean(result), output.text, write)
