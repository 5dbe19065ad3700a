"""Samples from the posterior of a fit, for ArviZ."""

from importlib import import_module
from typing import Any

import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.parameter import parameters
from snakejax.core.progress import Progress, no_progress
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.posterior import posterior_samples


def inference_data(fit: Fit, samples: int = 200, seed: int = 0, progress: Progress = no_progress) -> Any:
    """`samples` models from the posterior of `fit` as an `arviz.InferenceData`, one chain of each estimated parameter.

    The samples are those of `posterior_samples`; the attributes of each variable hold its unit.
    **Raises:** `InputError` where ArviZ is not installed.
    """
    try:
        arviz = import_module("arviz")
    except ImportError:
        remedy = 'pip install "snakejax[arviz]"'
        raise InputError("InferenceData needs ArviZ, which is not installed", "inference_data()", remedy) from None
    drawn = [parameters(model) for model in posterior_samples(fit, samples, seed, progress)]
    chains = {name: np.array([[float(model[name].value) for model in drawn]]) for name in fit.estimates}
    data = arviz.from_dict(posterior=chains, attrs={"model": fit.fitted.name, "seed": seed})
    for name, estimate in fit.estimates.items():
        data.posterior[name].attrs["units"] = estimate.unit
    return data
