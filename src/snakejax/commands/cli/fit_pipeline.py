"""The fit that several commands start with, and its report."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent

from .animation import films
from .options import model_options, names

if TYPE_CHECKING:
    from snakejax.estimation.fit_record import Fit
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
