"""The charts of a page, each from the models it shows or from the JSON beside it."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._json import Json
from .._missing import Missing, RunForce
from .._palette import BASE, FORCES, HELDOUT, MEASURED, TRAIN, Look, look
from .._played import Played
from .._scenes import Scene
from .._stretches import stretches
from .._text import misfit_text
from ._chart import (
    EQUAL,
    Chart,
    Trace,
    axes,
    axis_name,
    band,
    bars,
    faint,
    line,
    plain,
    points,
    stacked,
    text,
    thinned,
)

PHASE_BINS = 24
SLIP_BINS = 20
FEWEST = 5
ARROW = 0.3
"""The longest arrow, as a share of how far the runs go."""
MARGIN = 0.05
"""What is free around a path, as a share of its size."""
AROUND_NOISE = 0.5, 2.0
"""Misfits that an axis shows at least: where all are about 1 their scatter is not to look like something."""
COMPONENTS = ("X [N]", "Y [N]", "N [N m]")
UNITS = {"time": "s", "speed": "m/s", "slip": "m/s", "steering_rate": "rad/s", "rotor_rate": "rad/s"}
UNITS |= dict.fromkeys(("heading", "gait_phase", "steering_angle", "rotor_angle"), "rad")
COLOURBAR = {"title": {"text": "log10 misfit", "side": "top"}, "thickness": 12, "orientation": "h", "y": 1.0}
COLOURBAR |= {"yanchor": "bottom", "x": 0.5, "len": 0.8}


def paths(models: Sequence[Played]) -> list[Chart]:
    """A chart a run: the measured path and that of each model, x against y."""
    charts = []
    for k, scene in enumerate(models[0].scenes):
        thin = thinned(scene.times.size)
        seen = scene.seen[thin]
        wide = {"width": 5, "opacity": 0.55}
        traces = [line(seen[:, 0], seen[:, 1], "measured", MEASURED, hovertext=_at(scene, thin), **wide)]
        for model in models:
            pose, at = model.scenes[k].pose[thin], _at(scene, thin)
            traces.append(line(pose[:, 0], pose[:, 1], model.label, model.look, stage=model.key, hovertext=at))
        first = scene.seen[np.isfinite(scene.seen[:, 0])][:1]
        start = points(first[:, 0], first[:, 1], "first frame", MEASURED, symbol="x")
        label = f"The path of {scene.run}, measured and modelled."
        layout = axes("x [m]", "y [m]", showlegend=False, **EQUAL)
        if first.size:
            low, high = np.nanmin(scene.seen[:, :2], axis=0), np.nanmax(scene.seen[:, :2], axis=0)
            for axis, ends in zip(("xaxis", "yaxis"), np.transpose([low, high]), strict=True):
                room = MARGIN * float(np.ptp(ends))
                layout[axis]["autorangeoptions"] = {"include": plain([ends[0] - room, ends[1] + room])}
        charts.append(Chart(f"path-{k}", label, (*traces, start), layout, 320, scene.run))
    return charts


def _at(scene, thin: slice) -> list[str]:
    return [f"{t:.2f} s" for t in scene.times[thin]]


def falling(result: Json) -> Chart:
    """The misfit at each step, of train and of held-out runs; 1 is noise."""
    steps = [("base", result["base"])]
    steps += [(next(f"{k} {s[k]}" for k in ("added", "dropped") if k in s), s) for s in result.get("steps", ())]
    names = [
        f"{number}. {text(name).replace(' ', '<br>', 1)}" if number else name for number, (name, _) in enumerate(steps)
    ]
    traces: list[Trace] = []
    for role, title, colour, pattern in (
        ("train", "train runs", TRAIN, ""),
        ("heldout", "held-out runs", HELDOUT, "/"),
    ):
        values = [step["misfit"][role] for _, step in steps]
        if any(value is not None for value in values):
            shown = [misfit_text(v) for v in values]
            trace = bars(names, values, title, colour, text=shown, textposition="outside", cliponaxis=False)
            trace["marker"]["pattern"] = {"shape": pattern}
            traces.append(trace)
    floor = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1, "line": {"dash": "dot", "width": 2}}
    floor |= {"name": "noise", "showlegend": True}
    every = [v for trace in traces for v in trace["y"] if v]
    ends = {"type": "log", "range": [float(np.log10(v)) for v in (min(0.3, min(every) / 2), 3 * max(every))]}
    layout = axes("", "mean squared residual / noise", yaxis=ends, barmode="group", shapes=[floor])
    layout["bargap"] = 0.45
    return Chart("falling", "The misfit after each step, train and held-out runs.", tuple(traces), layout, 360)


def failing(models: Sequence[Played]) -> list[Chart]:
    """Where each model fails: runs against time, the misfit over a second as a colour, one scale for all models."""
    charts = [_failing(model) for model in models]
    worst = max(v for chart in charts for row in chart.traces[0]["z"] for v in row if v is not None)
    for chart in charts:
        chart.traces[0]["zmax"] = max(1.0, worst)
    return charts


def _failing(model: Played) -> Chart:
    rows, names = [], []
    for scene in model.scenes:
        cells: dict[float, list[float]] = {}
        for stretch in stretches(scene.track):
            cells.setdefault(round((stretch.begin + stretch.end) / 2, 3), []).append(stretch.misfit)
        rows.append({middle: float(np.mean(values)) for middle, values in cells.items()})
        names.append(text(scene.run) + ("<br>(held out)" if scene.role == "heldout" else ""))
    middles = sorted({middle for row in rows for middle in row})
    misfit = [[row.get(middle) for middle in middles] for row in rows]
    z = [[None if v is None else plain([np.log10(max(v, 1e-3))])[0] for v in row] for row in misfit]
    trace: Trace = {
        "type": "heatmap",
        "x": middles,
        "y": names,
        "z": z,
        "text": [[misfit_text(v) for v in row] for row in misfit],
        "hovertemplate": "%{y}<br>%{x:.1f} s: misfit %{text}<extra></extra>",
        "colorscale": "Cividis",
        "zmin": 0,
        "colorbar": COLOURBAR,
        "meta": {"stage": model.key},
    }
    layout = axes("time [s]", "", yaxis={"autorange": "reversed", "automargin": True})
    label = f"The misfit of each run over time, {model.label}."
    return Chart(f"failing-{model.key}", label, (trace,), layout, 150 + 36 * len(names), None, model.key)


def against(models: Sequence[Played], variable: str, title: str, circular: bool = False) -> Chart:
    """The misfit of each model against a variable of its motion, over bins of equal counts or of an angle."""
    traces = []
    for model in models:
        values, square = _squares(model, variable)
        edges = (
            np.linspace(0.0, 2 * np.pi, PHASE_BINS + 1)
            if circular
            else np.unique(np.quantile(values, np.linspace(0.0, 1.0, SLIP_BINS + 1)))
        )
        bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0))
        count = np.bincount(bins, minlength=edges.size - 1)
        mean = np.bincount(bins, square, edges.size - 1) / np.maximum(count, 1)
        middle = np.bincount(bins, values, edges.size - 1) / np.maximum(count, 1)
        kept = count >= FEWEST
        traces.append(line(middle[kept], mean[kept], model.label, model.look, stage=model.key))
        traces[-1]["mode"] = "lines+markers"
    # Unseen marks, for no option of Plotly's widens the range that it finds itself on a logarithmic axis.
    unseen = points(traces[0]["x"][:1] * 2, AROUND_NOISE, "", MEASURED, hoverinfo="skip", showlegend=False)
    traces.append({**unseen, "opacity": 0})
    label = f"The misfit against {title}."
    return Chart(f"against-{variable}", label, tuple(traces), axes(title, "misfit", yaxis={"type": "log"}), 280)


def _squares(model: Played, variable: str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The variable and the mean squared residual of all three channels at every sample seen."""
    values, squares = [], []
    for scene in model.scenes:
        square = np.mean(scene.track.residual**2, axis=1)
        of = np.abs(scene.slip).max(axis=1) if variable == "slip" else scene.track.variables[variable]
        fine = np.isfinite(square)
        values.append(of[fine])
        squares.append(square[fine])
    return np.concatenate(values), np.concatenate(squares)


def suspects(ranking: Sequence[Json]) -> Chart:
    """What each candidate would leave: predicted, and as refitted where it was."""
    shown = [r for r in ranking if r["predicted_misfit"] is not None or r["refit_misfit"] is not None][::-1]
    names = [text(r["effect"]) for r in shown]
    looks = [look(r["effect"]).colour for r in shown]
    traces = []
    for key, title, symbol in (
        ("predicted_misfit", "predicted", "circle-open"),
        ("refit_misfit", "refitted", "circle"),
    ):
        trace: Trace = points([], [], title, BASE, symbol=symbol)
        trace |= {
            "x": [r[key] for r in shown],
            "y": names,
            "hovertemplate": "%{y}: %{x:.4g}<extra>" + title + "</extra>",
        }
        trace["marker"] |= {"color": looks, "size": 10, "line": {"width": 2, "color": looks}}
        traces.append(trace)
    every = [v for trace in traces for v in trace["x"] if v]
    ends = [np.log10(min(AROUND_NOISE[0], *every)), np.log10(max(AROUND_NOISE[1], *every))]
    room = MARGIN * (ends[1] - ends[0])
    xaxis = {"type": "log", "range": plain([ends[0] - room, ends[1] + room])}
    layout = axes("misfit it would leave", "", xaxis=xaxis, yaxis={"automargin": True, "dtick": 1})
    return Chart("suspects", "What misfit each candidate would leave.", tuple(traces), layout, 90 + 20 * len(shown))


def tyre(models: Sequence[Played]) -> Chart:
    """The traction of each model against slip with its band, and what the recordings ask of the tyre."""
    traces = []
    fitted = [(model, model.traction) for model in models if model.traction is not None]
    viscous = fitted[0][1].viscous
    factor, unit = (1.0, "slip speed [m/s]") if viscous else (180 / np.pi, "slip angle [degrees]")
    for model, (curve, means, _) in fitted:
        low, high = curve.force - 1.96 * curve.sd, curve.force + 1.96 * curve.sd
        traces.append(band(factor * curve.slip, low, high, model.label, model.look, stage=model.key))
        traces.append(line(factor * curve.slip, curve.force, model.label, model.look, stage=model.key))
        if means is not None:
            marks = points(
                factor * means.slip,
                means.force,
                f"asked for beside {model.label}",
                Look(model.look.colour, "solid"),
                error_x=factor * means.slip_sd,
                error_y=means.sd,
                stage=model.key,
                showlegend=False,
            )
            traces.append(marks)
    label = "The force of the tyre against slip: the fitted curve with its band, and what the recordings ask of it."
    return Chart("tyre", label, tuple(traces), axes(unit, "force on a wheelset [N]"), 380)


def missing(found: Missing) -> list[Chart]:
    """The missing force of each run over time, with a 95% band, each component on a scale of its own."""
    charts = []
    for k, run in enumerate(found.runs):
        traces: list[Trace] = []
        felt = _felt([run])
        for place, c in enumerate(felt):
            force, sd, on = run.force[:, c], run.sd[:, c], {"yaxis": axis_name(place)}
            traces.append(band(run.t, force - 1.96 * sd, force + 1.96 * sd, COMPONENTS[c], FORCES[c], **on))
            traces.append(line(run.t, force, COMPONENTS[c], FORCES[c], **on))
        label = f"The missing force in {run.run}, with 95% bands."
        layout = stacked("time [s]", [COMPONENTS[c] for c in felt])
        charts.append(Chart(f"force-{k}", label, tuple(traces), layout, 120 + 90 * len(felt), run.run))
    return charts


def _felt(runs: Sequence[RunForce]) -> list[int]:
    """The components that the structure feels at all."""
    return [c for c in range(3) if any(np.isfinite(run.sd[:, c]).any() for run in runs)]


def dependence(shares: Sequence[Json]) -> Chart:
    """What the missing force depends on."""
    trace: Trace = {
        "type": "bar",
        "orientation": "h",
        "y": [s["variable"] for s in shares][::-1],
        "x": [None if s["share"] is None else 100 * s["share"] for s in shares][::-1],
        "marker": {"color": TRAIN},
        "hovertemplate": "%{y}: %{x:.1f} %<extra></extra>",
    }
    layout = axes("share that it predicts [%]", "", yaxis={"automargin": True}, xaxis={"range": [0, 100]})
    return Chart("dependence", "What the missing force depends on.", (trace,), layout, 90 + 22 * len(shares))


def shape(found: Missing, variable: str, model: Played) -> Chart:
    """The missing force against the variable it depends on first; for a place in the world, as arrows on the floor."""
    scenes = {scene.run: scene for scene in model.scenes}
    if variable == "world_position":
        return _arrows(found, scenes)
    traces = []
    felt = _felt(found.runs)
    for place, c in enumerate(felt):
        parts = [
            (
                np.interp(run.t, scenes[run.run].times, _variable(scenes[run.run], variable)),
                run.force[:, c],
                run.sd[:, c],
            )
            for run in found.runs
            if np.isfinite(run.sd[:, c]).any()
        ]
        values, force, sd = np.concatenate(parts, axis=1)
        traces.append(points(values, force, COMPONENTS[c], FORCES[c], error_y=sd, yaxis=axis_name(place)))
        traces[-1]["marker"]["size"] = 3
        traces[-1]["error_y"]["color"] = faint(FORCES[c].colour)
    label = f"The missing force against {variable}, with 95% bars."
    words = f"{variable.replace('_', ' ')} [{UNITS[variable]}]"
    layout = stacked(words, [COMPONENTS[c] for c in felt])
    return Chart("shape", label, tuple(traces), layout, 120 + 90 * len(felt))


def _variable(scene: Scene, variable: str) -> Float[np.ndarray, " n"]:
    return np.abs(scene.slip_speed).max(axis=1) if variable == "slip" else scene.track.variables[variable]


def _arrows(found: Missing, scenes: Mapping[str, Scene]) -> Chart:
    starts, forces, names = [], [], []
    for run in found.runs:
        scene = scenes[run.run]
        # Where it was seen, and where no frame was, the place the model has.
        pose = np.where(np.isfinite(scene.seen), scene.seen, scene.pose)
        x, y = (np.interp(run.t, scene.times, pose[:, c]) for c in (0, 1))
        frame = np.interp(run.t, scene.times, np.unwrap(pose[:, 2]) - scene.skid_angle)
        X, Y = run.force[:, 0], np.where(np.isfinite(run.sd[:, 1]), run.force[:, 1], 0.0)
        starts.append(np.stack([x, y], axis=1))
        forces.append(np.stack([X * np.cos(frame) - Y * np.sin(frame), X * np.sin(frame) + Y * np.cos(frame)], axis=1))
        names += [f"{run.run}, {t:.1f} s: {f:.3g} N" for t, f in zip(run.t, np.hypot(X, Y), strict=True)]
    start, force = np.concatenate(starts), np.concatenate(forces)
    size = float(np.ptp(start, axis=0).max()) / max(float(np.linalg.norm(force, axis=1).max()), 1e-12)
    end = start + ARROW * size * force
    shafts = np.stack([start, end, np.full_like(start, np.nan)], axis=1).reshape(-1, 2)
    traces = (
        line(shafts[:, 0], shafts[:, 1], "missing force", FORCES[0], width=1, hoverinfo="skip"),
        points(start[:, 0], start[:, 1], "where", FORCES[0], hovertext=[text(n) for n in names], hoverinfo="text"),
    )
    traces[1]["marker"]["size"] = 4
    label = "The missing force as arrows from where the board was, along and across the board together."
    return Chart("shape", label, traces, axes("x [m]", "y [m]", **EQUAL), 460)
