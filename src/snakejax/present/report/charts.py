"""The charts of a page, each from the models it shows or from the JSON beside it."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from snakejax.diagnosis.latent_force.missing_force import LatentForce, RunForce
from snakejax.diagnosis.law.units import unit_of, unit_text
from snakejax.diagnosis.residuals.intervals import interval_misfits
from snakejax.diagnosis.residuals.replays import RunReplay

from ..as_json.values import Json
from ..as_text.errors import times_noise, times_noise_text
from ..as_text.missing import determined
from ..style import COMPONENTS, FORCES, HELDOUT, LAW, MEASURED, TRAIN, LineStyle
from ..views import ModelView, doubt
from .chart import EQUAL, Chart, Trace, axes, axis_name, band, bars, faint, line, plain, points, stacked, text, thinned

PHASE_BINS = 24
SLIP_BINS = 20
FEWEST = 5
ARROW = 0.3
"""The longest arrow, as a share of how far the runs go."""
MARGIN = 0.05
"""The margin around a path, as a share of its size."""
AROUND_NOISE = 0.5, 2.0
"""The smallest range of an error axis, so that scatter about 1 does not look large."""
ERROR = "error, multiples of the noise"
UNITS = {"slip": "m/s", "gait_phase": "rad"}
"""The units of variables that laws name otherwise; those of the others follow from their names."""
COLOURBAR = {"title": {"text": ERROR, "side": "top"}, "thickness": 12, "orientation": "h", "y": 1.0}
COLOURBAR |= {"tickvals": [*range(10)], "ticktext": ["1", "10", "100", "1000", *(f"1e{k}" for k in range(4, 10))]}
COLOURBAR |= {"yanchor": "bottom", "x": 0.5, "len": 0.8}


def paths(models: Sequence[ModelView]) -> list[Chart]:
    """A chart a run: the measured path and that of each model, x against y."""
    charts = []
    for k, scene in enumerate(models[0].scenes):
        thin = thinned(scene.times.size)
        measured = scene.measured[thin]
        wide = {"width": 5, "opacity": 0.55}
        traces = [line(measured[:, 0], measured[:, 1], "measured", MEASURED, hovertext=_at(scene, thin), **wide)]
        for model in models:
            pose, at = model.scenes[k].pose[thin], _at(scene, thin)
            traces.append(line(pose[:, 0], pose[:, 1], model.label, model.look, step=model.key, hovertext=at))
        first = scene.measured[np.isfinite(scene.measured[:, 0])][:1]
        start = points(first[:, 0], first[:, 1], "first frame", MEASURED, symbol="x")
        label = f"The path of {scene.run}, measured and modelled."
        layout = axes("x [m]", "y [m]", showlegend=False, **EQUAL)
        if first.size:
            low, high = np.nanmin(scene.measured[:, :2], axis=0), np.nanmax(scene.measured[:, :2], axis=0)
            for axis, ends in zip(("xaxis", "yaxis"), np.transpose([low, high]), strict=True):
                room = MARGIN * float(np.ptp(ends))
                layout[axis]["autorangeoptions"] = {"include": plain([ends[0] - room, ends[1] + room])}
        charts.append(Chart(f"path-{k}", label, (*traces, start), layout, 320, scene.run))
    return charts


def _at(scene, thin: slice) -> list[str]:
    return [f"{t:.2f} s" for t in scene.times[thin]]


def falling(result: Json) -> Chart:
    """The error at each step, of train and of held-out runs, in multiples of the noise."""
    steps = [("base", result["base"])]
    steps += [(next(f"{k} {s[k]}" for k in ("added", "dropped") if k in s), s) for s in result.get("steps", ())]
    names = [
        (f"{number}. {text(name).replace(' ', '<br>', 1)}" if number else name) + doubt(step["converged"], "<br>")
        for number, (name, step) in enumerate(steps)
    ]
    traces: list[Trace] = []
    for role, title, colour, pattern in (
        ("train", "train runs", TRAIN, ""),
        ("heldout", "held-out runs", HELDOUT, "/"),
    ):
        misfits = [step["misfit"][role] for _, step in steps]
        values = [times_noise(misfit) for misfit in misfits]
        if any(value is not None for value in values):
            shown = [times_noise_text(misfit) for misfit in misfits]
            trace = bars(names, values, title, colour, text=shown, textposition="outside", cliponaxis=False)
            trace["marker"]["pattern"] = {"shape": pattern}
            traces.append(trace)
    floor = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1, "line": {"dash": "dot", "width": 2}}
    floor |= {"name": "noise", "showlegend": True}
    every = [v for trace in traces for v in trace["y"] if v]
    ends = {"type": "log", "range": [float(np.log10(v)) for v in (min(0.3, min(every) / 2), 3 * max(every))]}
    layout = axes("", ERROR, yaxis=ends, barmode="group", shapes=[floor])
    layout["bargap"] = 0.45
    label = "The error after each step, train and held-out runs, in multiples of the noise."
    return Chart("falling", label, tuple(traces), layout, 360)


def failing(models: Sequence[ModelView]) -> list[Chart]:
    """Where each model fails: runs against time, the error over a second as a colour, one scale for all models."""
    charts = [_failing(model) for model in models]
    worst = max(v for chart in charts for row in chart.traces[0]["z"] for v in row if v is not None)
    for chart in charts:
        chart.traces[0]["zmax"] = max(1.0, worst)
    return charts


def _failing(model: ModelView) -> Chart:
    rows, names = [], []
    for scene in model.scenes:
        cells: dict[float, list[float]] = {}
        for stretch in interval_misfits(scene.track):
            cells.setdefault(round((stretch.begin + stretch.end) / 2, 3), []).append(stretch.misfit)
        rows.append({middle: float(np.mean(values)) for middle, values in cells.items()})
        names.append(text(scene.run) + ("<br>(held out)" if scene.role == "heldout" else ""))
    middles = sorted({middle for row in rows for middle in row})
    misfit = [[row.get(middle) for middle in middles] for row in rows]
    z = [plain(np.log10(np.maximum(np.array([times_noise(v) for v in row], float), 1e-3))) for row in misfit]
    trace: Trace = {
        "type": "heatmap",
        "x": middles,
        "y": names,
        "z": z,
        "text": [[times_noise_text(v) for v in row] for row in misfit],
        "hovertemplate": "%{y}<br>%{x:.1f} s: %{text} times the noise<extra></extra>",
        "colorscale": "Cividis",
        "zmin": 0,
        "colorbar": COLOURBAR,
        "meta": {"step": model.key},
    }
    layout = axes("time [s]", "", yaxis={"autorange": "reversed", "automargin": True})
    label = f"The error of each run over time, {model.label}, in multiples of the noise."
    return Chart(f"failing-{model.key}", label, (trace,), layout, 150 + 36 * len(names), None, model.key)


def against(models: Sequence[ModelView], variable: str, title: str, circular: bool = False) -> Chart:
    """The error of each model against a variable of its motion, over bins of equal counts or of an angle."""
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
        traces.append(line(middle[kept], [times_noise(m) for m in mean[kept]], model.label, model.look, step=model.key))
        traces[-1]["mode"] = "lines+markers"
    # Unseen marks, for no option of Plotly's widens the range that it finds itself on a logarithmic axis.
    unseen = points(traces[0]["x"][:1] * 2, AROUND_NOISE, "", MEASURED, hoverinfo="skip", showlegend=False)
    traces.append({**unseen, "opacity": 0})
    label = f"The error against {title}, in multiples of the noise."
    return Chart(f"against-{variable}", label, tuple(traces), axes(title, ERROR, yaxis={"type": "log"}), 280)


def _squares(model: ModelView, variable: str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The variable and the mean squared residual of all three channels at every sample seen."""
    values, squares = [], []
    for scene in model.scenes:
        square = np.mean(scene.track.residual**2, axis=1)
        of = np.abs(scene.slip).max(axis=1) if variable == "slip" else scene.track.variables[variable]
        fine = np.isfinite(square)
        values.append(of[fine])
        squares.append(square[fine])
    return np.concatenate(values), np.concatenate(squares)


def tyre(models: Sequence[ModelView]) -> Chart:
    """The lateral force of each model against slip with its band, and the forces reconstructed from the recordings."""
    traces = []
    fitted = [(model, model.traction) for model in models if model.traction is not None]
    viscous = fitted[0][1].viscous
    factor, unit = (1.0, "slip speed [m/s]") if viscous else (180 / np.pi, "slip angle [degrees]")
    for model, (curve, means, _) in fitted:
        low, high = curve.force - 1.96 * curve.sd, curve.force + 1.96 * curve.sd
        traces.append(band(factor * curve.slip, low, high, model.label, model.look, step=model.key))
        traces.append(line(factor * curve.slip, curve.force, model.label, model.look, step=model.key))
        if means is not None:
            marks = points(
                factor * means.slip,
                means.force,
                f"reconstructed, {model.label}",
                LineStyle(model.look.colour, "solid"),
                error_x=factor * means.slip_sd,
                error_y=means.sd,
                step=model.key,
                showlegend=False,
            )
            traces.append(marks)
    label = "The lateral force against slip: the fitted curve with its band, and the reconstructed forces."
    return Chart("tyre", label, tuple(traces), axes(unit, "force on a wheelset [N]"), 380)


def missing(latent: LatentForce, model: ModelView, laws: Mapping[str, np.ndarray]) -> list[Chart]:
    """The missing force of each run over time, with a 95% band, each component on a scale of its own; and the force of
    `laws` by run, along the `model`."""
    times = {scene.run: scene.times for scene in model.scenes}
    charts, observable = [], _observable(latent.runs)
    for k, run in enumerate(latent.runs):
        traces: list[Trace] = []
        for place, c in enumerate(observable):
            force, sd, on = run.force[:, c], run.sd[:, c], {"yaxis": axis_name(place)}
            traces.append(band(run.t, force - 1.96 * sd, force + 1.96 * sd, COMPONENTS[c], FORCES[c], **on))
            traces.append(line(run.t, force, COMPONENTS[c], FORCES[c], **on))
            if run.run in laws:
                thin = thinned(times[run.run].size)
                traces.append(line(times[run.run][thin], laws[run.run][thin, c], "law", LAW, **on))
        label = f"The missing force in {run.run}, with 95% bands{', and the law' if laws else ''}."
        layout = stacked("time [s]", [COMPONENTS[c] for c in observable])
        charts.append(Chart(f"force-{k}", label, tuple(traces), layout, 120 + 90 * len(observable), run.run))
    return charts


def _observable(runs: Sequence[RunForce]) -> list[int]:
    """The components that the data show."""
    return [c for c, shown in enumerate(determined(tuple(runs))) if shown]


def dependence(shares: Sequence[Json]) -> Chart:
    """The dependence of the missing force."""
    trace: Trace = {
        "type": "bar",
        "orientation": "h",
        "y": [s["variable"] for s in shares][::-1],
        "x": [None if s["share"] is None else 100 * s["share"] for s in shares][::-1],
        "marker": {"color": TRAIN},
        "hovertemplate": "%{y}: %{x:.1f} %<extra></extra>",
    }
    layout = axes(
        "share that it predicts [%]",
        "",
        yaxis={"automargin": True},
        xaxis={"range": [0, 100]},
    )
    return Chart("dependence", "What the missing force depends on.", (trace,), layout, 90 + 22 * len(shares))


def shape(latent: LatentForce, variable: str, model: ModelView, laws: Mapping[str, np.ndarray]) -> Chart:
    """The missing force against the variable it depends on first, and that of `laws` by run along the `model`; for a
    place in the world, as arrows on the ground."""
    scenes = {scene.run: scene for scene in model.scenes}
    if variable == "world_position":
        return _arrows(latent, scenes)
    traces = []
    observable = _observable(latent.runs)
    trained = [scene for scene in model.scenes if scene.run in laws and scene.role == "train"]
    drawn = [(scene, thinned(scene.times.size)) for scene in trained]
    at = np.concatenate([np.zeros(0), *(_variable(scene, variable)[thin] for scene, thin in drawn)])
    for place, c in enumerate(observable):
        parts = [
            (
                np.interp(run.t, scenes[run.run].times, _variable(scenes[run.run], variable)),
                run.force[:, c],
                run.sd[:, c],
            )
            for run in latent.runs
            if np.isfinite(run.sd[:, c]).any()
        ]
        values, force, sd = np.concatenate(parts, axis=1)
        traces.append(points(values, force, COMPONENTS[c], FORCES[c], error_y=sd, yaxis=axis_name(place)))
        traces[-1]["marker"]["size"] = 3
        traces[-1]["error_y"]["color"] = faint(FORCES[c].colour)
        if drawn:
            law = np.concatenate([laws[scene.run][thin, c] for scene, thin in drawn])
            traces.append(points(at, law, "law", LAW, yaxis=axis_name(place)))
            traces[-1]["marker"]["size"] = 2
    label = f"The missing force against {variable}, with 95% bars{', and the law' if laws else ''}."
    words = f"{variable.replace('_', ' ')} [{UNITS.get(variable) or unit_text(unit_of(variable))}]"
    layout = stacked(words, [COMPONENTS[c] for c in observable])
    return Chart("shape", label, tuple(traces), layout, 120 + 90 * len(observable))


def _variable(scene: RunReplay, variable: str) -> Float[np.ndarray, " n"]:
    return np.abs(scene.slip_speed).max(axis=1) if variable == "slip" else scene.track.variables[variable]


def _arrows(latent: LatentForce, scenes: Mapping[str, RunReplay]) -> Chart:
    starts, forces, names = [], [], []
    for run in latent.runs:
        scene = scenes[run.run]
        # The measured place, and the model's where the frame was lost.
        pose = np.where(np.isfinite(scene.measured), scene.measured, scene.pose)
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
        _scale(start, ARROW * size, float(np.linalg.norm(force, axis=1).max())),
    )
    traces[1]["marker"]["size"] = 4
    label = "The missing force as arrows from where the board was, along and across the board together."
    return Chart("shape", label, traces, axes("x [m]", "y [m]", **EQUAL), 460)


def _scale(start: Float[np.ndarray, "n 2"], length: float, largest: float) -> Trace:
    """A bar below the arrows, as long as an arrow of the force written beside it; `length` [m] is that of 1 N."""
    power = 10.0 ** np.floor(np.log10(max(largest, 1e-12)))
    force = max(part for part in (power, 2 * power, 5 * power) if part <= largest * (1 + 1e-9))
    west, south = start.min(axis=0) - MARGIN * np.ptp(start, axis=0).max()
    bar = line(
        [west, west + force * length], [south, south], "scale of the arrows", FORCES[0], width=4, hoverinfo="skip"
    )
    return bar | {"mode": "lines+text", "text": ["", f" {force:g} N"], "textposition": "middle right"}
