"""`snakejax diagnose`: which effect is missing, ranked, nothing added."""

import argparse
from pathlib import Path
from typing import Any

from ._options import add_cases, add_command, given
from ._progress import Say
from ._setup import Clock, Outcome, each_case
from .explain import add_candidates, library, wanted


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "diagnose",
        run,
        "rank the physical effects that may be missing",
        "Score every known effect beside the base fit, without adding any, and refit the\n"
        "best few: how sure each is, the value to expect, the misfit it would leave.",
        "snakejax diagnose data/tilted-floor",
    )
    add_cases(command)
    add_candidates(command)


def run(options: argparse.Namespace) -> int:
    """Diagnose each CASE."""
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Say) -> Outcome:
    """Diagnose one case."""
    from .. import plot
    from .._align import with_logs_told
    from .._diagnose import diagnose
    from .._files import write_whole
    from .._provenance import provenance_json
    from .._results import joint_logs_json
    from .._starting import starting_model
    from .._story import diagnosis_json, diagnosis_text
    from ..quality import noise_of
    from ..report import diagnosis_page

    clock = Clock()
    noise = noise_of(case)
    case = with_logs_told(starting_model(case, options.model, options.skid), case, noise, say)
    base = diagnose(case, noise, library(options), **wanted(options), progress=say).base
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = {**diagnosis_json(case, noise, base, provenance, clock.seconds()), **joint_logs_json(case.runs)}

    def write(folder: Path) -> None:
        say("drawing")
        write_whole(folder / "diagnose.html", diagnosis_page(case, noise, base, result))
        plot.save(plot.ranking(base), folder, "ranking")
        plot.save(plot.confusability(base), folder, "confusability")

    return Outcome(result, diagnosis_text(case, base), write)
