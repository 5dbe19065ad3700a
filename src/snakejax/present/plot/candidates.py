"""Figures of a diagnosis: the ranking of the candidates, and which of them the runs cannot distinguish."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from snakejax.diagnosis.selection.steps import SelectionStep

from ..as_text.columns import PREDICTED, REFIT, WINDOWS
from ..as_text.errors import times_noise
from ..as_text.tables import NOT_CONVERGED
from ..style import TRAIN

SMALLEST = 1e-300
"""Smallest p-value that is drawn: its logarithm is finite."""


def ranking(base: SelectionStep) -> Figure:
    """Left, the error that each candidate would leave by the linear model, of short windows or of whole runs; middle,
    that of its refit on whole runs, with the base; both in multiples of the noise. Right, p.
    """
    shown = list(base.ranking)[::-1]
    figure = Figure(figsize=(10.0, 1.7 + 0.24 * len(shown)), layout="constrained")
    left, middle, right = figure.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.0, 1.0))
    places = np.arange(len(shown))
    predicted = np.array([times_noise(one.predicted_misfit) for one in shown], float)
    refitted = np.array([times_noise(one.refit_misfit) for one in shown], float)
    left.scatter(predicted, places, facecolors="none", edgecolors=TRAIN)
    short = np.array([one.converged is False for one in shown])
    middle.scatter(np.where(short, np.nan, refitted), places, c=TRAIN, label="refitted")
    if short.any():
        label = f"refit {NOT_CONVERGED}"
        middle.scatter(np.where(short, refitted, np.nan), places, c=TRAIN, marker="x", label=label)
    middle.axvline(base.train.times_noise, color="0.2", lw=1, ls=":", label="base")
    for axis, title in ((left, PREDICTED if base.predicted_of_runs else WINDOWS), (middle, REFIT)):
        axis.set_xscale("log")
        # Scatter about the noise must not look large; few errors are decades apart.
        low, high = axis.get_xlim()
        axis.set(xlabel=title, xlim=(min(0.5, low), max(2.0, high)))
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 50 else (1.0,)))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(axis="y", color="0.9", lw=0.6)
    left.set_yticks(places, [one.effect for one in shown], fontsize="small")
    sure = [np.nan if one.p_value is None else -np.log10(max(one.p_value, SMALLEST)) for one in shown]
    right.barh(places, sure, color=TRAIN)
    right.set(xlabel="-log10 of the corrected p")
    right.set_xscale("symlog", linthresh=2.0)
    level = base.criteria.significance_level
    right.axvline(-np.log10(level), color="0.2", lw=1, ls="--", label=f"significance level {level:g}")
    marks, labels = (
        [*of_refits, *of_p]
        for of_refits, of_p in zip(middle.get_legend_handles_labels(), right.get_legend_handles_labels(), strict=True)
    )
    figure.legend(marks, labels, fontsize="small", loc="outside upper center", ncols=4)
    return figure


def confusability(base: SelectionStep) -> Figure:
    """Candidates against candidates: a filled square is a pair that these runs cannot distinguish.

    Only candidates of such pairs are shown.
    """
    every = [one.effect for one in base.ranking]
    paired = {name for one in base.ranking for name in (one.effect, *one.confusable_with) if one.confusable_with}
    names = [name for name in every if name in paired]
    table = np.zeros((len(names), len(names)))
    for one in base.ranking:
        for other in one.confusable_with:
            if other in names:
                row, column = names.index(one.effect), names.index(other)
                table[row, column] = table[column, row] = 1.0
    size = 2.0 + 0.24 * len(names)
    figure = Figure(figsize=(size, size), layout="constrained")
    axis = figure.subplots()
    axis.set_aspect("equal")
    for row, column in np.argwhere(table > 0):
        axis.add_patch(_square(column, row))
    if not names:
        axis.text(0.5, 0.5, "all are distinguished", ha="center", va="center", transform=axis.transAxes)
    end = max(len(names), 1) - 0.5
    axis.set(xlim=(-0.5, end), ylim=(end, -0.5))
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize="small")
    axis.set_yticks(range(len(names)), names, fontsize="small")
    axis.grid(color="0.92", lw=0.6)
    axis.set_axisbelow(True)
    axis.plot([-0.5, end] if names else [], [-0.5, end] if names else [], color="0.7", lw=0.6)
    axis.set_title("not distinguishable\nby these runs", fontsize="medium")
    return figure


def _square(x: float, y: float):
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.4, y - 0.4), 0.8, 0.8, color=TRAIN, lw=0)
