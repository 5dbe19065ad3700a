"""A comparison of model and measurement as JSON."""

from collections.abc import Sequence

from snakejax.diagnosis.residuals.comparison import Comparison, ModelScore
from snakejax.dynamics.observation import CHANNELS, UNITS

from .values import Json, misfit_json, rmse_json


def comparison_json(comparison: Comparison, sides: Sequence[ModelScore] = ()) -> Json:
    """Where a model fails; `models`, the errors of several models on the same runs."""
    return {
        "white": comparison.white,
        "whiteness": [
            {"run": t.run, "channel": t.channel, "statistic": t.statistic, "lags": t.lags, "p_value": t.p_value}
            for t in comparison.whiteness
        ],
        "depends_on": [
            {"variable": s.variable, "channel": s.channel, "share": s.share, "p_value": s.p_family}
            for s in comparison.depends_on
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
            for m in comparison.worst
        ],
        "stretches": [
            {"run": s.run, "channel": s.channel, "begin_s": s.begin, "end_s": s.end, "misfit": s.misfit}
            for s in comparison.stretches
        ],
        "models": [
            {
                "model": side.model,
                "misfit": misfit_json(side.train, side.heldout),
                "rmse": rmse_json(side.train, side.heldout),
                "failure": side.failure,
                "converged": side.converged,
            }
            for side in sides
        ],
    }
