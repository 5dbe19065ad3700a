"""`snakejax explain`: fit, compare, diagnose, add an effect and fit again, until the rest is noise."""

import argparse
import contextlib
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.core.tabular import counted

from .animation import add_films, films, require_films
from .diagnose import explain_options, with_first_look
from .exit_status import DONE
from .options import add_command, add_output, add_question, given, threshold
from .pipeline import Outcome, Stopwatch, each_case

KEPT = "unfinished"
"""The folder, in that of `--out`, of the fits that a command has finished before it ends."""


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "explain",
        run,
        "find out which physical effect is missing",
        "Fit, examine the residual, add the effect that explains it, and fit again, until\n"
        "only noise is left or no known effect helps. With --out, finished fits are kept: run\n"
        "an interrupted command again, and it continues with them.",
        "snakejax explain data/tilted-floor --json -",
    )
    add_question(command)
    command.add_argument("--plan", action="store_true", help="print what would be tried, and fit nothing")
    add_output(command)
    add_films(command)


def run(options: argparse.Namespace) -> int:
    """Explain each CASE."""
    threshold(options.robust)
    require_films(options)
    status = each_case(options, lambda case, say: work(options, case, say), drop_programs=True)
    if status == DONE and options.out is not None and not options.plan:
        shutil.rmtree(Path(options.out) / KEPT, ignore_errors=True)
    return status


@contextlib.contextmanager
def kept_fits(options: argparse.Namespace, case: Any, question: Mapping[str, Any]) -> Iterator[None]:
    """Keep the finished fits of a case in a folder in that of `--out`, and say how many are there already.

    The folder is named by the case and by the `question` about it.
    """
    if options.out is None:
        yield
        return
    from snakejax.estimation.fit_journal import keep_fits
    from snakejax.simulation.chunks import fingerprint

    lines = [f"{name} {value}" for name, value in question.items() if name != "progress"]
    folder = Path(options.out) / KEPT / fingerprint(case, lines)[:16]
    with keep_fits(folder) as journal:
        if journal.earlier and not options.quiet:
            print(f"Going on: {counted(journal.earlier, 'fit')} of an earlier run are used.", file=sys.stderr)
        yield


def plan(options: argparse.Namespace, case: Any) -> Outcome:
    """What would be tried on one case."""
    from snakejax.present.as_text.plan import plan_text

    from ..diagnosing import plan_case

    made = plan_case(case, explain_options(options, no_progress))
    return Outcome(made._asdict(), plan_text(made), name="plan")


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Explain one case."""
    if options.plan:
        return plan(options, case)
    from snakejax.core.files import write_whole
    from snakejax.diagnosis.latent_force.template import effect_template
    from snakejax.diagnosis.law.source import law_source
    from snakejax.present import plot
    from snakejax.present.as_json.explanation import candidates_csv, explanation_json
    from snakejax.present.as_json.fit import joint_logs_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.explanation import explanation_text
    from snakejax.present.report import explanation_page
    from snakejax.present.views import views_of_steps

    from ..diagnosing import explain_case

    clock = Stopwatch()
    question = explain_options(options, say)
    with kept_fits(options, case, question):
        explanation = explain_case(case, question)
    provenance = provenance_json(options.seed, given(options), case.sha256)

    result = {**explanation_json(explanation, provenance, clock.seconds()), **joint_logs_json(explanation.case.runs)}

    def write(folder: Path) -> None:
        say(ProgressEvent(Phase.DRAWING))
        models = list(views_of_steps(explanation))
        write_whole(folder / "explain.html", explanation_page(explanation, result, models))
        plot.save(plot.fall(explanation, models), folder, "explain-fall")
        plot.save(plot.waterfall(explanation), folder, "explain-waterfall")
        ends = models if len(models) < 3 else [models[0], models[-1]]
        plot.save(plot.paths(ends), folder, "explain-paths")
        plot.save(plot.residuals(models[-1]), folder, "explain-residuals")
        plot.save(plot.tyre(ends), folder, "explain-tyre")
        plot.save(plot.ranking(explanation.base), folder, "explain-ranking")
        plot.save(plot.confusability(explanation.base), folder, "explain-confusability")
        if explanation.candidates:
            write_whole(folder / "candidates.csv", candidates_csv(explanation))
        films(options, models[-1], case.board, folder, say)
        beside = [effect for effect in explanation.final.effects if effect not in explanation.named_laws]
        for k, law in enumerate(explanation.named_laws.values()):
            name = f"missing_force_{k + 1}.py" if k else "missing_force.py"
            write_whole(folder / name, law_source(law, beside))
        if explanation.missing is None:
            return
        plot.save(plot.missing(explanation), folder, "explain-missing")
        if explanation.missing.shape is not None and not explanation.named_laws:
            write_whole(folder / "missing_force.py", effect_template(explanation.missing))

    return Outcome(result, with_first_look(options, explanation.case, explanation_text(explanation)), write)
