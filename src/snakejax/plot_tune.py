"""Figures of a tuned gait, drawn from its JSON."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

BEFORE, AFTER, LIMIT = "0.45", "#c2410c", "0.75"
SIDES = (("before", BEFORE, "best known"), ("after", AFTER, "tuned"))


def tuned(result: Mapping[str, Any]) -> Figure:
    """The path and the joint angles before and after tuning, and what draws from the fit achieve with the gait.

    **Arguments:** `result`: the JSON of `snakejax tune`.
    """
    spread = _numbers(result["spread"])
    figure = Figure(figsize=(11.0 if spread.size else 8.6, 4.2), layout="constrained")
    columns = [1.3, 1.3] + ([0.7] if spread.size else [])
    grid = figure.add_gridspec(2, len(columns), width_ratios=columns)
    path = figure.add_subplot(grid[:, 0])
    joints = [figure.add_subplot(grid[k, 1]) for k in range(2)]
    for side, colour, label in SIDES:
        if (found := result[side]) is None:
            continue
        line = found["path"]
        x, y, heading = (np.asarray(line[name]) for name in ("x", "y", "heading"))
        path.plot(x, y, color=colour, label=f"{label}: {_said(found['objective'])}")
        marked = slice(None, None, max(len(x) // 12, 1))
        arrows = {"color": colour, "angles": "xy", "width": 0.005, "scale": 18}
        path.quiver(x[marked], y[marked], np.cos(heading[marked]), np.sin(heading[marked]), **arrows)
        for axis, name in zip(joints, ("phi", "psi"), strict=True):
            axis.plot(line["t"], line[name], color=colour, lw=1)
    path.set(xlabel="x [m]", ylabel="y [m]", title=f"{result['case']}: {result['asked']}")
    path.set_aspect("equal", adjustable="datalim")
    path.legend(fontsize="small")
    for axis, name in zip(joints, ("phi", "psi"), strict=True):
        for sign in (-1, 1):
            axis.axhline(sign * result["limits"][name], color=LIMIT, ls="--", lw=1)
        axis.set(ylabel=f"{name} [rad]")
    joints[1].set(xlabel="t [s]")
    if spread.size:
        axis = figure.add_subplot(grid[:, 2])
        axis.plot(np.zeros_like(spread), spread, "o", color=AFTER, alpha=0.6)
        axis.axhline(_numbers([result["objective"]])[0], color=AFTER, lw=1)
        axis.set(xticks=[], xlabel="draws from the fit", ylabel=_label(result))
    return figure


def _first(value: Any) -> float:
    return float(next(iter(value.values()))) if isinstance(value, Mapping) else float(value)


def _numbers(values: Any) -> np.ndarray:
    return np.array([_first(value) for value in values or ()], float)


def _label(result: Mapping[str, Any]) -> str:
    found = result["objective"]
    return next(iter(found)).replace("_", " ") if isinstance(found, Mapping) else str(result["asked"])


def _said(objective: Any) -> str:
    if isinstance(objective, Mapping):
        return ", ".join(f"{value:.3g}" for value in objective.values())
    return f"{objective:.3g}"
