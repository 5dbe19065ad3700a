"""`snakejax compare`: where, when and with what a fitted model fails."""

import argparse
from pathlib import Path
from typing import Any

from .._errors import InputError, instead_of
from ._films import add_films, require_films
from ._options import MODELS, add_cases, add_command, add_fitting, add_model, given, names, threshold
from ._progress import Say
from ._setup import Clock, Outcome, each_case
from .fit import fitted, report_fit


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "compare",
        run,
        "say where a fitted model fails",
        "Fit a case, then say where, when and with what the model fails.",
        "snakejax compare data/tilted-floor --out out",
    )
    add_cases(command)
    add_model(command)
    add_fitting(command)
    add_films(command)
    command.add_argument(
        "--against", metavar="MODEL,...", help=f"fit these models too and put them side by side: {', '.join(MODELS)}"
    )


def run(options: argparse.Namespace) -> int:
    """Compare each CASE with its model."""
    threshold(options.robust)
    require_films(options)
    for kind in names(options.against) or ():
        if kind not in MODELS:
            raise InputError(f"There is no model `{kind}`", "option --against", instead_of(kind, MODELS))
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Say) -> Outcome:
    """Compare one case with its model."""
    from rich.console import Group

    from .._compare import compare, side_by_side
    from .._json import clean
    from .._provenance import provenance_json
    from .._results import comparison_json, fit_json
    from .._text import compare_report, fit_report

    clock = Clock()
    found, noise = fitted(options, case, say)
    say("comparing")
    failing = compare(found)
    kinds = names(options.against) or []
    if kinds:
        say(f"fitting {', '.join(kinds)}")
    sides = side_by_side(case, kinds, noise) if kinds else ()
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = fit_json(case, noise, found, provenance)
    result["comparison"] = clean(comparison_json(failing, sides))
    result["seconds"] = clock.seconds()

    def write(folder: Path) -> None:
        report_fit(options, case, noise, found, result, folder, say)

    return Outcome(result, Group(fit_report(case, noise, found), compare_report(failing, sides)), write)
