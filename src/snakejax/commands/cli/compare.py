"""`snakejax compare`: where a fitted model fails, when, and on which variables its error depends."""

import argparse
from pathlib import Path
from typing import Any

from snakejax.core.errors import InputError, instead_of
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.kinds import MODEL_KINDS

from .animation import add_films, require_films
from .fit_pipeline import fitted, report_fit
from .options import add_cases, add_command, add_fitting, add_model, add_output, given, names, threshold
from .pipeline import Outcome, Stopwatch, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "compare",
        run,
        "show where a fitted model fails",
        "Fit a case, then show where and when the model fails, and on which variables its\nerror depends.",
        "snakejax compare data/tilted-floor --out out",
    )
    add_cases(command)
    add_model(command)
    add_fitting(command)
    command.add_argument(
        "--against",
        metavar="MODEL,...",
        help="fit these models too, without effects, with the same --skid and --robust, and list their errors:"
        f" {', '.join(MODEL_KINDS)}",
    )
    add_output(command)
    add_films(command)


def run(options: argparse.Namespace) -> int:
    """Compare each CASE with its model."""
    threshold(options.robust)
    require_films(options)
    for kind in names(options.against) or ():
        if kind not in MODEL_KINDS:
            raise InputError(f"There is no model `{kind}`", "option --against", instead_of(kind, MODEL_KINDS))
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Compare one case with its model."""
    from rich.console import Group

    from snakejax.diagnosis.residuals.comparison import compare, compare_models
    from snakejax.present.as_json.comparison import comparison_json
    from snakejax.present.as_json.fit import fit_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_json.values import clean
    from snakejax.present.as_text.comparison import compare_report
    from snakejax.present.as_text.fit import fit_report

    clock = Stopwatch()
    fit, noise = fitted(options, case, say)
    say(ProgressEvent(Phase.COMPARISON))
    comparison = compare(fit)
    kinds = names(options.against) or []
    if kinds:
        say(ProgressEvent(Phase.OTHER_MODELS, f"fitting {', '.join(kinds)}"))
    loss = threshold(options.robust)
    sides = compare_models(case, kinds, noise, structure=options.skid, threshold=loss) if kinds else ()
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = fit_json(case, noise, fit, provenance)
    result["comparison"] = clean(comparison_json(comparison, sides))
    result["seconds"] = clock.seconds()

    def write(folder: Path) -> None:
        report_fit(options, case, noise, fit, result, folder, say)

    return Outcome(result, Group(fit_report(case, noise, fit), compare_report(comparison, sides)), write)
