"""`predict`: how far off saved models are so long after a lead-in."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx

from snakejax.core.errors import InputError
from snakejax.core.jax_config import prepare_jax
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.model import Model
from snakejax.estimation.prediction import (
    PredictionError,
    Predictions,
    predicted,
    prediction_errors,
    prediction_windows,
)
from snakejax.recording.case import load_case
from snakejax.recording.run import Case

from .loading import load_models
from .named_effects import EffectArguments

HORIZONS = (1.0, 2.0, 3.0)
LEAD = 0.5
"""Default horizons and lead-in [s] of `predict`."""


class PredictionResult(NamedTuple):
    """The errors `groups` {group: {model: {horizon: `PredictionError`}}} of saved models, `lead` [s], `horizons` [s],
    and the final `model`."""

    groups: Predictions
    lead: float
    horizons: tuple[float, ...]
    model: Model

    def columns(self) -> dict[str, list]:
        """A row for each group, model and horizon."""
        rows = [
            (group, model, float(horizon), *error)
            for group, models in self.groups.items()
            for model, horizons in models.items()
            for horizon, error in horizons.items()
        ]
        names = (
            "group",
            "model",
            "horizon_s",
            "position_m",
            "heading_rad",
            "position_90_m",
            "heading_90_rad",
            "windows",
        )
        return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def predict(
    case: Case | Path | str,
    from_: Path | str,
    horizon: Sequence[float] = HORIZONS,
    lead: float = LEAD,
    *,
    with_: EffectArguments | None = None,
    progress: Progress = no_progress,
) -> PredictionResult:
    """The pose errors of saved models 1, 2, 3 s after a lead-in, for each group of runs, as `snakejax predict` does.

    Every 0.5 s of a recording, where it has no gap, the state is estimated from `lead` seconds alone; a simulation
    under the recorded commands goes on from there.

    **Arguments:** `case`: a `Case` or the folder of one, which may have no run to train on; `from_`: the JSON of `fit`
    or `explain`; `horizon`, `lead` [s]; `with_`: effects of your own in that file.
    **Raises:** `InputError` for a case, a file or an option that cannot be used.
    """
    prepare_jax()
    if isinstance(case, str | Path):
        case = load_case(case, to_train=False)
    horizons = tuple(sorted({float(h) for h in horizon}))
    for value, option in (*((h, "--horizon") for h in horizons), (lead, "--lead")):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"`{value:g}` is not a time above 0", f"option {option}", "give seconds, as in 0.5")
    if not horizons:
        raise InputError("There is no horizon", "option --horizon", "give seconds, as in 1,2,3")
    models = load_models(from_, with_)
    for model in models.values():
        if type(model.board) is not type(case.board):
            what = f"The saved model is a {model.board.noun}, but the case a {case.board.noun}"
            raise InputError(what, f"option --from {from_}", "name the result of such a case")
    windows = prediction_windows(case.recordings or case.runs, lead, horizons)
    groups: dict[str, dict[str, dict[str, PredictionError]]] = {}
    known: list[tuple[Model, dict[str, dict[str, PredictionError]]]] = []
    for done, (name, model) in enumerate(models.items()):
        progress(ProgressEvent(Phase.PREDICTION, f"predicting with {name}", done, len(models)))
        errors = next((e for same, e in known if bool(eqx.tree_equal(same, model))), None)
        if errors is None:
            errors = prediction_errors(windows, predicted(model, windows), horizons)
            known.append((model, errors))
        for group, by_horizon in errors.items():
            groups.setdefault(group, {})[name] = by_horizon
    return PredictionResult(groups, float(lead), horizons, models["final"])
