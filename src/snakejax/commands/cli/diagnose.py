"""`snakejax diagnose`: rank the effects that may be missing, without adding any."""

import argparse
from pathlib import Path
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.core.tabular import counted

from .options import add_command, add_output, add_question, effect_spec, given, model_options, threshold
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
    add_question(command)
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Diagnose each CASE."""
    threshold(options.robust)
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Diagnose one case."""
    from snakejax.core.files import write_whole
    from snakejax.present import plot
    from snakejax.present.as_json.explanation import diagnosis_json
    from snakejax.present.as_json.fit import joint_logs_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.explanation import diagnosis_text
    from snakejax.present.report import diagnosis_page

    from ..diagnosing import diagnose_case

    clock = Stopwatch()
    diagnosis = diagnose_case(case, explain_options(options, say))
    case, noise, base = diagnosis.case, diagnosis.noise, diagnosis.base
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = {**diagnosis_json(case, noise, base, provenance, clock.seconds()), **joint_logs_json(case.runs)}

    def write(folder: Path) -> None:
        say(ProgressEvent(Phase.DRAWING))
        write_whole(folder / "diagnose.html", diagnosis_page(case, noise, base, result))
        plot.save(plot.ranking(base), folder, "diagnose-ranking")
        plot.save(plot.confusability(base), folder, "diagnose-confusability")

    return Outcome(result, with_first_look(options, case, diagnosis_text(case, base)), write)


def with_first_look(options: argparse.Namespace, case: Any, text: Any) -> Any:
    """`text`, with a first line on how many windows it rests, where these are a tenth."""
    if not options.quick:
        return text
    from rich.console import Group

    windows = counted(len(case.runs), "window")
    return Group(f"A first look at {windows}: a tenth of each recording, at least one. Without --quick: all.", text)


def explain_options(options: argparse.Namespace, say: Progress) -> Any:
    """What the options ask of `diagnose` and `explain`, as `snakejax.commands` takes it.

    `--with` may name an own effect by the name of the class that `--effect` gives.
    """
    own = {effect_spec(text).name: text for text in options.effect or ()}
    with_ = [own.get(text, text) for text in options.with_ or ()]
    effect_options = {"with_": with_, "effect": options.effect, "without": options.without, "progress": say}
    return {**model_options(options), **effect_options, "quick": options.quick}
