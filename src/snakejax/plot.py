"""Figures of a fit and of an explanation, with matplotlib and no display.

Each function returns the figure; `save` writes it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._explain import Explanation, Stage
from ._fit import Fit
from ._rayleigh import FOLLOWS, Polynomial
from ._replay import fitted_poses
from ._study import Optimum, Study

if TYPE_CHECKING:
    import xarray

MEASURED, MODELLED, GAP = "0.45", "#c2410c", "0.9"
BASE, TRAIN, HELDOUT = "#2563eb", "#475569", "#c2410c"
CHANNELS = ("x", "y", "heading")
HEADING_MARKS = 12


def paths(found: Fit, poses: Sequence[Float[np.ndarray, "n 3"]] | None = None) -> Figure:
    """The measured and the modelled path of each run, x against y [m] on equal axes, with marks for the heading.

    **Arguments:** `poses`: what the model says of each run, where it has been computed already.
    """
    poses = fitted_poses(found) if poses is None else poses
    runs = found.study.runs
    columns = min(len(runs), 4)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.2 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, run, pose in zip(axes, runs, poses, strict=False):
        seen = np.asarray(run.pose)
        axis.plot(seen[:, 0], seen[:, 1], color=MEASURED, lw=2.5, label="measured")
        axis.plot(pose[:, 0], pose[:, 1], color=MODELLED, lw=1, label="model")
        for marked, colour in ((seen, MEASURED), (pose, MODELLED)):
            _heading_marks(axis, marked, colour)
        axis.plot(*pose[0, :2], "o", color=MODELLED, ms=4, label="start")
        axis.set(title=_title(run.name, run.role), xlabel="x [m]", ylabel="y [m]")
        axis.set_aspect("equal", adjustable="datalim")
    for axis in axes[len(runs) :]:
        axis.set_axis_off()
    axes[0].legend(fontsize="small")
    return figure


def _title(name: str, role: str) -> str:
    return f"{name} (held out)" if role == "heldout" else name


def _heading_marks(axis: Axes, pose: Float[np.ndarray, "n 3"], colour: str) -> None:
    present = pose[np.isfinite(pose).all(axis=1)]
    marked = present[:: max(len(present) // HEADING_MARKS, 1)]
    axis.quiver(
        *marked[:, :2].T, np.cos(marked[:, 2]), np.sin(marked[:, 2]), color=colour, angles="xy", width=0.005, scale=18
    )


def residuals(found: Fit) -> Figure:
    """Measured minus modelled over time, each run a row and each channel a column, in standard deviations of the noise.

    Lost frames are shaded; two dotted lines hold 95% of what is noise.
    """
    runs, channels = found.study.runs, _residuals(found)
    figure = Figure(figsize=(10.0, 1.3 + 1.2 * len(runs)), layout="constrained")
    axes = figure.subplots(len(runs), 3, sharex=True, sharey="row", squeeze=False)
    for row, run, residual in zip(axes, runs, channels, strict=True):
        times = np.asarray(run.times)
        for axis, channel in zip(row, residual.T, strict=True):
            for first, last in gaps(times, np.isfinite(channel)):
                axis.axvspan(first, last, color=GAP, lw=0)
            axis.plot(times, channel, ".", color=MODELLED, ms=1.2, rasterized=True)
            for level in (-1.96, 1.96):
                axis.axhline(level, color="0.3", lw=0.6, ls=":")
        row[0].set_ylabel("residual [sd]", fontsize="small")
        row[1].set_title(_title(run.name, run.role), fontsize="small")
    for axis, name in zip(axes[-1], CHANNELS, strict=True):
        axis.set_xlabel(f"time [s] ({name})")
    return figure


def _residuals(found: Fit) -> list[Float[np.ndarray, "n 3"]]:
    """The whitened residual at each frame of each run, NaN where the frame was lost."""
    held = found.study.numbered("heldout")
    return [
        _residual(found.study, found.heldout_optimum if k in held else found.optimum, k)
        for k in range(len(found.study.runs))
    ]


def _residual(study: Study, optimum: Optimum | None, run: int) -> Float[np.ndarray, "n 3"]:
    """The whitened residual at each frame of one run, NaN where the frame was lost or the run not judged."""
    seen = np.isfinite(np.asarray(study.runs[run].pose))
    if optimum is None:
        return np.full(seen.shape, np.nan)
    return np.where(seen, np.asarray(optimum.linearised.residual)[run][: len(seen)], np.nan)


def fall(found: Explanation) -> Figure:
    """The story of an explanation: the held-out path before and after, and the error falling step by step.

    Left, one held-out run (or train run where none is held out) as measured, by the base model and by the final one,
    x against y [m]. Right, the misfit of train and held-out runs at each step, on a logarithmic scale, and the noise.
    """
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    study = found.base.bench.study
    held = study.numbered("heldout")
    shown = (held or study.numbered("train"))[0]
    run = study.runs[shown]
    seen = np.asarray(run.pose)
    left.plot(seen[:, 0], seen[:, 1], color=MEASURED, lw=4, alpha=0.6, label="measured")
    for stage, colour, name in ((found.base, BASE, "base model"), (found.final, MODELLED, _effects_of(found))):
        pose = _modelled(stage, shown)
        left.plot(pose[:, 0], pose[:, 1], color=colour, lw=1.2, label=name)
        if found.final is found.base:
            break
    left.set(title=_title(run.name, run.role), xlabel="x [m]", ylabel="y [m]")
    left.set_aspect("equal", adjustable="datalim")
    left.legend(fontsize="small")
    places = np.arange(len(found.stages))
    for shift, colour, name, scores in (
        (-0.2, TRAIN, "train", [stage.train for stage in found.stages]),
        (0.2, HELDOUT, "held out", [stage.heldout for stage in found.stages]),
    ):
        misfits = [np.nan if score is None else score.misfit for score in scores]
        bars = right.bar(places + shift, misfits, 0.38, color=colour, label=name)
        right.bar_label(bars, [f"{value:.3g}" if np.isfinite(value) else "" for value in misfits], fontsize="small")
    right.axhline(1.0, color="0.2", lw=1, ls=":", label="noise")
    right.set_yscale("log")
    right.set_xticks(places, [f"{stage.change}\n{stage.name}" for stage in found.stages], fontsize="small")
    right.set(ylabel="mean squared residual / noise variance", title=f"{found.case.name}: {found.verdict}")
    right.margins(y=0.15)
    right.legend(fontsize="small")
    return figure


def _effects_of(found: Explanation) -> str:
    return "with " + " and ".join(found.final.effects)


def _modelled(stage: Stage, run: int) -> Float[np.ndarray, "n 3"]:
    """What the model of `stage` says at the frames of a run that were seen, NaN elsewhere."""
    study = stage.bench.study
    optimum = stage.step.optimum if study.runs[run].role == "train" else stage.judgement
    return np.asarray(study.runs[run].pose) - _residual(study, optimum, run) * np.asarray(study.noise.channels)


def missing(found: Explanation) -> Figure:
    """The missing force of each run over time, [N] and [N m], with a band of two standard errors; what it depends on.

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
        for k, (axis, name) in enumerate(zip(row, ("X [N]", "Y [N]", "N [N m]"), strict=True)):
            force, sd = run.force[:, k], run.sd[:, k]
            axis.fill_between(run.t, force - 2 * sd, force + 2 * sd, color=MODELLED, alpha=0.25, lw=0)
            axis.plot(run.t, force, color=MODELLED, lw=1)
            axis.set_ylabel(name, fontsize="small")
        row[1].set_title(run.run, fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    bars = below.subplots()
    names, shares = zip(*found.missing.depends_on, strict=True)
    bars.barh(names[::-1], 100 * np.array(shares[::-1]), color=TRAIN)
    bars.set(xlabel="share of the excess that each variable predicts on runs it was not fitted to [%]", xlim=(0, 100))
    return figure


def sweep(found: "xarray.Dataset", curve: Polynomial | None = None, title: str = "") -> Figure | None:
    """k_s [N s/m] along the axes of a sweep, and the mismatch of the two paths [%]; None for more axes than two.

    **Arguments:** `found`, of `nearest_rayleigh`; `curve`, the polynomial of k_s along a single axis.
    """
    dims = list(found.k_s.dims)
    if len(dims) == 2:
        return _sweep_map(found, title)
    if len(dims) != 1:
        return None
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    values = found[dims[0]].values
    above.plot(values, found.k_s, "o", color=MEASURED, ms=4, label="nearest Rayleigh board")
    if curve is not None:
        x = np.linspace(curve.fitted_range[0], curve.fitted_range[1], 200)
        above.plot(x, curve(x), color=MODELLED, lw=1.2, label="order 4" + _r_squared(curve))
    above.set(ylabel="$k_s$ [N s/m]", title=title)
    above.legend(fontsize="small")
    below.plot(values, 100 * found.mismatch, ".-", color=TRAIN)
    below.axhline(100 * FOLLOWS, color="0.2", lw=1, ls=":")
    below.set(xlabel=_named(found, dims[0]), ylabel="rms distance\n[% of the path]", ylim=(0, None))
    return figure


def _r_squared(curve: Polynomial) -> str:
    """R^2 as a label says it; nothing where k_s does not change."""
    return "" if curve.r_squared is None else f", $R^2$ = {curve.r_squared:.5f}"


def _sweep_map(found: "xarray.Dataset", title: str) -> Figure:
    """k_s and mismatch as two maps; where no Rayleigh board follows, the first is blank."""
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    across, along = found.k_s.dims[1], found.k_s.dims[0]
    parts = ((found.k_s, "$k_s$ [N s/m]"), (100 * found.mismatch, "rms distance [% of the path]"))
    for axis, (values, label) in zip(figure.subplots(1, 2), parts, strict=True):
        drawn = axis.pcolormesh(found[across], found[along], values, shading="nearest", cmap="viridis")
        figure.colorbar(drawn, ax=axis, label=label)
        axis.set(xlabel=_named(found, across), ylabel=_named(found, along), facecolor=GAP)
    figure.suptitle(title)
    return figure


def _named(found: "xarray.Dataset", name: Any) -> str:
    unit = found[name].attrs.get("units", "-")
    return str(name) if unit == "-" else f"{name} [{unit}]"


def gaps(times: Float[np.ndarray, " n"], present: np.ndarray) -> Iterator[tuple[float, float]]:
    """(first, last) time [s] of each stretch of lost frames, half a frame wider at both ends."""
    half = float(np.median(np.diff(times))) / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~np.asarray(present), [False]]).astype(int)))
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        yield float(times[first]) - half, float(times[after - 1]) + half


def save(figure: Figure, folder: Path | str, name: str) -> list[Path]:
    """Write `figure` to NAME.png and NAME.svg in `folder`, made where it is not there; the paths written."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path in written:
        figure.savefig(path, dpi=150)
    return written
