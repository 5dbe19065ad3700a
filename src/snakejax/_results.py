"""The results of `fit` and `compare`, and what was found in their recordings, ready for JSON."""

from collections.abc import Mapping, Sequence

from ._compare import Comparison, Side
from ._estimates import Estimate
from ._fit import Fit
from ._json import (
    Json,
    all_parameters_json,
    clean,
    effects_json,
    estimate_json,
    misfit_json,
    parameters_json,
    rmse_json,
    runs_json,
    short,
)
from ._provenance import heading_json
from ._recording import CHANNELS, UNITS, Case, Noise, Run
from .quality import Inspection


def fit_json(
    case: Case,
    noise: Noise,
    found: Fit,
    provenance: Json,
    intervals: Mapping[str, tuple[float | None, float | None]] | None = None,
    seconds: Json | None = None,
) -> Json:
    """The result of `snakejax fit`."""
    return clean(
        {
            **heading_json(case.name, found.model, noise, provenance),
            "base": base_json(found, intervals),
            "runs": runs_json([*found.runs, *found.heldout]),
            "correlation": correlation_json(found),
            "combinations": combinations_json(found.combinations),
            "advice": list(found.advice),
            **joint_logs_json(found.study.runs),
            "converged": found.optimum.converged,
            "seconds": seconds,
        }
    )


def base_json(found: Fit, intervals: Mapping[str, tuple[float | None, float | None]] | None = None) -> Json:
    """A fit as the base of a result."""
    parts = all_parameters_json(found.model, found.estimates, intervals)
    return {
        "parameters": parameters_json(parts),
        "effects": effects_json(parts, found.model),
        "misfit": misfit_json(found.train_score, found.heldout_score),
        "rmse": rmse_json(found.train_score, found.heldout_score),
    }


def correlation_json(found: Fit) -> Json:
    """The correlation of the estimates: `names`, and `matrix` in that order."""
    return {"names": [short(name) for name in found.optimum.loose], "matrix": found.correlation}


def combinations_json(combinations: Mapping[str, Estimate]) -> Json:
    """The combinations of parameters that were estimated."""
    return {name: estimate_json(estimate) for name, estimate in combinations.items()}


def joint_logs_json(runs: Sequence[Run]) -> Json:
    """How the clocks of the joint logs go, where there are any."""
    logs = [{"run": run.name, **run.log._asdict()} for run in runs if run.log is not None]
    renamed = {"offset": "offset_s", "offset_sd": "offset_sd_s", "free": "estimated"}
    return {"joint_logs": [{renamed.get(k, k): v for k, v in log.items()} for log in logs]} if logs else {}


def quality_json(seen: Inspection) -> Json:
    """What was found in the recordings, what was done about it, and how many frames count as lost for it."""
    return {
        "as_recorded": seen.as_recorded,
        "findings": [
            {
                "kind": f.kind,
                "run": f.run,
                "from_s": f.start,
                "to_s": f.end,
                "size": f.size,
                "unit": f.unit,
                "what": f.what,
                "remedy": f.remedy,
                "action": f.action,
                "applied": f.applied,
                "severity": f.severity,
            }
            for f in seen.findings
        ],
        "masked": seen.masked,
    }


def comparison_json(failing: Comparison, sides: Sequence[Side] = ()) -> Json:
    """Where a model fails; `models`, where several were put side by side."""
    return {
        "white": failing.white,
        "whiteness": [
            {"run": t.run, "channel": t.channel, "statistic": t.statistic, "lags": t.lags, "p_value": t.p_value}
            for t in failing.whiteness
        ],
        "depends_on": [
            {"variable": s.variable, "channel": s.channel, "share": s.share, "p_value": s.p_family}
            for s in failing.depends_on
        ],
        "worst": [
            {
                "run": m.run,
                "time_s": m.time,
                "channel": m.channel,
                "residual_sd": m.deviations,
                "residual": m.size,
                "unit": UNITS[CHANNELS.index(m.channel)],
            }
            for m in failing.worst
        ],
        "stretches": [
            {"run": s.run, "channel": s.channel, "begin_s": s.begin, "end_s": s.end, "misfit": s.misfit}
            for s in failing.stretches
        ],
        "models": [
            {
                "model": side.model,
                "misfit": misfit_json(side.train, side.heldout),
                "rmse": rmse_json(side.train, side.heldout),
                "failure": side.failure,
            }
            for side in sides
        ],
    }
