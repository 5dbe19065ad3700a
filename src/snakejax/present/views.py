"""The models of a result, each with its replays of all runs, or of some of many windows."""

import dataclasses
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
from snakejax.estimation.fitted_model import FittedModel
from snakejax.recording.run import Run

from .as_text.tables import NOT_CONVERGED
from .style import LineStyle, step_style

MOST_DRAWN = 12
"""Runs that are drawn, at most: of more a page can neither be read nor written in a minute."""


class ModelView(NamedTuple):
    """One model: `key` on the page, `label`, line style, replays (`scenes`), and tyre forces where it was fitted."""

    key: str
    label: str
    look: LineStyle
    scenes: tuple[RunReplay, ...]
    traction: TyreForces | None


def view_of_fit(fit: Fit) -> ModelView:
    """The model of a fit."""
    fitted = drawn(fit.fitted)
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
    fitted = drawn(step.fitted)
    replays = replay_runs(fitted)
    label = step_label(step.effects) + doubt(step.converged)
    return ModelView(str(number), label, step_style(number), replays, tyre_forces(fitted, replays))


def drawn(fitted: FittedModel) -> FittedModel:
    """`fitted` with the recordings that are drawn: all, or, of many windows, the middle one of each recording; of these
    held-out ones first, then train ones spread over all."""
    if len(fitted.recordings) <= MOST_DRAWN:
        return fitted
    middle = []
    for role in ("heldout", "train"):
        numbers = fitted.numbered(role)
        names = list(dict.fromkeys(fitted.recordings[k].recorded_as for k in numbers))
        own = [[k for k in numbers if fitted.recordings[k].recorded_as == name] for name in names]
        one_each = [windows[len(windows) // 2] for windows in own]
        room = min(len(one_each), MOST_DRAWN - len(middle) if middle else MOST_DRAWN // 2)
        middle += [one_each[k] for k in np.unique(np.linspace(0, len(one_each) - 1, room).astype(int))]
    kept = sorted(middle)
    return dataclasses.replace(
        fitted,
        recordings=tuple(fitted.recordings[k] for k in kept),
        starts=np.asarray(fitted.starts)[kept],
        residuals=tuple(fitted.residuals[k] for k in kept),
    )


def doubt(converged: bool | None, gap: str = " ") -> str:
    """The note, after a `gap`, behind the name or a number of a fit that did not converge; else empty."""
    return f"{gap}({NOT_CONVERGED})" if converged is False else ""


def step_label(effects: Sequence[str]) -> str:
    """The model with these effects, in a legend."""
    return f"+ {' + '.join(effects)}" if effects else "base model"


def views_of_steps(explanation: Explanation) -> tuple[ModelView, ...]:
    """The model of every step of an explanation, the base first."""
    return tuple(view_of_step(step, number) for number, step in enumerate(explanation.steps))
