"""Figures of paths and of residuals."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snakejax.dynamics.observation import CHANNELS
from snakejax.estimation.fit_record import Fit

from ..style import MATPLOTLIB, MEASURED, LineStyle
from ..views import ModelView, view_of_fit

GAP = "0.9"
HEADING_MARKS = 12
COLUMNS = 4
"""Marks of the heading along a path, and panels in a row."""


def paths(shown: Fit | Sequence[ModelView]) -> Figure:
    """The measured and the modelled path of each run, x against y [m] on equal axes, with marks for the heading."""
    models = models_of(shown)
    scenes = models[0].scenes
    columns = min(len(scenes), COLUMNS)
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.2 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (axis, scene) in enumerate(zip(axes, scenes, strict=False)):
        drawn = [(scene.measured, MEASURED, "measured")] if np.isfinite(scene.measured).any() else []
        drawn += [(model.scenes[k].pose, model.look, model.label) for model in models]
        for pose, look, label in drawn:
            path(axis, pose, look, label, wide=look == MEASURED)
            heading_marks(axis, pose, look.colour)
        start = scene.pose[0]
        axis.plot(start[0], start[1], "o", color=models[0].look.colour, ms=4, label="start")
        axis.set(title=titled(scene.run, scene.role), xlabel="x [m]", ylabel="y [m]")
        axis.set_aspect("equal", adjustable="datalim")
    for axis in axes[len(scenes) :]:
        axis.set_axis_off()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
    return figure


def models_of(shown: Fit | Sequence[ModelView]) -> Sequence[ModelView]:
    """The models of a fit, or those given."""
    return (view_of_fit(shown),) if isinstance(shown, Fit) else shown


def path(axis: Axes, pose: Float[np.ndarray, "n 3"], look: LineStyle, label: str, wide: bool = False) -> None:
    """Draw a path; the measured one `wide`, so that others can be seen on it."""
    width, alpha = (4.0, 0.5) if wide else (1.3, 1.0)
    axis.plot(pose[:, 0], pose[:, 1], color=look.colour, ls=MATPLOTLIB[look.dash], lw=width, alpha=alpha, label=label)


def titled(name: str, role: str) -> str:
    """A run as a title has it; a dollar in its name is no formula."""
    name = name.replace("$", r"\$")
    return f"{name} (held out)" if role == "heldout" else name


def heading_marks(axis: Axes, pose: Float[np.ndarray, "n 3"], colour: str) -> None:
    """Short strokes along the heading, at even intervals of time."""
    present = pose[np.isfinite(pose).all(axis=1)]
    marked = present[:: max(len(present) // HEADING_MARKS, 1)]
    axis.quiver(
        *marked[:, :2].T, np.cos(marked[:, 2]), np.sin(marked[:, 2]), color=colour, angles="xy", width=0.005, scale=18
    )


def residuals(shown: Fit | ModelView) -> Figure:
    """Measured minus modelled over time, each run a row and each channel a column, in standard deviations of the noise.

    Lost frames are shaded; two dotted lines hold 95% of what is noise.
    """
    model = view_of_fit(shown) if isinstance(shown, Fit) else shown
    figure = Figure(figsize=(10.0, 1.3 + 1.2 * len(model.scenes)), layout="constrained")
    axes = figure.subplots(len(model.scenes), 3, sharex=True, sharey="row", squeeze=False)
    for row, scene in zip(axes, model.scenes, strict=True):
        for axis, channel in zip(row, scene.track.residual.T, strict=True):
            for first, last in gaps(scene.times, np.isfinite(channel)):
                axis.axvspan(first, last, color=GAP, lw=0)
            axis.plot(scene.times, channel, ".", color=model.look.colour, ms=1.2, rasterized=True)
            for level in (-1.96, 1.96):
                axis.axhline(level, color="0.3", lw=0.6, ls=":")
        for axis, name in zip(row, CHANNELS, strict=True):
            axis.set_ylabel(f"{name} / noise", fontsize="small")
        row[1].set_title(titled(scene.run, scene.role), fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure


def gaps(times: Float[np.ndarray, " n"], present: np.ndarray) -> Iterator[tuple[float, float]]:
    """(first, last) time [s] of each stretch of lost frames, half a frame wider at both ends."""
    half = float(np.median(np.diff(times))) / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~np.asarray(present), [False]]).astype(int)))
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        yield float(times[first]) - half, float(times[after - 1]) + half
