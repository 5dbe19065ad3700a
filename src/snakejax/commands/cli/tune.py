"""`snakejax tune`: optimise a gait by its gradient."""

import argparse
from typing import Any

from snakejax.core.progress import Progress

from .gait_options import GaitRequest, add_gait, design_payload, gait_request, payload_json
from .gait_output import GaitOutput, gait_outcome
from .options import add_cases, add_command, add_fitting, add_loading, add_model, add_output, given, model_options
from .pipeline import Outcome, Stopwatch, each_case

OVER = ("fit", "mean", "worst")


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "tune",
        run,
        "optimise a gait by gradient",
        "Find the gait that is best for an objective within the limits of the joints, by\n"
        "the gradient of the simulation. The board starts at rest at --start at time 0.\n"
        "Without --set or --from the case is fitted first; if the fit does not determine\n"
        "all parameters, the gait is tuned over samples of them. --out writes the gait\n"
        "in the form of case.toml.",
        "snakejax tune data/level-board --objective reach:0.5,0.3,1 --seconds 20 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_fitting(command)
    add_loading(command)
    group = add_gait(
        command,
        "distance",
        "distance (default), turn, reach:X,Y,HEADING (the pose at the end [m, m, rad]), effort:DISTANCE (the least"
        " integral of squared joint torques for this distance [m]), or FILE.py:function (a cost"
        " of times, pose and effort, minimised)",
    )
    group.add_argument(
        "--over",
        choices=OVER,
        help="tune for the fitted model, or for the mean or the worst of samples of its parameters (default fit; mean"
        " where the fit does not determine a parameter)",
    )
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Tune each CASE."""
    request = gait_request(options)
    return each_case(options, lambda case, say: work(options, case, request, say), presets=True)


def work(options: argparse.Namespace, subject: Any, request: GaitRequest, say: Progress) -> Outcome:
    """Tune one case or preset."""
    if options.objective.partition(":")[0] in ("separate", "information"):
        from .design import work as design

        return design(options, subject, request, say)
    from snakejax.present.as_json.design import tuned_json
    from snakejax.present.as_json.provenance import heading_json, provenance_json
    from snakejax.present.as_text.design import report
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    from ..gaits import objective_of, tune_subject

    clock = Stopwatch()
    payload, with_payload = design_payload(request.payload, subject)
    tune_options: Any = {
        **model_options(options),
        **request._asdict(),
        "payload": payload,
        "over": options.over,
        "seed": options.seed,
        "progress": say,
    }
    tuned, boards, _ = tune_subject(subject, objective_of(options.objective), tune_options)
    sha256 = {} if isinstance(subject, Preset) else subject.sha256
    model = boards.models[0].with_payload(payload)
    result = {
        **heading_json(subject.name, model, None, provenance_json(options.seed, given(options), sha256)),
        **tuned_json(tuned, options.objective, boards.over),
        **payload_json(payload),
    }
    text = report(subject.name, options.objective, tuned, boards.over, with_payload)
    return gait_outcome(options, subject.name, GaitOutput(tuned, result, text, "tuned"), clock, say)
