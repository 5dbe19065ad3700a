"""The fit that several commands start with, and its report."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent

from .animation import films
from .options import names, threshold

if TYPE_CHECKING:
    from snakejax.estimation.fit_record import Fit
    from snakejax.recording.run import Case, Noise


def fitted(options: argparse.Namespace, case: "Case", say: Progress) -> "tuple[Fit, Noise]":
    """The fit of `case` with the model of the options, and the noise that scales its residuals."""
    from snakejax.estimation.joint_logs.fitting import fit_logged
    from snakejax.recording.quality import noise_of

    from .model_options import requested_model

    requested = requested_model(options, case)
    noise = noise_of(case)
    free = requested.freed(names(getattr(options, "free", None)))
    limit = threshold(getattr(options, "robust", None))
    return fit_logged(requested.model, case.runs, noise, free, threshold=limit, progress=say), noise


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
    plot.save(plot.paths([model]), folder, "paths")
    plot.save(plot.residuals(model), folder, "residuals")
    plot.save(plot.tyre([model]), folder, "tyre")
    films(options, model, fit.model.board, folder, say)
