"""`snakejax fit`: fit parameters to the train runs and validate them on the held-out runs."""

import argparse
from pathlib import Path
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .animation import add_films, require_films
from .fit_pipeline import bootstrapped, fitted, profiled, report_fit, require_refits
from .options import add_cases, add_command, add_fitting, add_model, add_output, given, threshold
from .pipeline import Outcome, Stopwatch, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "fit",
        run,
        "fit parameters to the train runs of a case",
        "Fit parameters to the train runs of a case; validate them on its held-out runs.",
        "snakejax fit data/level-board --out out",
    )
    add_cases(command)
    add_model(command)
    group = add_fitting(command)
    group.add_argument("--profile", metavar="C,E", help="95%% intervals of these parameters by profile likelihood")
    group.add_argument(
        "--bootstrap",
        metavar="N",
        type=int,
        help="95%% intervals of the other parameters from N refits, such as 200: to the model with its errors, whose"
        " signs are drawn block by block",
    )
    add_output(command)
    add_films(command)


def run(options: argparse.Namespace) -> int:
    """Fit each CASE."""
    threshold(options.robust)
    require_refits(options.bootstrap)
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Fit one case."""
    from snakejax.estimation.profile_likelihood import profile
    from snakejax.estimation.uncertainty import RefittedInterval
    from snakejax.present.as_json.fit import fit_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.fit import fit_report

    clock = Stopwatch()
    fit, noise = fitted(options, case, say)
    fit, intervals = bootstrapped(options, fit, say)
    for name in profiled(options, fit):
        say(ProgressEvent(Phase.PROFILE, f"profile of {name}"))
        intervals[name] = RefittedInterval(*profile(fit, name), "profile")
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = fit_json(case, noise, fit, provenance, intervals, clock.seconds())

    def write(folder: Path) -> None:
        report_fit(options, case, noise, fit, result, folder, say)

    return Outcome(result, fit_report(case, noise, fit, intervals), write)
