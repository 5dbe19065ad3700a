"""Figures of a tuned gait, drawn from its JSON."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..as_text.errors import OBJECTIVE_UNITS, POSE_ERRORS, missed_text, target_pose
from ..style import BASE, HELDOUT

BEFORE, AFTER, LIMIT = BASE.colour, HELDOUT, "0.75"
SIDES = (("before", BEFORE, "best known"), ("after", AFTER, "tuned"))


def tuned(result: Mapping[str, Any]) -> Figure:
    """The path and the joint angles before and after tuning, and the results over samples of the fit.

    **Arguments:** `result`: the JSON of `snakejax tune`.
    """
    spread = _numbers(result["spread"])
    figure = Figure(figsize=(11.0 if spread.size else 8.6, 4.2), layout="constrained")
    columns = [1.3, 1.3] + ([0.7] if spread.size else [])
    grid = figure.add_gridspec(len(result["units"]), len(columns), width_ratios=columns)
    _path_and_joints(figure, grid, result)
    if spread.size:
        axis = figure.add_subplot(grid[:, 2])
        axis.plot(np.zeros_like(spread), spread, "o", color=AFTER, alpha=0.6)
        axis.axhline(_numbers([result["objective"]])[0], color=AFTER, lw=1)
        axis.set(xticks=[], xlabel="samples of the fit", ylabel=_label(result))
    return figure


def designed(result: Mapping[str, Any]) -> Figure:
    """The designed run, with the probability of correct selection beside that of alternatives, or with the standard
    errors of the tyre parameters.

    **Arguments:** `result`: the JSON of `snakejax tune --objective separate` or `information`.
    """
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    grid = figure.add_gridspec(len(result["units"]), 3, width_ratios=[1.1, 1.1, 1.2])
    _path_and_joints(figure, grid, result)
    axis = figure.add_subplot(grid[:, 2])
    if "separate" in result:
        part = result["separate"]
        rows = [("given runs", part["before"], BEFORE)]
        rows += [(f"{a['do']},\n{a['run']}", a["certainty"], LIMIT) for a in reversed(part["advice"])]
        rows += [("the designed run", part["after"], AFTER)]
        names, values, colours = zip(*rows, strict=True)
        axis.barh(names, 100 * np.array(values), color=colours)
        axis.axvline(95, color="0.2", ls=":", lw=1)
        axis.set(xlim=(50, 100), xlabel="correct selection [%]", title=" or ".join(part["effects"]))
    else:
        before, after = (result["information"][key] for key in ("sd_before", "sd_after"))
        places = np.arange(len(before))
        axis.barh(places + 0.2, [*before.values()], 0.4, color=BEFORE, label="given runs")
        axis.barh(places - 0.2, [*after.values()], 0.4, color=AFTER, label="and the designed one")
        axis.set(xscale="log", xlabel="standard error", yticks=places, yticklabels=[*before])
        axis.legend(fontsize="small")
    axis.tick_params(axis="y", labelsize="small")
    return figure


def _path_and_joints(figure: Figure, grid: Any, result: Mapping[str, Any]) -> None:
    path, objective_unit = figure.add_subplot(grid[:, 0]), OBJECTIVE_UNITS.get(result["asked"], "")
    units = result["units"]
    joints = [figure.add_subplot(grid[k, 1]) for k in range(len(units))]
    for side, colour, label in SIDES:
        if (journey := result[side]) is None:
            continue
        line, objective = journey["path"], journey["objective"]
        x, y, heading = (np.asarray(line[name]) for name in ("x", "y", "heading"))
        path.plot(
            x,
            y,
            color=colour,
            label=label if objective is None else f"{label}: {_objective_text(objective, objective_unit)}",
        )
        marked = slice(None, None, max(len(x) // 12, 1))
        arrows = {"color": colour, "angles": "xy", "width": 0.005, "scale": 18}
        path.quiver(x[marked], y[marked], np.cos(heading[marked]), np.sin(heading[marked]), **arrows)
        for axis, name in zip(joints, units, strict=True):
            axis.plot(line["t"], line[name], color=colour, lw=1)
    if (target := target_pose(result["asked"])) is not None:
        x, y, heading = target
        path.plot(x, y, "*", color="black", ms=12, label="target", zorder=3)
        path.quiver(x, y, np.cos(heading), np.sin(heading), color="black", angles="xy", width=0.005, scale=18)
    path.set(xlabel="x [m]", ylabel="y [m]", title=f"{result['case']}: {result['asked'].partition(':')[0]}")
    path.set_aspect("equal", adjustable="datalim")
    path.legend(fontsize="small")
    for axis, (name, unit) in zip(joints, units.items(), strict=True):
        for sign in (-1, 1):
            axis.axhline(sign * result["limits"][name], color=LIMIT, ls="--", lw=1)
        axis.set(ylabel=f"{name} [{unit}]")
    joints[-1].set(xlabel="t [s]")


def _first(value: Any) -> float:
    """The number that is drawn: of a missed pose the error in position [mm]."""
    return 1e3 * float(next(iter(value.values()))) if isinstance(value, Mapping) else float(value)


def _numbers(values: Any) -> np.ndarray:
    return np.array([_first(value) for value in values or ()], float)


def _label(result: Mapping[str, Any]) -> str:
    achieved = result["objective"]
    if isinstance(achieved, Mapping):
        return POSE_ERRORS[next(iter(achieved))]
    objective = str(result["asked"])
    unit = OBJECTIVE_UNITS.get(objective, "").strip()
    return f"{objective} [{unit}]" if unit else objective


def _objective_text(objective: Any, unit: str) -> str:
    if isinstance(objective, Mapping):
        return f"off by {missed_text(objective)}"
    return f"{objective:.3g}{unit}"
