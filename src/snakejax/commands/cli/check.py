"""`snakejax check`: the contents of a case, and its doubtful values."""

import argparse
from typing import Any

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .options import add_command, add_output
from .pipeline import Outcome, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "check",
        run,
        "list the contents of a case and its doubtful values",
        "Read a case as `fit` does; list its runs and every value that is doubtful.",
        "snakejax check data/level-board",
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help="a folder with case.toml")
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Check each CASE."""
    folders: dict[str, str] = {}

    def work(case: Any, say: Progress) -> Outcome:
        from rich.text import Text

        from snakejax.present.as_json.provenance import SCHEMA
        from snakejax.present.as_json.quality import quality_json
        from snakejax.present.as_text.check import check_text
        from snakejax.recording.case_check import check, run_summary
        from snakejax.recording.quality import inspect

        say(ProgressEvent(Phase.CHECKING))
        inspection = inspect(case)
        issues = check(case, folders[case.name], inspection)
        result = {
            "schema": SCHEMA,
            "case": case.name,
            "skid": case.constraint,
            "runs": [
                {
                    "run": summary.run,
                    "role": summary.role,
                    "duration_s": summary.duration,
                    "rate_hz": summary.rate,
                    "samples": summary.samples,
                    "lost": summary.lost,
                }
                for summary in map(run_summary, case.runs)
            ],
            "reading": {run: list(notes) for run, notes in case.reading.items()},
            "doubts": [{"run": d.run, "what": d.what, "severity": d.severity, "remedy": d.remedy} for d in issues],
            "quality": quality_json(inspection),
        }
        return Outcome(result, Text(check_text(case, issues)))

    from pathlib import Path

    folders.update({Path(path).resolve().name: path for path in options.cases})
    return each_case(options, work)
