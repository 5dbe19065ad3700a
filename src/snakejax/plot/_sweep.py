"""Figures of a sweep: k_s against one parameter with its polynomial, or maps over two."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from .._palette import MEASURED, TRAIN, look
from .._rayleigh import FOLLOWS, Polynomial

if TYPE_CHECKING:
    import xarray

EMPTY = "0.9"


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
    above.plot(values, found.k_s, "o", color=MEASURED.colour, ms=4, label="nearest Rayleigh board")
    if curve is not None:
        x = np.linspace(curve.fitted_range[0], curve.fitted_range[1], 200)
        above.plot(x, curve(x), color=look("rolling_resistance").colour, lw=1.2, label="order 4" + _r_squared(curve))
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
        axis.set(xlabel=_named(found, across), ylabel=_named(found, along), facecolor=EMPTY)
    figure.suptitle(title)
    return figure


def _named(found: "xarray.Dataset", name: Any) -> str:
    unit = found[name].attrs.get("units", "-")
    return str(name) if unit == "-" else f"{name} [{unit}]"
