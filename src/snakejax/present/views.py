"""The models of a result, each with its replays of all runs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.residuals.reconstruction import TyreForces, tyre_forces
from snakejax.diagnosis.residuals.replays import RunReplay, replay_model, replay_runs
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.dynamics.model import Model
from snakejax.estimation.fit_record import Fit
from snakejax.recording.run import Run

from .as_text.tables import NOT_CONVERGED
from .style import LineStyle, step_style


class ModelView(NamedTuple):
    """One model: `key` on the page, `label`, line style, replays (`scenes`), and tyre forces where it was fitted."""

    key: str
    label: str
    look: LineStyle
    scenes: tuple[RunReplay, ...]
    traction: TyreForces | None


def view_of_fit(fit: Fit) -> ModelView:
    """The model of a fit."""
    fitted = fit.fitted
    replays = replay_runs(fitted)
    effects = list(fit.model.effects)
    label = f"model with {' and '.join(effects)}" if effects else "model"
    label += doubt(fit.converged)
    return ModelView("0", label, step_style(0), replays, tyre_forces(fitted, replays))


def view_of_model(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> ModelView:
    """A model that was not fitted, in `runs` from their starts."""
    return ModelView("0", "model", step_style(0), replay_model(model, runs, starts), None)


def view_of_step(step: SelectionStep, number: int = 0) -> ModelView:
    """The model of one step of the loop."""
    replays = replay_runs(step.fitted)
    label = step_label(step.effects) + doubt(step.converged)
    return ModelView(str(number), label, step_style(number), replays, tyre_forces(step.fitted, replays))


def doubt(converged: bool | None, gap: str = " ") -> str:
    """The note, after a `gap`, behind the name or a number of a fit that did not converge; else empty."""
    return f"{gap}({NOT_CONVERGED})" if converged is False else ""


def step_label(effects: Sequence[str]) -> str:
    """The model with these effects, in a legend."""
    return f"+ {' + '.join(effects)}" if effects else "base model"


def views_of_steps(explanation: Explanation) -> tuple[ModelView, ...]:
    """The model of every step of an explanation, the base first."""
    return tuple(view_of_step(step, number) for number, step in enumerate(explanation.steps))
