"""The fit that several commands start with, and its report."""

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent

from .animation import films
from .options import model_options, names

if TYPE_CHECKING:
    from snakejax.estimation.fit_record import Fit
    from snakejax.estimation.uncertainty import RefittedInterval
    from snakejax.recording.run import Case, Noise


def fitted(options: argparse.Namespace, case: "Case", say: Progress) -> "tuple[Fit, Noise]":
    """The fit of `case` with the model of the options, and the noise that scales its residuals."""
    from ..fitting import fit_case

    return fit_case(case, {**model_options(options), "progress": say})


def profiled(options: argparse.Namespace, fit: "Fit") -> list[str]:
    """The parameters of `--profile`. **Raises:** `InputError` for one that was not estimated."""
    from snakejax.estimation.initial_model import select_parameters

    patterns = names(options.profile) or []
    loose = fit.fitted.loose
    try:
        selected = select_parameters(fit.model, patterns)
    except InputError as error:
        raise InputError(error.what, "option --profile", error.remedy) from None
    for name in selected:
        if name not in fit.estimates:
            listed = ", ".join(loose) or "none"
            raise InputError(f"`{name}` is fixed and has no profile", "option --profile", f"name one of {listed}")
    return [name for name in selected if name in loose]


FEWEST_REFITS = 40
"""With fewer refits an end of the 95% interval is an extreme of them."""


def require_refits(count: int | None) -> None:
    """Check the number of `--bootstrap`. **Raises:** `InputError` for too few."""
    if count is not None and count < FEWEST_REFITS:
        what = f"{count} refits are too few for the ends of a 95% interval"
        raise InputError(what, "option --bootstrap", f"give at least {FEWEST_REFITS}, such as 200")


def bootstrapped(options: argparse.Namespace, fit: "Fit", say: Progress) -> "tuple[Fit, dict[str, RefittedInterval]]":
    """The intervals of `--bootstrap`, none without it, and `fit`, which says how many refits did not converge.

    **Raises:** `InputError` if no parameter is estimated.
    """
    from snakejax.estimation.uncertainty import RefittedInterval
    from snakejax.estimation.wild_bootstrap import bootstrap

    count = options.bootstrap
    if count is None:
        return fit, {}
    if not fit.fitted.loose:
        raise InputError("No parameter is estimated", "option --bootstrap", "leave it out, or name some with --free")
    refitted = bootstrap(fit, count, options.seed, say)
    if refitted.failed:
        lacking = f"{refitted.failed} of {count} refits did not converge; the intervals are those of the others."
        fit = dataclasses.replace(fit, advice=(*fit.advice, lacking))
    ends = refitted.intervals()
    return fit, {name: RefittedInterval(*ends[name], "bootstrap") for name in fit.fitted.loose}


def report_fit(
    options: argparse.Namespace,
    case: "Case",
    noise: "Noise",
    fit: "Fit",
    result: dict[str, Any],
    folder: Path,
    say: Progress,
) -> None:
    """Write the report, the figures and the animations of a fit into `folder`."""
    from snakejax.core.files import write_whole
    from snakejax.present import plot
    from snakejax.present.report import fit_page
    from snakejax.present.views import view_of_fit

    say(ProgressEvent(Phase.DRAWING))
    model = view_of_fit(fit)
    write_whole(folder / f"{options.command}.html", fit_page(case, noise, fit, result, model))
    figures = {"paths": plot.paths([model]), "residuals": plot.residuals(model), "tyre": plot.tyre([model])}
    for name, figure in figures.items():
        plot.save(figure, folder, f"{options.command}-{name}")
    films(options, model, fit.model.board, folder, say)
