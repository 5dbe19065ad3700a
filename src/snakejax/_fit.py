"""Fitting: from recorded runs to parameters, and what the runs cannot determine."""

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import numpy as np

from ._approach import approach, followed, least, require_sound, shot, unsound
from ._errors import FitError, InputError
from ._estimates import Estimate, advice, combined, estimated
from ._misfit import RunScore, Score, pooled, run_scores
from ._model import Model
from ._recording import Noise, Run
from ._starting import chosen, default_free
from ._study import Optimum, Study

SHARPENED = 2
"""So many times a fit is taken up with sharper simulations, where its derivatives are not theirs."""
LACKING = 50.0
"""Above this misfit of whole runs, or where it got stuck, the fit is tried once more from where windows lead it."""


class Fit(eqx.Module):
    """A fitted model and what is known about it.

    `estimates` by parameter name; `correlation` of those in `loose`; `combinations`: products of parameters that the
    runs determine where they do not determine the factors; `runs`, the train runs; `heldout`, judged with only their
    start poses estimated; `advice`, in words, what the data could not tell.
    """

    study: Study
    optimum: Optimum
    estimates: dict[str, Estimate]
    correlation: np.ndarray
    combinations: dict[str, Estimate]
    runs: tuple[RunScore, ...]
    heldout: tuple[RunScore, ...]
    heldout_optimum: Optimum | None
    advice: tuple[str, ...]

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.study.fitted(self.optimum)

    @property
    def train_score(self) -> Score:
        """All train runs together."""
        return pooled(self.runs)

    @property
    def heldout_score(self) -> Score | None:
        """All held-out runs together, or None where there are none."""
        return pooled(self.heldout) if self.heldout else None


def fit(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """Fit the `free` parameters of `model`, and where each run starts, to the train runs; judge the held-out ones.

    Minimises sum_k ((measured - modelled) / sd)^2 over all present samples of x, y and heading, by optimistix
    Levenberg-Marquardt, from several starts over the first seconds to whole runs.

    **Arguments:** `free`: names or wildcards as in `chosen`; `threshold`: that of Huber's loss in standard deviations.
    **Raises:** `InputError` for names that do not exist or no train run; `FitError` where the fit cannot succeed.
    """
    names = default_free(model) if free is None else chosen(model, free)
    study = Study.of(model, runs, noise, names, max(len(names), 1))
    return fit_study(study, names, threshold=threshold, progress=progress)


def fit_study(
    study: Study,
    free: Sequence[str],
    values: Mapping[str, float] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """`fit` for a study at hand, from `values` (default: the model's own)."""
    train = study.numbered("train")
    if not train:
        raise InputError("There is no train run to fit", "runs", 'give at least one run role = "train"')
    best = approach(study, study.values() if values is None else values, free, train, progress)
    progress("fitting whole runs")
    optimum = study.fit(best.values, free, train, best.start, threshold=threshold)
    if free and not (optimum.misfit < LACKING and optimum.converged):
        optimum = least(optimum, shot(study, free, train, threshold, progress))
    if optimum.misfit < LACKING:
        optimum = followed(study, optimum, train, threshold)
    for sharpened in range(SHARPENED + 1):
        wild = unsound(study, require_sound(study, optimum, train), train) if optimum.misfit < LACKING else None
        if wild is None:
            break
        if sharpened == SHARPENED:
            value = optimum.values[wild]
            raise FitError(f"At {wild} = {value:.3g} the runs are too stiff for sound derivatives: leave it fixed.")
        progress("fitting whole runs more accurately")
        study = study.sharper()
        optimum = study.fit(optimum.values, free, train, optimum.start, threshold=threshold)
    return described(study, require_sound(study, optimum, train))


def judged(study: Study, values: Mapping[str, float], role: str = "heldout") -> Optimum | None:
    """The runs of `role` under fixed `values`, only their starts estimated; None where there are none."""
    runs = study.numbered(role)
    return study.fit(values, (), runs) if runs else None


def described(study: Study, optimum: Optimum) -> Fit:
    """The statistics of `optimum`, and the held-out runs judged by it."""
    estimates = estimated(study, optimum)
    heldout = judged(study, optimum.values)
    covariance = optimum.covariance
    sd = np.sqrt(np.diag(covariance)) if covariance.size else np.zeros(0)
    correlation = covariance / np.outer(sd, sd) if covariance.size else covariance
    combinations = combined(study, optimum, estimates)
    return Fit(
        study,
        optimum,
        estimates,
        correlation,
        combinations,
        run_scores(study, optimum, study.numbered("train")),
        () if heldout is None else run_scores(study, heldout, study.numbered("heldout")),
        heldout,
        tuple(advice(optimum, estimates, combinations)),
    )
