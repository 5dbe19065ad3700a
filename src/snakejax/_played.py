"""The models of a result, each with what it plays in every run."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._explain import Explanation
from ._fit import Fit
from ._grip import Traction, traction
from ._model import Model
from ._palette import Look, look
from ._recording import Run
from ._scenes import Scene, scenes, scenes_of, simulated
from ._stage import Stage


class Played(NamedTuple):
    """One model: a `key` for the page, a `label` for a reader, its look, its scenes; where it was fitted, its tyre."""

    key: str
    label: str
    look: Look
    scenes: tuple[Scene, ...]
    traction: Traction | None


def played_fit(found: Fit) -> Played:
    """The model of a fit."""
    seen = scenes_of(found)
    effects = list(found.model.effects)
    label = f"model with {' and '.join(effects)}" if effects else "model"
    return Played("0", label, look(""), seen, traction(found.study, found.optimum, seen))


def played_model(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> Played:
    """A model that was not fitted, in `runs` from their starts."""
    return Played("0", "model", look(""), simulated(model, runs, starts), None)


def played_stage(stage: Stage, number: int = 0) -> Played:
    """The model of one step of the loop."""
    study, optimum = stage.bench.study, stage.step.optimum
    seen = scenes(study, optimum, stage.judgement)
    return Played(str(number), stage_label(stage.effects), stage_look(stage), seen, traction(study, optimum, seen))


def stage_label(effects: Sequence[str]) -> str:
    """The model with these effects, in a legend."""
    return f"+ {' + '.join(effects)}" if effects else "base model"


def stage_look(stage: Stage) -> Look:
    """The look of a step: that of the effect it added, and after one was dropped that of the last one left."""
    effects = stage.effects
    return look(stage.name if stage.change == "added" else effects[-1] if effects else "")


def played_stages(found: Explanation) -> tuple[Played, ...]:
    """The model of every step of an explanation, the base first."""
    return tuple(played_stage(stage, number) for number, stage in enumerate(found.stages))
