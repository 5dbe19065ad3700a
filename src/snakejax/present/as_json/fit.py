"""The results of `fit` and `compare` as JSON."""

from collections.abc import Mapping, Sequence

from snakejax.core.parameter import short_name
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.uncertainty import Estimate, RefittedInterval
from snakejax.recording.run import Case, Noise, Run

from .provenance import heading_json
from .values import (
    Json,
    all_parameters_json,
    clean,
    effects_json,
    estimate_json,
    misfit_json,
    parameters_json,
    rmse_json,
    runs_json,
)


def fit_json(
    case: Case,
    noise: Noise,
    fit: Fit,
    provenance: Json,
    intervals: Mapping[str, RefittedInterval] | None = None,
    seconds: Json | None = None,
) -> Json:
    """The result of `snakejax fit`."""
    return clean(
        {
            **heading_json(case.name, fit.model, noise, provenance),
            "base": base_json(fit, intervals),
            "runs": runs_json([*fit.runs, *fit.heldout]),
            "correlation": correlation_json(fit),
            "combinations": combinations_json(fit.combinations),
            "advice": list(fit.advice),
            **joint_logs_json(fit.recordings),
            "converged": fit.converged,
            "seconds": seconds,
        }
    )


def base_json(fit: Fit, intervals: Mapping[str, RefittedInterval] | None = None) -> Json:
    """A fit as the base of a result."""
    parts = all_parameters_json(fit.model, fit.estimates, intervals)
    return {
        "parameters": parameters_json(parts),
        "effects": effects_json(parts, fit.model),
        "misfit": misfit_json(fit.train_score, fit.heldout_score),
        "rmse": rmse_json(fit.train_score, fit.heldout_score),
        "converged": fit.converged,
    }


def correlation_json(fit: Fit) -> Json:
    """The correlation of the estimates: `names`, and `matrix` in that order."""
    return {"names": [short_name(name) for name in fit.fitted.loose], "matrix": fit.correlation}


def combinations_json(combinations: Mapping[str, Estimate]) -> Json:
    """The combinations of parameters that were estimated."""
    return {name: estimate_json(estimate) for name, estimate in combinations.items()}


def joint_logs_json(runs: Sequence[Run]) -> Json:
    """The clocks of the joint logs, where there are any."""
    logs = [{"run": run.name, **run.log._asdict()} for run in runs if run.log is not None]
    renamed = {"offset": "offset_s", "offset_sd": "offset_sd_s", "free": "estimated"}
    return {"joint_logs": [{renamed.get(k, k): v for k, v in log.items()} for log in logs]} if logs else {}
