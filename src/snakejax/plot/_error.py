"""Figures of the error falling."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._explain import Explanation
from .._palette import HELDOUT, MEASURED, TRAIN
from .._played import Played, played_stage, stage_label
from .._text import misfit_text
from ._paths import path, titled

STEP = 1.4
"""Inches that the name of a step needs."""


def fall(found: Explanation, models: Sequence[Played] = ()) -> Figure:
    """The story of an explanation: the held-out path before and after, and the error falling step by step.

    Left, one held-out run (or train run where none is held out) as measured, by the base model and by the final one,
    x against y [m]. Right, the misfit of train and held-out runs at each step, on a logarithmic scale, and the noise.
    `models`, where they are at hand, are those of its steps.
    """
    wide = max(5.5, STEP * len(found.stages))
    figure = Figure(figsize=(4.5 + wide, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(4.5, wide))
    ends = sorted({0, len(found.stages) - 1})
    played = [models[k] if models else played_stage(found.stages[k]) for k in ends]
    shown = next((k for k, scene in enumerate(played[0].scenes) if scene.role == "heldout"), 0)
    seen = played[0].scenes[shown].seen
    path(left, seen, MEASURED, "measured", wide=True)
    for k, model in zip(ends, played, strict=True):
        name = stage_label(found.stages[k].effects)
        path(left, np.where(np.isfinite(seen), model.scenes[shown].pose, np.nan), model.look, name)
    run = played[0].scenes[shown]
    left.set(title=titled(run.run, run.role), xlabel="x [m]", ylabel="y [m]")
    left.set_aspect("equal", adjustable="datalim")
    left.legend(fontsize="small")
    _bars(right, found)
    return figure


def waterfall(found: Explanation) -> Figure:
    """The misfit of train and held-out runs at each step, on a logarithmic scale, and the noise at 1."""
    figure = Figure(figsize=(2.2 + STEP * len(found.stages), 4.2), layout="constrained")
    _bars(figure.subplots(), found)
    return figure


def _bars(axis: Axes, found: Explanation) -> None:
    places = np.arange(len(found.stages))
    for shift, colour, name, hatch, scores in (
        (-0.2, TRAIN, "train", "", [stage.train for stage in found.stages]),
        (0.2, HELDOUT, "held out", "//", [stage.heldout for stage in found.stages]),
    ):
        misfits = [np.nan if score is None else score.misfit for score in scores]
        if not np.isfinite(misfits).any():
            continue
        bars = axis.bar(places + shift, misfits, 0.38, color=colour, hatch=hatch, edgecolor="white", lw=0, label=name)
        axis.bar_label(bars, ["" if score is None else misfit_text(score.misfit) for score in scores], fontsize="small")
    axis.axhline(1.0, color="0.2", lw=1, ls=":", label="noise")
    axis.set_yscale("log")
    axis.set_xticks(places, [f"{stage.change}\n{stage.name}" for stage in found.stages], fontsize="small")
    axis.set(ylabel="mean squared residual / noise variance", title=titled(f"{found.case.name}: {found.verdict}", ""))
    axis.margins(y=0.15)
    axis.legend(fontsize="small")
