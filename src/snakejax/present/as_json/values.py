"""Results as plain dictionaries for JSON: the parts that all commands share.

Each part has its function (`parameters_json`, `score_json`, ...), so that all commands use the same keys; `clean`
replaces numbers that are not finite by null.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from snakejax.core.parameter import parameters, short_name
from snakejax.dynamics.conditions import ByCondition
from snakejax.dynamics.law import Law
from snakejax.dynamics.model import Model
from snakejax.estimation.goodness_of_fit import RunScore, Score
from snakejax.estimation.uncertainty import Estimate, RefittedInterval

Json = dict[str, Any]
EXPRESSION = "expression"
"""The key of the formula of a law, beside its parameters."""
LABEL = "label"
"""The key of the label of the runs in which a parameter of an effect by condition acts."""


def clean(value: Any) -> Any:
    """`value` with arrays and tuples as lists, and None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): clean(part) for key, part in value.items()}
    if isinstance(value, np.ndarray) or hasattr(value, "__array__"):
        return clean(np.asarray(value).tolist())
    if isinstance(value, list | tuple):
        return [clean(part) for part in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def as_text(result: Any) -> str:
    """`result` as JSON text."""
    return json.dumps(clean(result), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def estimate_json(estimate: Estimate, interval: RefittedInterval | None = None) -> Json:
    """One estimate; `interval`, where given, replaces value +- 1.96 sd."""
    return {
        "value": estimate.value,
        "sd": estimate.sd,
        "unit": estimate.unit,
        "determined": estimate.determined,
        "interval": estimate.interval() if interval is None else (interval.low, interval.high),
        "interval_from": "sd" if interval is None else interval.source,
        "at_bound": estimate.at_bound,
    }


def held_json(value: float, unit: str) -> Json:
    """A fixed parameter."""
    return {"value": value, "sd": None, "unit": unit, "determined": None, "held": True}


def all_parameters_json(
    model: Model,
    estimates: Mapping[str, Estimate] | None = None,
    intervals: Mapping[str, RefittedInterval] | None = None,
) -> dict[str, Json]:
    """The tyre and effect parameters of `model`, and all others that were estimated, by full name."""
    estimates, intervals, parts = estimates or {}, intervals or {}, {}
    for name, (value, domain) in parameters(model).items():
        if name in estimates:
            parts[name] = estimate_json(estimates[name], intervals.get(name))
        elif name.startswith(("tyre.", "effects.")) and not (name in ("tyre.dSh", "tyre.dSv") and float(value) == 0):
            parts[name] = held_json(float(value), domain.unit)
    if not model.constraint.slips:
        parts = {name: part for name, part in parts.items() if not name.startswith("tyre.")}
    return parts


def parameters_json(parts: Mapping[str, Json]) -> Json:
    """Those of `all_parameters_json` that belong to no effect, by their short names."""
    return {short_name(name): part for name, part in parts.items() if not name.startswith("effects.")}


def effects_json(parts: Mapping[str, Json], model: Model) -> Json:
    """Those of `all_parameters_json` of effects: {effect: {parameter: ...}}, and the `EXPRESSION` of laws."""
    grouped: Json = {name: {} for name in model.effects}
    for name, part in parts.items():
        if name.startswith("effects."):
            _, effect, parameter = name.split(".", 2)
            grouped[effect][parameter] = part
    for name, effect in model.effects.items():
        if isinstance(effect, Law):
            grouped[name][EXPRESSION] = effect.expression
        if isinstance(effect, ByCondition):
            for one in effect.differences:
                where = {"by": effect.key, LABEL: one.label, "of": list(one.names), "ratio": one.relative}
                grouped[name][one.field] = grouped[name].get(one.field, {}) | where
    return grouped


def misfit_json(train: Score | None, heldout: Score | None) -> Json:
    """Mean squared residuals in units of the noise variance."""
    return {"train": train and train.misfit, "heldout": heldout and heldout.misfit}


def score_json(score: Score | None) -> Json | None:
    """Root mean squared errors."""
    return score and {"position_m": score.position_m, "heading_rad": score.heading_rad}


def rmse_json(train: Score | None, heldout: Score | None) -> Json:
    """Root mean squared errors of both roles."""
    return {"train": score_json(train), "heldout": score_json(heldout)}


def run_json(score: RunScore) -> Json:
    """The errors of one run."""
    return {
        "run": score.run,
        "role": score.role,
        "misfit": score.misfit,
        "worst_time_s": score.worst_time_s,
        "channels": score.channels,
        "rmse": {"position_m": score.position_m, "heading_rad": score.heading_rad},
    }


def runs_json(scores: Sequence[RunScore]) -> list[Json]:
    """The errors of each run."""
    return [run_json(score) for score in scores]
