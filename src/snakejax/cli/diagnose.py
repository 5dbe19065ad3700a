"""`snakejax diagnose`: rank the effects that may be missing, without adding any."""

import argparse
from pathlib import Path
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .explain import add_candidates, candidates_of, wanted
from .options import add_cases, add_command, given
from .pipeline import Outcome, Stopwatch, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "diagnose",
        run,
        "rank the physical effects that may be missing",
        "Test every known effect against the base fit, without adding any, and refit the\n"
        "best few. Each is listed with significance, expected value and remaining error.",
        "snakejax diagnose data/tilted-floor",
    )
    add_cases(command)
    add_candidates(command)


def run(options: argparse.Namespace) -> int:
    """Diagnose each CASE."""
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Diagnose one case."""
    from snakejax.core.files import write_whole
    from snakejax.diagnosis.diagnosing import diagnose
    from snakejax.estimation.initial_model import starting_model
    from snakejax.estimation.joint_logs.fitting import with_estimated_logs
    from snakejax.present import plot
    from snakejax.present.as_json.explanation import diagnosis_json
    from snakejax.present.as_json.fit import joint_logs_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.explanation import diagnosis_text
    from snakejax.present.report import diagnosis_page
    from snakejax.recording.quality import noise_of

    clock = Stopwatch()
    noise = noise_of(case)
    case = with_estimated_logs(starting_model(case, options.model, options.skid), case, noise, say)
    base = diagnose(case, noise, candidates_of(options, case), **wanted(options), progress=say).base
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = {**diagnosis_json(case, noise, base, provenance, clock.seconds()), **joint_logs_json(case.runs)}

    def write(folder: Path) -> None:
        say(ProgressEvent(Phase.DRAWING))
        write_whole(folder / "diagnose.html", diagnosis_page(case, noise, base, result))
        plot.save(plot.ranking(base), folder, "ranking")
        plot.save(plot.confusability(base), folder, "confusability")

    return Outcome(result, diagnosis_text(case, base), write)
