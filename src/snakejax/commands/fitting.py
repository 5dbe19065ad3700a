"""`fit` and `compare`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.diagnosis.residuals.comparison import Comparison
from snakejax.diagnosis.residuals.comparison import compare as compared
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.joint_logs.fitting import fit_logged
from snakejax.recording.quality import noise_of
from snakejax.recording.run import Case, Noise

from .case_argument import sound_case, takes
from .conditions import differing
from .option_texts import names, threshold
from .requested_model import ModelOptions, requested_model


class FitOptions(ModelOptions, total=False):
    """The options of `fit` and `compare`: those of the model, and those of the estimation.

    `free`: parameters to estimate, "B,C" or a list (default: all of the tyre and of the effects without a value);
    `by`: "floor", "day", "session" or "group": each of them has a value of its own for each label of that kind;
    `robust`: Huber's loss: residuals above so many standard deviations count linearly (True: 3); `as_recorded`: use the
    recordings unchanged; `progress` is called with each `ProgressEvent`.
    """

    free: str | Sequence[str] | None
    by: str | None
    robust: float | str | bool | None
    as_recorded: bool
    progress: Progress


@takes(FitOptions, as_recorded=False, progress=no_progress)
def fit(case: Case | Path | str, **options: Unpack[FitOptions]) -> Fit:
    """Fit parameters to the train runs of `case` and validate them on its held-out runs, as `snakejax fit` does.

    The recordings are inspected first; each finding is a warning. See `snakejax.estimation.fit` for the method.

    **Arguments:** `case`: a `Case` or the folder of one; `options`: see `FitOptions`.
    **Raises:** `InputError` for a case or an option that cannot be used; `FitError` if the fit fails.
    """
    return fit_case(sound_case(case, options.get("as_recorded", False)), options)[0]


def fit_case(case: Case, options: FitOptions) -> tuple[Fit, Noise]:
    """The fit of an inspected `case`, and the noise that scales its residuals. **Raises:** as `fit`."""
    requested = requested_model(case, options)
    noise = noise_of(case)
    free = requested.freed(names(options.get("free")))
    model = requested.model
    if key := options.get("by"):
        model, free = differing(model, case, key, free)
    limit = threshold(options.get("robust"))
    progress = options.get("progress", no_progress)
    return fit_logged(model, case.runs, noise, free, threshold=limit, progress=progress), noise


@takes(FitOptions, as_recorded=False, progress=no_progress)
def compare(case: Case | Path | str | Fit, **options: Unpack[FitOptions]) -> Comparison:
    """Show where and when a fitted model fails, and on what its error depends, as `snakejax compare` does.

    **Arguments:** `case`: a `Case`, the folder of one, or a `Fit` that is there already; `options`: see `FitOptions`.
    **Raises:** as `fit`.
    """
    fitted = case if isinstance(case, Fit) else fit(case, **options)
    options.get("progress", no_progress)(ProgressEvent(Phase.COMPARISON))
    return compared(fitted)
