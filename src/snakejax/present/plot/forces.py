"""Figures of forces: the tyre's, and the one that is missing."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from snakejax.diagnosis.explanation import Explanation
from snakejax.estimation.fit_record import Fit

from ..as_text.missing import determined
from ..style import COMPONENTS, FORCES, MATPLOTLIB, TRAIN
from ..views import ModelView
from .paths import models_of, titled


def tyre(models: Fit | Sequence[ModelView]) -> Figure:
    """The force of the tyre against slip [degrees, or m/s for a viscous one], each fitted curve with its 95% band.

    Marks with 95% bars are the forces reconstructed from the train runs without a tyre law; see `tyre_forces`.
    """
    fitted = [(model, model.traction) for model in models_of(models) if model.traction is not None]
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    axis = figure.subplots()
    viscous = fitted[0][1].viscous
    factor = 1.0 if viscous else 180 / np.pi
    for model, (curve, means, _) in fitted:
        slip, colour = factor * curve.slip, model.look.colour
        band = (curve.force - 1.96 * curve.sd, curve.force + 1.96 * curve.sd)
        axis.fill_between(slip, *band, color=colour, alpha=0.2, lw=0)
        axis.plot(slip, curve.force, color=colour, ls=MATPLOTLIB[model.look.dash], label=model.label)
        if means is not None:
            errors = {"xerr": 1.96 * factor * means.slip_sd, "yerr": 1.96 * means.sd}
            label = f"reconstructed, {model.label}"
            axis.errorbar(factor * means.slip, means.force, **errors, fmt="o", color=colour, ms=3, lw=0.8, label=label)
    unit = "slip speed [m/s]" if viscous else "slip angle [degrees]"
    axis.set(xlabel=unit, ylabel="force on a wheelset [N]")
    axis.legend(fontsize="small")
    return figure


def missing(explanation: Explanation) -> Figure:
    """The missing force of each run over time, [N] and [N m], with a 95% band; what it depends on.

    **Raises:** `ValueError` where no force was estimated.
    """
    if explanation.missing is None:
        raise ValueError(
            f"The explanation of {explanation.case.name} has no missing force: it is {explanation.verdict}."
        )
    runs, depends_on = explanation.missing.runs, dict(reversed(explanation.missing.depends_on))
    heights = (1.4 * len(runs), 2.4) if depends_on else (1.4 * len(runs),)
    figure = Figure(figsize=(10.0, sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    above = figure.add_subfigure(grid[0])
    axes = above.subplots(len(runs), 3, sharex=True, squeeze=False)
    shown = determined(runs)
    for row, run in zip(axes, runs, strict=True):
        for k, (axis, name, look) in enumerate(zip(row, COMPONENTS, FORCES, strict=True)):
            force, sd = run.force[:, k], run.sd[:, k]
            if not shown[k]:
                axis.annotate("not determined", (0.5, 0.5), xycoords="axes fraction", ha="center")
                force = sd = np.full_like(force, np.nan)
            axis.fill_between(run.t, force - 1.96 * sd, force + 1.96 * sd, color=look.colour, alpha=0.25, lw=0)
            axis.plot(run.t, force, color=look.colour, lw=1)
            axis.set_ylabel(name, fontsize="small")
        row[1].set_title(titled(run.run, "train"), fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    if not depends_on:
        return figure
    bars = figure.add_subfigure(grid[1]).subplots()
    bars.barh(list(depends_on), [100 * share for share in depends_on.values()], color=TRAIN)
    bars.set(xlabel="squared error above the noise that each variable alone predicts, omitted runs [%]", xlim=(0, 100))
    return figure
