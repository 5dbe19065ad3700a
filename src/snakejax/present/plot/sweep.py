"""Figures of a sweep: k_s against one parameter with its polynomial, or maps over two."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from snakejax.simulation.rayleigh_match import FOLLOWS, Polynomial

from ..as_text.tables import with_unit
from ..style import HELDOUT, MEASURED, TRAIN

if TYPE_CHECKING:
    import xarray


EMPTY = "0.9"


def sweep(dataset: "xarray.Dataset", curve: Polynomial | None = None, title: str = "") -> Figure | None:
    """k_s [N s/m] along the axes of a sweep, and the mismatch of the two paths [%]; None for more axes than two.

    **Arguments:** `dataset`, of `nearest_rayleigh`; `curve`, the polynomial of k_s along a single axis.
    """
    dims = list(dataset.k_s.dims)
    if len(dims) == 2:
        return _sweep_map(dataset, title)
    if len(dims) != 1:
        return None
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    values = dataset[dims[0]].values
    above.plot(values, dataset.k_s, "o", color=MEASURED.colour, ms=4, label="nearest Rayleigh board")
    if curve is not None:
        x = np.linspace(curve.fitted_range[0], curve.fitted_range[1], 200)
        above.plot(x, curve(x), color=HELDOUT, lw=1.2, label="order 4" + _r_squared(curve))
    above.set(ylabel="$k_s$ [N s/m]", title=title)
    above.legend(fontsize="small")
    below.plot(values, 100 * dataset.mismatch, ".-", color=TRAIN)
    below.axhline(100 * FOLLOWS, color="0.2", lw=1, ls=":")
    below.set(xlabel=_named(dataset, dims[0]), ylabel="rms distance\n[% of the path]", ylim=(0, None))
    return figure


def _r_squared(curve: Polynomial) -> str:
    """R^2 as a label says it; nothing where k_s does not change."""
    return "" if curve.r_squared is None else f", $R^2$ = {curve.r_squared:.5f}"


def _sweep_map(dataset: "xarray.Dataset", title: str) -> Figure:
    """k_s and mismatch as two maps; where no Rayleigh board follows, the first is blank."""
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    across, along = dataset.k_s.dims[1], dataset.k_s.dims[0]
    parts = ((dataset.k_s, "$k_s$ [N s/m]"), (100 * dataset.mismatch, "rms distance [% of the path]"))
    for axis, (values, label) in zip(figure.subplots(1, 2), parts, strict=True):
        drawn = axis.pcolormesh(dataset[across], dataset[along], values, shading="nearest", cmap="viridis")
        figure.colorbar(drawn, ax=axis, label=label)
        axis.set(xlabel=_named(dataset, across), ylabel=_named(dataset, along), facecolor=EMPTY)
    figure.suptitle(title)
    return figure


def _named(dataset: "xarray.Dataset", name: Any) -> str:
    return with_unit(str(name), dataset[name].attrs.get("units", "-"))
