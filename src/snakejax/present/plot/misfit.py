"""Figures of the error falling."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snakejax.diagnosis.explanation import Explanation

from ..as_text.errors import times_noise, times_noise_text
from ..style import HELDOUT, MEASURED, TRAIN
from ..views import ModelView, doubt, view_of_step
from .paths import path, titled

STEP = 1.4
"""Inches that the name of a step needs."""


def fall(explanation: Explanation, models: Sequence[ModelView] = ()) -> Figure:
    """The held-out path before and after an explanation, and the error after each step.

    Left, one held-out run (or train run where none is held out) as measured, by the base model and by the final one,
    x against y [m]. Right, the error of train and held-out runs at each step, in multiples of the noise.
    `models`, where they are at hand, are those of its steps.
    """
    wide = max(5.5, STEP * len(explanation.steps))
    figure = Figure(figsize=(4.5 + wide, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(4.5, wide))
    ends = sorted({0, len(explanation.steps) - 1})
    played = [models[k] if models else view_of_step(explanation.steps[k], k) for k in ends]
    shown = next((k for k, scene in enumerate(played[0].scenes) if scene.role == "heldout"), 0)
    measured = played[0].scenes[shown].measured
    path(left, measured, MEASURED, "measured", wide=True)
    for model in played:
        path(left, np.where(np.isfinite(measured), model.scenes[shown].pose, np.nan), model.look, model.label)
    run = played[0].scenes[shown]
    left.set(title=titled(run.run, run.role), xlabel="x [m]", ylabel="y [m]")
    left.set_aspect("equal", adjustable="datalim")
    left.legend(fontsize="small")
    _bars(right, explanation)
    return figure


def waterfall(explanation: Explanation) -> Figure:
    """The error of train and held-out runs at each step, in multiples of the noise, on a logarithmic scale."""
    figure = Figure(figsize=(2.2 + STEP * len(explanation.steps), 4.2), layout="constrained")
    _bars(figure.subplots(), explanation)
    return figure


def _bars(axis: Axes, explanation: Explanation) -> None:
    places = np.arange(len(explanation.steps))
    for shift, colour, name, hatch, scores in (
        (-0.2, TRAIN, "train", "", [step.train for step in explanation.steps]),
        (0.2, HELDOUT, "held out", "//", [step.heldout for step in explanation.steps]),
    ):
        errors = np.array([times_noise(score and score.misfit) for score in scores], float)
        if not np.isfinite(errors).any():
            continue
        bars = axis.bar(places + shift, errors, 0.38, color=colour, hatch=hatch, edgecolor="white", lw=0, label=name)
        axis.bar_label(bars, [times_noise_text(score and score.misfit) for score in scores], fontsize="small")
    axis.axhline(1.0, color="0.2", lw=1, ls=":", label="noise")
    axis.set_yscale("log")
    names = [f"{step.change}\n{step.name}{doubt(step.converged, chr(10))}" for step in explanation.steps]
    axis.set_xticks(places, names, fontsize="small")
    axis.set(
        ylabel="error, multiples of the noise", title=titled(f"{explanation.case.name}: {explanation.verdict}", "")
    )
    axis.margins(y=0.15)
    axis.legend(fontsize="small")
