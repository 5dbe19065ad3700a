"""`snakejax predict`: how far off saved models are 1, 2, 3 s after a lead-in."""

import argparse
from pathlib import Path
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .options import add_command, add_output, add_saved_models, finite, given, names
from .pipeline import Outcome, Stopwatch, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "predict",
        run,
        "show how far off saved models are after 1, 2, 3 s",
        "Start a prediction every 0.5 s of each recording. The state at its start is\n"
        "estimated from the lead-in, the time just before it. List for each group the\n"
        "median of the pose error, and the value that 90% of the predictions do not exceed.",
        "snakejax predict data/car --from explain.json --horizon 1,2,3 --lead 0.5",
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help="a folder with case.toml; it needs no train run")
    command.add_argument("--horizon", metavar="S,...", default="1,2,3", help="seconds ahead (default 1,2,3)")
    command.add_argument("--lead", metavar="S", default="0.5", help="seconds of a lead-in (default 0.5)")
    add_saved_models(command)
    command.add_argument("--seed", type=int, default=0, help=argparse.SUPPRESS)
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Predict in each CASE."""
    horizons = [finite(part, "option --horizon", f"`{part}`") for part in names(options.horizon) or []]
    lead = finite(options.lead, "option --lead", f"`{options.lead}`")
    return each_case(options, lambda case, say: work(options, case, (horizons, lead), say), to_train=False)


def work(options: argparse.Namespace, case: Any, times: tuple[list[float], float], say: Progress) -> Outcome:
    """Predict in one case."""
    from snakejax.present import plot
    from snakejax.present.as_json.prediction import prediction_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.prediction import prediction_report

    from ..predicting import predict

    clock = Stopwatch()
    horizons, lead = times
    prediction = predict(case, options.saved, horizons, lead, with_=options.with_, progress=say)
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = prediction_json(
        case.name, prediction.model, prediction.groups, (prediction.lead, prediction.horizons), provenance
    )
    result["seconds"] = clock.seconds()

    def write(folder: Path) -> None:
        say(ProgressEvent(Phase.DRAWING))
        plot.save(plot.prediction(prediction.groups, case.title), folder, "predict-errors")

    return Outcome(result, prediction_report(case.name, prediction.groups, prediction.lead), write)
