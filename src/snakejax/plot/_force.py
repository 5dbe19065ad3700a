"""Figures of forces: the tyre's, and the one that is missing."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from .._explain import Explanation
from .._fit import Fit
from .._palette import FORCES, MATPLOTLIB, TRAIN
from .._played import Played
from ._paths import models_of, titled

COMPONENTS = ("X [N]", "Y [N]", "N [N m]")


def tyre(found: Fit | Sequence[Played]) -> Figure:
    """The force of the tyre against slip [degrees, or m/s for a viscous one], each fitted curve with its 95% band.

    Marks with 95% bars both ways are what the train runs ask of the tyre, whatever its law; see `_grip`.
    """
    fitted = [(model, model.traction) for model in models_of(found) if model.traction is not None]
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
            label = f"asked for, {model.label}"
            axis.errorbar(factor * means.slip, means.force, **errors, fmt="o", color=colour, ms=3, lw=0.8, label=label)
    unit = "slip speed [m/s]" if viscous else "slip angle [degrees]"
    axis.set(xlabel=unit, ylabel="force on a wheelset [N]")
    axis.legend(fontsize="small")
    return figure


def missing(found: Explanation) -> Figure:
    """The missing force of each run over time, [N] and [N m], with a 95% band; what it depends on.

    **Raises:** `ValueError` where no force was estimated.
    """
    if found.missing is None:
        raise ValueError(f"The explanation of {found.case.name} has no missing force: it is {found.verdict}.")
    runs = found.missing.runs
    figure = Figure(figsize=(10.0, 2.4 + 1.4 * len(runs)), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(1.4 * len(runs), 2.4))
    above = figure.add_subfigure(grid[0])
    below = figure.add_subfigure(grid[1])
    axes = above.subplots(len(runs), 3, sharex=True, squeeze=False)
    for row, run in zip(axes, runs, strict=True):
        for k, (axis, name, look) in enumerate(zip(row, COMPONENTS, FORCES, strict=True)):
            force, sd = run.force[:, k], run.sd[:, k]
            if not np.isfinite(sd).any():
                axis.annotate("not felt by this structure", (0.5, 0.5), xycoords="axes fraction", ha="center")
                force = np.full_like(force, np.nan)
            axis.fill_between(run.t, force - 1.96 * sd, force + 1.96 * sd, color=look.colour, alpha=0.25, lw=0)
            axis.plot(run.t, force, color=look.colour, lw=1)
            axis.set_ylabel(name, fontsize="small")
        row[1].set_title(titled(run.run, "train"), fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    bars = below.subplots()
    names, shares = zip(*found.missing.depends_on, strict=True)
    bars.barh(names[::-1], 100 * np.array(shares[::-1]), color=TRAIN)
    bars.set(xlabel="share of the excess that each variable predicts on runs it was not fitted to [%]", xlim=(0, 100))
    return figure
