"""`snakejax fit`: parameters from the train runs, judged on the held-out ones."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._films import add_films, films, require_films
from ._options import add_cases, add_command, add_fitting, add_model, given, names, threshold
from ._progress import Say
from ._setup import Clock, Outcome, each_case

if TYPE_CHECKING:
    from .._fit import Fit
    from .._recording import Case, Noise


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "fit",
        run,
        "fit parameters to the train runs of a case",
        "Fit parameters to the train runs of a case and judge them on its held-out runs.",
        "snakejax fit data/level-board --out out",
    )
    add_cases(command)
    add_model(command)
    add_fitting(command)
    add_films(command)
    command.add_argument(
        "--profile", metavar="C,E", help="95%% intervals of these by profile, where a standard error misleads"
    )


def run(options: argparse.Namespace) -> int:
    """Fit each CASE."""
    threshold(options.robust)
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say))


def work(options: argparse.Namespace, case: Any, say: Say) -> Outcome:
    """Fit one case."""
    from .._profile import profile
    from .._provenance import provenance_json
    from .._results import fit_json
    from .._text import fit_report

    clock = Clock()
    found, noise = fitted(options, case, say)
    intervals = {}
    for name in profiled(options, found):
        say(f"profile of {name}")
        intervals[name] = profile(found, name)
    provenance = provenance_json(options.seed, given(options), case.sha256)
    result = fit_json(case, noise, found, provenance, intervals, clock.seconds())

    def write(folder: Path) -> None:
        report_fit(options, case, noise, found, result, folder, say)

    return Outcome(result, fit_report(case, noise, found, intervals), write)


def fitted(options: argparse.Namespace, case: "Case", say: Say) -> "tuple[Fit, Noise]":
    """The fit of `case` that the options ask for, and the noise it counts in."""
    from .._align import fit_logged
    from ..quality import noise_of
    from ._models import wanted_model

    wanted = wanted_model(options, case)
    noise = noise_of(case)
    free = wanted.freed(names(getattr(options, "free", None)))
    limit = threshold(getattr(options, "robust", None))
    return fit_logged(wanted.model, case.runs, noise, free, threshold=limit, progress=say), noise


def profiled(options: argparse.Namespace, found: "Fit") -> list[str]:
    """The parameters whose profile is wanted. **Raises:** `InputError` for one that was not estimated."""
    from .._starting import chosen

    patterns = names(options.profile) or []
    loose = found.optimum.loose
    try:
        wanted = chosen(found.model, patterns)
    except InputError as error:
        raise InputError(error.what, "option --profile", error.remedy) from None
    for name in wanted:
        if name not in found.optimum.free:
            listed = ", ".join(loose) or "none"
            raise InputError(f"`{name}` is held, so it has no profile", "option --profile", f"name one of {listed}")
    return [name for name in wanted if name in loose]


def report_fit(
    options: argparse.Namespace,
    case: "Case",
    noise: "Noise",
    found: "Fit",
    result: dict[str, Any],
    folder: Path,
    say: Say,
) -> None:
    """Write the report, the figures and the films of a fit into `folder`."""
    from .. import plot
    from .._files import write_whole
    from .._played import played_fit
    from ..report import fit_page

    say("drawing")
    model = played_fit(found)
    write_whole(folder / f"{options.command}.html", fit_page(case, noise, found, result, model))
    plot.save(plot.paths([model]), folder, "paths")
    plot.save(plot.residuals(model), folder, "residuals")
    plot.save(plot.tyre([model]), folder, "tyre")
    films(options, model, found.study.model.board, folder, say)
