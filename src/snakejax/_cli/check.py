"""`snakejax check`: what a case holds and what in it is doubtful."""

import argparse
from typing import Any

from ._options import add_command
from ._progress import Say
from ._setup import Outcome, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "check",
        run,
        "say what a case holds and what in it is doubtful",
        "Read a case as a fit would, and say what it holds and what in it is doubtful.",
        "snakejax check data/level-board",
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help="a folder with case.toml")
    command.add_argument(
        "--json", metavar="FILE", help="write the findings there; - for standard output, a folder for several CASEs"
    )
    command.add_argument("--quiet", action="store_true", help="print nothing but complaints and --json -")
    command.set_defaults(out=None)


def run(options: argparse.Namespace) -> int:
    """Check each CASE."""
    folders: dict[str, str] = {}

    def work(case: Any, say: Say) -> Outcome:
        from rich.text import Text

        from .._check import check, check_text, holding
        from .._provenance import SCHEMA
        from .._results import quality_json
        from ..quality import inspected

        say("checking")
        seen = inspected(case)
        doubts = check(case, folders[case.name], seen)
        found = {
            "schema": SCHEMA,
            "case": case.name,
            "skid": case.skid,
            "runs": [
                {
                    "run": h.run,
                    "role": h.role,
                    "duration_s": h.duration,
                    "rate_hz": h.rate,
                    "samples": h.samples,
                    "lost": h.lost,
                }
                for h in map(holding, case.runs)
            ],
            "doubts": [{"run": d.run, "what": d.what, "severity": d.severity, "remedy": d.remedy} for d in doubts],
            "quality": quality_json(seen),
        }
        return Outcome(found, Text(check_text(case, doubts)))

    from pathlib import Path

    folders.update({Path(path).resolve().name: path for path in options.cases})
    return each_case(options, work)
